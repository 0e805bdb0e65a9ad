"""Possible errors of the outlines in a lidar's scans: seen too wide, or from another place."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, SensorCorrection
from calib.estimation.corrections.group_linearization import (
    FINITE_STEP_M,
    FINITE_STEP_RATIO,
    GroupLinearization,
)
from calib.estimation.corrections.number_wording import (
    choose_by_sign,
    format_value_sigma,
    format_vector_sigma,
)
from calib.estimation.estimation_problem import Setup
from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.sensors.lidar.lidar_model import LidarModel

BOARD_OUTLINE_KINDS = frozenset({"board_outline"})
BEAM_WIDTH = "beam_width"  # name of the correction
OUTLINE_TWIST_SIGMA = np.repeat([0.03, np.radians(1.0)], 3)  # m, rad: of two views of one lidar


@dataclass(frozen=True)
class PlacementBeamWidthCorrection(ModelCorrection[LidarModel]):
    """A width, m, by which a lidar sees outlines wider all round, for each of placements (q,).

    It depends on the distance of a target, its brightness and its background. With a width for
    every placement, outlines determine directions, and no sizes.
    """

    name = BEAM_WIDTH
    kinds = BOARD_OUTLINE_KINDS
    placements: np.ndarray = field(repr=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        by_width = linearization.derivative_by_model(
            lambda lidar, values: _widen_beams(lidar, (values[0], 0.0)), [FINITE_STEP_M]
        )
        return (self.placements == linearization.group.placement)[:, None, None] * by_width

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        widths = values.min(), values.max(), values.mean()
        least, most, mean = (f"{MM_PER_M * v:.1f}" for v in widths)
        return (
            f"outlines in the scans of {self.subject} are seen {mean} mm wider all round in the "
            f"mean, {least} to {most} mm in single placements"
        )

    @property
    def remedy(self) -> str:
        return _beam_width_remedy(self.subject)

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        return _widen_beams(model, (float(values[self.placements == placement].sum()), 0.0))


@dataclass(frozen=True)
class BeamWidthCorrection(SensorCorrection):
    """A width, m, and an angle, rad, by which a lidar sees outlines wider all round.

    by_placement: the correction that is estimated if a score test finds this one.
    """

    name = BEAM_WIDTH
    kinds = BOARD_OUTLINE_KINDS
    n_values = 2
    by_placement: PlacementBeamWidthCorrection = field(repr=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        steps = [FINITE_STEP_M, FINITE_STEP_RATIO]
        return linearization.derivative_by_model(_widen_beams, steps)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"outlines in the scans of {self.subject} are seen "
            f"{format_value_sigma(values[0], sigma[0], MM_PER_M, 'mm')} "
            f"{choose_by_sign(values[0], 'wider', 'narrower')} all round, and "
            f"{format_value_sigma(values[1], sigma[1], DEG_PER_RAD, '°')} "
            f"{choose_by_sign(values[1], 'wider', 'narrower')} in proportion to the range"
        )

    @property
    def remedy(self) -> str:
        return _beam_width_remedy(self.subject)

    def add_to_setup(self, setup: Setup) -> Setup:
        return self.by_placement.add_to_setup(setup)


@dataclass(frozen=True)
class OutlineTwistCorrection(ModelCorrection[LidarModel]):
    """Twist (6,) from where a lidar's returns put it to where the outlines in its scans put it.

    An error without another name. The returns are used, because outlines depend on more: the
    width of a beam, how much of it must meet a target, and the background.
    """

    name = "outline_vs_surface"
    kinds = BOARD_OUTLINE_KINDS

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        steps = [FINITE_STEP_M] * 3 + [FINITE_STEP_RATIO] * 3
        return linearization.derivative_by_model(_twist_outlines, steps)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"outlines in the scans of {self.subject} put it elsewhere than its returns do, along "
            "and about its x, y, z by "
            f"{format_vector_sigma(values[:3], sigma[:3], MM_PER_M, 'mm')} and "
            f"{format_vector_sigma(values[3:], sigma[3:], DEG_PER_RAD, '°')}"
        )

    @property
    def remedy(self) -> str:
        return (
            f"find which is wrong: the ranges of {self.subject}, its angles, or the poses of the "
            "motion capture; record targets nearer and farther, and tilted to all sides"
        )

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        return _twist_outlines(model, values)


def make_beam_width_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of the beam width of every lidar that sees outlines."""
    for name, lidar in sorted(setup.models.items()):
        own = [g.placement for g in setup.groups if (g.sensor, g.kind) == (name, "board_outline")]
        if isinstance(lidar, LidarModel) and own:
            placements = np.unique(own)
            sigma = np.full(len(placements), lidar.beam_width_sigma)
            by_placement = PlacementBeamWidthCorrection(name, sigma, placements)
            yield BeamWidthCorrection(name, by_placement)


def make_outline_twist_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of where outlines put every lidar that has outlines and returns."""
    for name, lidar in sorted(setup.models.items()):
        kinds = {g.kind for g in setup.groups if g.sensor == name}
        if isinstance(lidar, LidarModel) and {"board_outline", "target_surface"} <= kinds:
            yield OutlineTwistCorrection(name, OUTLINE_TWIST_SIGMA)


def _widen_beams(
    lidar: LidarModel, width_and_angle: np.ndarray | tuple[float, float]
) -> LidarModel:
    """Return the lidar with beams that see outlines wider by a width, m, and an angle, rad."""
    return replace(lidar, beam_width=tuple(np.add(lidar.beam_width, width_and_angle).tolist()))


def _twist_outlines(lidar: LidarModel, twist: np.ndarray) -> LidarModel:
    return replace(lidar, outline_twist=tuple(np.add(lidar.outline_twist, twist).tolist()))


def _beam_width_remedy(name: str) -> str:
    return (
        f"nothing, if the beam of {name} is about twice that wide: both sides of a target are "
        "affected alike; otherwise measure outline_m"
    )
