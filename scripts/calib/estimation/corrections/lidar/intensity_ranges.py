"""A possible error of a lidar's ranges that depends on how strong a return is.

Weak returns cross the receiver's threshold later, and read long. Where the pattern of a board tells
what is dark, dark_ranges says the same; intensities tell it of every target.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, SensorCorrection
from calib.estimation.corrections.group_linearization import FINITE_STEP_M, GroupLinearization
from calib.estimation.corrections.number_wording import choose_by_sign, format_value_sigma
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.geometry.units import MM_PER_M
from calib.io.config_change import ConfigChange, pipeline_change
from calib.sensors.lidar.lidar_model import LidarModel

INTENSITY_QUANTILES = (0.05, 0.95)  # of the returns of a lidar: its low and its high intensity


@dataclass(frozen=True)
class IntensityRangeCorrection(ModelCorrection[LidarModel]):
    """By how much, m, returns of a low intensity are longer than those of a high one.

    intensities: the low and the high one.
    """

    name = "intensity_ranges"
    kinds = frozenset({"target_surface", "cylinder_cap"})
    intensities: tuple[float, float] = field(repr=False)

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        return super().affects(setup, group) and "intensity" in group.keypoints

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_model(self._lengthen_weak_returns, [FINITE_STEP_M])

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        low, high = self.intensities
        longer = choose_by_sign(values[0], "longer", "shorter")
        return (
            f"the ranges of {self.subject} depend on intensity: they are "
            f"{format_value_sigma(values[0], sigma[0], MM_PER_M, 'mm')} {longer} at intensity "
            f"{low:.3g} than at {high:.3g}"
        )

    @property
    def remedy(self) -> str:
        return "let it be estimated (solve.estimate.lidar_corrections: auto)"

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.lidar_corrections", "auto")

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        return self._lengthen_weak_returns(model, values)

    def _lengthen_weak_returns(self, lidar: LidarModel, excess: np.ndarray) -> LidarModel:
        """Return the lidar whose weak returns are longer by an excess (1,)."""
        now = lidar.intensity_ranges[0] if lidar.intensity_ranges else 0.0
        return replace(lidar, intensity_ranges=(now + float(excess[0]), *self.intensities))


def make_intensity_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of every lidar whose returns on targets differ in intensity."""
    for name, lidar in sorted(setup.models.items()):
        low, high = _intensity_limits(setup, name)
        if isinstance(lidar, LidarModel) and high > low:
            sigma = np.array([lidar.beam_range_sigma])
            yield IntensityRangeCorrection(name, sigma, (low, high))


def _intensity_limits(setup: Setup, sensor: str) -> tuple[float, float]:
    """Return a low and a high intensity of a sensor's returns, 0 and 0 if it has none."""
    values = [
        np.asarray(g.keypoints["intensity"], float)
        for g in setup.groups
        if g.sensor == sensor and g.kind == "target_surface" and "intensity" in g.keypoints
    ]
    known = np.concatenate([np.zeros(0), *values])
    known = known[np.isfinite(known)]
    if not len(known):
        return 0.0, 0.0
    low, high = np.quantile(known, INTENSITY_QUANTILES)
    return float(low), float(high)
