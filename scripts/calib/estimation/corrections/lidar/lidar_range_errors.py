"""Possible errors of a lidar's ranges: of all of them alike, and of single beams."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import null_space

from calib.estimation.corrections.base import ModelCorrection, SensorCorrection
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import choose_by_sign, format_value_sigma
from calib.estimation.estimation_problem import Setup
from calib.geometry.units import MM_PER_M, SHARE_TO_PERCENT
from calib.sensors.lidar.lidar_model import LidarModel

RETURN_KINDS = frozenset({"target_surface", "cylinder_cap"})
RANGE_BIAS, BEAM_RANGES = "range_bias", "beam_offsets"  # names of the corrections
MIN_RETURNS_PER_BEAM = 50  # a beam with fewer returns is not tested alone


@dataclass(frozen=True)
class RangeBiasCorrection(ModelCorrection[LidarModel]):
    """A constant error of a lidar's ranges, m; positive: too long."""

    name = RANGE_BIAS
    kinds = RETURN_KINDS

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.range_derivative[None]

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the ranges of {self.subject} are "
            f"{format_value_sigma(values[0], sigma[0], MM_PER_M, 'mm')} "
            f"{choose_by_sign(values[0], 'too long', 'too short')}"
        )

    @property
    def remedy(self) -> str:
        return (
            f"{_range_remedy(self.subject)}; solve.estimate.range_bias: true estimates their error"
        )

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        return replace(model, range_bias=model.range_bias + values[0])


@dataclass(frozen=True)
class RangeScaleCorrection(SensorCorrection):
    """An error of a lidar's ranges in proportion to them; positive: too long."""

    name = "range_scale"
    kinds = RETURN_KINDS
    n_values = 1
    max_size = 0.5

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        # By the expected ranges: noise in both factors would look like a scale.
        assignment = linearization.assignment
        expected = assignment.range + assignment.residual[:, 0]
        return (linearization.range_derivative * expected)[None]

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the ranges of {self.subject} are "
            f"{format_value_sigma(values[0], sigma[0], SHARE_TO_PERCENT, '%')} "
            f"{choose_by_sign(values[0], 'too long', 'too short')}"
        )

    @property
    def remedy(self) -> str:
        return _range_remedy(self.subject)


@dataclass(frozen=True)
class BeamRangeCorrection(ModelCorrection[LidarModel]):
    """Errors of single beams, m, beside the error of all of them.

    The ranges of rings (n,) are too long by basis (n, q) times the values (q,). The basis is
    orthonormal, and the errors sum to zero over all returns.
    """

    name = BEAM_RANGES
    kinds = RETURN_KINDS
    rings: np.ndarray = field(repr=False)
    basis: np.ndarray = field(repr=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        rings = linearization.group.keypoints["feature_index"]
        share = self.basis.T @ (rings == self.rings[:, None])
        return linearization.range_derivative * share[:, None]

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        offsets, spread = self.basis @ values, np.sqrt(self.basis**2 @ sigma**2)
        worst = np.abs(offsets).argmax()
        return (
            f"single beams of {self.subject} read long or short: beam {self.rings[worst]} is "
            f"{format_value_sigma(offsets[worst], spread[worst], MM_PER_M, 'mm')} "
            f"{choose_by_sign(offsets[worst], 'longer', 'shorter')} than the mean of all, rms of "
            f"all {MM_PER_M * np.sqrt(np.mean(offsets**2)):.2g} mm"
        )

    @property
    def remedy(self) -> str:
        return (
            f"correct the ranges of {self.subject} beam by beam, or let it warm up before recording"
        )

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        offsets = np.zeros(max(self.rings.max() + 1, len(model.range_offsets)))
        offsets[: len(model.range_offsets)] = model.range_offsets
        offsets[self.rings] += self.basis @ values
        return replace(model, range_offsets=tuple(offsets.tolist()))


def make_range_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the corrections of all ranges of every lidar."""
    for name, lidar in sorted(setup.models.items()):
        if isinstance(lidar, LidarModel):
            yield RangeBiasCorrection(name, np.array([lidar.beam_range_sigma]))
            yield RangeScaleCorrection(name)


def make_beam_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of single beams of every lidar with two or more well covered beams."""
    for name, lidar in sorted(setup.models.items()):
        if not isinstance(lidar, LidarModel):
            continue
        rings, counts = _count_returns_by_ring(setup, name)
        if len(rings) >= 2:
            basis = null_space(counts[None].astype(float))
            sigma = np.full(len(rings) - 1, lidar.beam_range_sigma)
            yield BeamRangeCorrection(name, sigma, rings, basis)


def _count_returns_by_ring(setup: Setup, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the rings (n,) of a lidar with enough returns, and the number (n,) of returns."""
    own = [
        g.keypoints["feature_index"]
        for g in setup.groups
        if (g.sensor, g.kind) == (sensor, "target_surface")
    ]
    rings, counts = np.unique(np.concatenate([*own, [-1]]), return_counts=True)
    enough = (rings >= 0) & (counts >= MIN_RETURNS_PER_BEAM)
    return rings[enough], counts[enough]


def _range_remedy(name: str) -> str:
    return f"check the ranges of {name} against a wall at a measured distance"
