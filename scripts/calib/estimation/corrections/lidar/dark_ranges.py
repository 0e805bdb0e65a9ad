"""A possible error of a lidar's ranges that depends on what is hit: dark squares read long.

The pattern of a board tells how much of each beam's spot is dark.
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
from calib.targets.board import Board

DARK_RANGES = "dark_ranges"  # name of the correction
COLOUR_NAMES = "the colour of its first square", "the other colour"


@dataclass(frozen=True)
class DarkRangeCorrection(ModelCorrection[LidarModel]):
    """By how much, m, ranges to dark squares are longer than ranges to the rest of a board.

    One value for the dark squares; one for each colour if nobody says which is dark. boards: the
    targets that it is about.
    """

    name = DARK_RANGES
    kinds = frozenset({"target_surface"})
    boards: frozenset[str] = field(repr=False)

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        target = setup.placements[group.placement].target
        return target in self.boards and super().affects(setup, group)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_model(
            _lengthen_dark_ranges, [FINITE_STEP_M] * self.n_values
        )

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        squares, others = ["the dark squares"], "on the light ones"
        if len(values) > 1:
            squares = [f"the squares of {colour}" for colour in COLOUR_NAMES]
            others = "beside the pattern"
        parts = [
            f"{format_value_sigma(v, s, MM_PER_M, 'mm')} {choose_by_sign(v, 'longer', 'shorter')} "
            f"on {where}"
            for v, s, where in zip(values, sigma, squares, strict=True)
        ]
        return (
            f"the ranges of {self.subject} depend on what is hit: they are {' and '.join(parts)} "
            f"of {' and '.join(sorted(self.boards))} than {others}"
        )

    @property
    def remedy(self) -> str:
        boards = " and ".join(sorted(self.boards))
        return (
            f"let it be estimated (solve.estimate.lidar_corrections: auto), or set "
            f"pattern_returns: leave_out for {boards}, which needs a rim beside the pattern"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.lidar_corrections", "auto")

    def apply_to_model(self, model: LidarModel, values: np.ndarray, placement: int) -> LidarModel:
        return _lengthen_dark_ranges(model, values)


def make_dark_range_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the correction of dark squares of every lidar that sees a pattern."""
    for name, lidar in sorted(setup.models.items()):
        boards = _find_patterned_boards(setup, name)
        if isinstance(lidar, LidarModel) and boards:
            sigma = np.full(_count_colours(setup, boards[0]), lidar.beam_range_sigma)
            yield DarkRangeCorrection(name, sigma, frozenset(boards))


def _find_patterned_boards(setup: Setup, sensor: str) -> list[str]:
    """Return the boards that share one number for a lidar: all whose dark squares are known.

    Without any such, the first board with a pattern.
    """
    seen = {
        setup.placements[g.placement].target
        for g in setup.groups
        if (g.sensor, g.kind) == (sensor, "target_surface")
    }
    boards = [
        name
        for name in sorted(seen)
        if isinstance(setup.targets[name], Board)
        and setup.targets[name].pattern is not None
        and not setup.targets[name].leaves_out_pattern
    ]
    known = [name for name in boards if _count_colours(setup, name) == 1]
    return known or boards[:1]


def _count_colours(setup: Setup, board: str) -> int:
    """Return for how many colours of a board's pattern ranges may differ: 1 if dark is known."""
    return int(setup.targets[board].pattern.darkness(np.zeros((1, 2))).shape[1])


def _lengthen_dark_ranges(lidar: LidarModel, excess: np.ndarray) -> LidarModel:
    """Return the lidar with ranges to dark squares, of each colour, longer by an excess (q,)."""
    now = lidar.dark_ranges or np.zeros(len(excess))
    return replace(lidar, dark_ranges=tuple(np.add(now, excess).tolist()))
