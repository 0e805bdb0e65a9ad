"""A camera's parameters: estimated with priors where views constrain them, or tested for errors."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, SensorCorrection
from calib.estimation.corrections.correction_estimate import (
    correction_estimates,
    find_correction_estimate,
)
from calib.estimation.corrections.group_linearization import FINITE_STEP_RATIO, GroupLinearization
from calib.estimation.corrections.number_wording import (
    choose_by_sign,
    format_value_sigma,
    format_vector_sigma,
)
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.geometry.units import SHARE_TO_PERCENT
from calib.io.config_change import ConfigChange, pipeline_change
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel

INTRINSICS = "intrinsics"  # name of the correction
PRIOR_SIGMA_PER_IMAGE_SIZE = {"fx": 0.05, "fy": 0.05, "cx": 0.05, "cy": 0.05}  # of the larger side
PRIOR_SIGMA_BY_PARAMETER = {"xi": 0.2, "alpha": 0.1, "p1": 0.01, "p2": 0.01}
DEFAULT_PRIOR_SIGMA = 0.3
STEP_IN_PRIOR_SIGMA = 1e-4  # finite difference
MAX_INTRINSICS_SIGMA_RATIO = 0.5  # σ of fx, fy, cx, cy over the prior's: refused above this
FINITE_STEP_PX = 1e-4
MAX_FOCAL_SHARE = 0.5  # relative error of a focal length, beyond which its derivatives do not hold


class IntrinsicsEstimate(NamedTuple):
    """Parameters (q,) of a camera, their σ, and the σ over those of the prior."""

    params: np.ndarray
    sigma: np.ndarray
    sigma_ratio: np.ndarray


@dataclass(frozen=True)
class IntrinsicsCorrection(ModelCorrection[CameraModel]):
    """Differences (q,) of the first q parameters of a camera from the configured ones."""

    name = INTRINSICS

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        steps = STEP_IN_PRIOR_SIGMA * self.prior_sigma
        return linearization.derivative_by_model(shift_camera_parameters, steps)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the parameters of {self.subject} differ from the configured ones by up to "
            f"{np.abs(values).max():.3g}"
        )

    @property
    def remedy(self) -> str:
        return f"nothing: the parameters of {self.subject} are estimated"

    def apply_to_model(self, model: CameraModel, values: np.ndarray, placement: int) -> CameraModel:
        return shift_camera_parameters(model, values)


def make_intrinsics_correction(
    sensor: str, camera: CameraModel, count: int
) -> IntrinsicsCorrection:
    """Return the correction of the first `count` parameters of a camera."""
    size = max(camera.size_px)
    sigma = [
        PRIOR_SIGMA_PER_IMAGE_SIZE[n] * size
        if n in PRIOR_SIGMA_PER_IMAGE_SIZE
        else distortion_prior_sigma(n)
        for n in intrinsics_parameter_names(camera, count)
    ]
    return IntrinsicsCorrection(sensor, np.array(sigma))


def distortion_prior_sigma(parameter: str) -> float:
    """Return the σ of the prior of a parameter of the distortion, by its name."""
    return PRIOR_SIGMA_BY_PARAMETER.get(parameter, DEFAULT_PRIOR_SIGMA)


def intrinsics_parameter_names(camera: CameraModel, count: int) -> tuple[str, ...]:
    """Return the names of the first `count` parameters: those that the config states."""
    return CAMERA_MODELS[camera.model].PARAMETER_NAMES[:count]


def shift_camera_parameters(camera: CameraModel, values: np.ndarray) -> CameraModel:
    """Return the camera with its first parameters changed by values (q,)."""
    params = np.array(camera.params)
    params[: len(values)] += values
    return replace(camera, params=tuple(params.tolist()))


def get_intrinsics_estimate(
    setup: Setup, result: EstimationResult, sensor: str
) -> IntrinsicsEstimate | None:
    """Return the estimated parameters of a camera, or None if they are not estimated."""
    estimate = find_correction_estimate(setup, result, INTRINSICS, sensor)
    if estimate is None:
        return None
    camera = cast(CameraModel, setup.models[sensor])
    params = np.array(camera.params)[: len(estimate.values)] + estimate.values
    return IntrinsicsEstimate(params, estimate.sigma, estimate.sigma_ratio)


def find_unobservable_intrinsics(setup: Setup, result: EstimationResult) -> dict[str, str]:
    """Return {sensor: reason} of the cameras whose views do not constrain their parameters."""
    reasons = {}
    for estimate in correction_estimates(setup, result):
        if estimate.correction.name != INTRINSICS:
            continue
        sensor = estimate.correction.subject
        camera = cast(CameraModel, setup.models[sensor])
        names = intrinsics_parameter_names(camera, len(estimate.values))
        loose = [
            n
            for n, ratio in zip(names, estimate.sigma_ratio, strict=True)
            if n in PRIOR_SIGMA_PER_IMAGE_SIZE and ratio > MAX_INTRINSICS_SIGMA_RATIO
        ]
        if loose:
            n_groups = sum(g.sensor == sensor for g in setup.groups)
            reasons[sensor] = (
                f"not estimated: {n_groups} groups of views do not constrain {', '.join(loose)}; "
                "record the pattern near, tilted to all sides and in all parts of the image"
            )
    return reasons


@dataclass(frozen=True)
class FocalLengthCorrection(SensorCorrection):
    """Relative error of both focal lengths of a camera. fx_px: as configured."""

    name = "focal_length"
    n_values = 1
    max_size = MAX_FOCAL_SHARE
    fx_px: float

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_model(_scale_focal_lengths, [FINITE_STEP_RATIO])

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        share = format_value_sigma(values[0], sigma[0], SHARE_TO_PERCENT, "%")
        return (
            f"the focal length of {self.subject} is {share} "
            f"{choose_by_sign(values[0], 'longer', 'shorter')} than its params say: fx "
            f"{self.fx_px * (1 + values[0]):.5g}, not {self.fx_px:.5g}"
        )

    @property
    def remedy(self) -> str:
        return lens_remedy(self.subject)

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.intrinsics", True)


@dataclass(frozen=True)
class PrincipalPointCorrection(SensorCorrection):
    """Error (2,), px, of the principal point of a camera."""

    name = "principal_point"
    n_values = 2

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_model(_shift_principal_point, [FINITE_STEP_PX] * 2)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        offset = format_vector_sigma(values, sigma, 1.0, "px")
        return f"the principal point of {self.subject} is off by {offset}"

    @property
    def remedy(self) -> str:
        return lens_remedy(self.subject)

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.intrinsics", True)


def make_lens_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the corrections of focal length and centre of every camera."""
    for name, camera in cameras_with_stated_lens(setup):
        yield FocalLengthCorrection(name, camera.params[find_parameter_index(camera, "fx")])
        yield PrincipalPointCorrection(name)


def cameras_with_stated_lens(setup: Setup) -> list[tuple[str, CameraModel]]:
    """Return (name, camera) of the cameras whose parameters are not estimated."""
    return [
        (name, camera)
        for name, camera in sorted(setup.models.items())
        if isinstance(camera, CameraModel) and setup.correction_slice(INTRINSICS, name) is None
    ]


def _scale_focal_lengths(camera: CameraModel, values: np.ndarray) -> CameraModel:
    params = np.array(camera.params)
    params[[find_parameter_index(camera, p) for p in ("fx", "fy")]] *= 1 + values[0]
    return replace(camera, params=tuple(params))


def _shift_principal_point(camera: CameraModel, values: np.ndarray) -> CameraModel:
    params = np.array(camera.params)
    params[[find_parameter_index(camera, p) for p in ("cx", "cy")]] += values
    return replace(camera, params=tuple(params))


def find_parameter_index(camera: CameraModel, parameter: str) -> int:
    """Return the place of a parameter, by its name, in the params of a camera."""
    return CAMERA_MODELS[camera.model].PARAMETER_NAMES.index(parameter)


def lens_remedy(name: str) -> str:
    """Say what to do about a lens that is not as its params state."""
    return (
        "set solve.estimate.intrinsics: true; or calibrate the lens again, at the focus and image "
        f"size of the recording, and write its model and params to sensors.{name}"
    )
