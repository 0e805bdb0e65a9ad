"""Distortion of a lens that its stated parameters lack."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, SensorCorrection
from calib.estimation.corrections.camera.camera_intrinsics import (
    STEP_IN_PRIOR_SIGMA,
    cameras_with_stated_lens,
    distortion_prior_sigma,
    find_parameter_index,
    lens_remedy,
)
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import MIN_SHOWN_SIGMAS, format_signed_sigma
from calib.estimation.estimation_problem import Setup
from calib.io.config_change import ConfigChange, pipeline_change
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel

PINHOLE_PARAMETERS = frozenset({"fx", "fy", "cx", "cy"})


@dataclass(frozen=True)
class DistortionCorrection(ModelCorrection[CameraModel]):
    """Differences (q,) of the parameters of a camera's distortion from those of the stated lens.

    stated: the latter by name: k1, k2, p1, p2 of radtan, k1 to k4 of kannala_brandt, xi and alpha
    of double_sphere.
    """

    name = "distortion"
    stated: dict[str, float] = field(hash=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        steps = STEP_IN_PRIOR_SIGMA * self.prior_sigma
        return linearization.derivative_by_model(self._shift_distortion, steps)

    def apply_to_model(self, model: CameraModel, values: np.ndarray, placement: int) -> CameraModel:
        return self._shift_distortion(model, values)

    def _shift_distortion(self, camera: CameraModel, values: np.ndarray) -> CameraModel:
        params = np.array(camera.params)
        params[[find_parameter_index(camera, name) for name in self.stated]] += values
        return replace(camera, params=tuple(params.tolist()))

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        shown = _choose_shown_parameters(values, sigma)
        names = [name for name, is_shown in zip(self.stated, shown, strict=True) if is_shown]
        found = [
            f"{name} {format_signed_sigma(self.stated[name] + value, spread)}"
            for name, value, spread in zip(names, values[shown], sigma[shown], strict=True)
        ]
        stated = [f"{name} {self.stated[name]:.4g}" for name in names]
        return (
            f"distortion {', '.join(found)} is not in the stated lens of {self.subject} "
            f"({', '.join(stated)})"
        )

    @property
    def remedy(self) -> str:
        return lens_remedy(self.subject)

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.intrinsics", True)


def make_distortion_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of the distortion of every camera whose lens is not estimated."""
    for name, camera in cameras_with_stated_lens(setup):
        stated = stated_distortion(camera)
        sigma = np.array([distortion_prior_sigma(n) for n in stated])
        yield DistortionCorrection(name, sigma, stated)


def stated_distortion(camera: CameraModel) -> dict[str, float]:
    """Return the parameters of a lens's distortion by name, without optional ones."""
    lens = CAMERA_MODELS[camera.model]
    return {
        name: value
        for name, value in zip(lens.PARAMETER_NAMES, camera.params, strict=True)
        if name not in PINHOLE_PARAMETERS and name not in lens.OPTIONAL_PARAMETERS
    }


def _choose_shown_parameters(values: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return which values (q,) are significant; the most significant one in any case."""
    ratio = np.abs(values) / np.where(sigma > 0, sigma, np.inf)
    return ratio >= min(MIN_SHOWN_SIGMAS, ratio.max())
