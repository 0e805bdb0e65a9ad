"""Possible errors of a camera's lens: its focal lengths and its principal point."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation.corrections.base import SensorCorrection
from calib.estimation.corrections.group_linearization import FINITE_STEP_RATIO, GroupLinearization
from calib.estimation.corrections.number_wording import (
    choose_by_sign,
    format_value_sigma,
    format_vector_sigma,
)
from calib.estimation.estimation_problem import Setup
from calib.geometry.units import SHARE_TO_PERCENT
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel

FINITE_STEP_PX = 1e-4


@dataclass(frozen=True)
class FocalLengthCorrection(SensorCorrection):
    """Relative error of both focal lengths of a camera. fx_px: as configured."""

    name = "focal_length"
    n_values = 1
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
        return _lens_remedy(self.subject)


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
        return _lens_remedy(self.subject)


def make_lens_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the corrections of the lens of every camera."""
    for name, camera in sorted(setup.models.items()):
        if isinstance(camera, CameraModel):
            yield FocalLengthCorrection(name, camera.params[_parameter_index(camera, "fx")])
            yield PrincipalPointCorrection(name)


def _scale_focal_lengths(camera: CameraModel, values: np.ndarray) -> CameraModel:
    params = np.array(camera.params)
    params[[_parameter_index(camera, p) for p in ("fx", "fy")]] *= 1 + values[0]
    return replace(camera, params=tuple(params))


def _shift_principal_point(camera: CameraModel, values: np.ndarray) -> CameraModel:
    params = np.array(camera.params)
    params[[_parameter_index(camera, p) for p in ("cx", "cy")]] += values
    return replace(camera, params=tuple(params))


def _parameter_index(camera: CameraModel, parameter: str) -> int:
    return CAMERA_MODELS[camera.model].PARAMETER_NAMES.index(parameter)


def _lens_remedy(name: str) -> str:
    return f"calibrate the lens of {name} again, at the focus and image size of the recording"
