"""A board that is not flat: bowed along x and along y, and twisted."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.estimation.corrections.base import TargetCorrection, TargetModelCorrection
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.group_linearization import FINITE_STEP_M, GroupLinearization
from calib.estimation.corrections.number_wording import MIN_SHOWN_SIGMAS, format_value_sigma
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.geometry.units import MM_PER_M
from calib.io.config_change import ConfigChange, pipeline_change
from calib.targets.board import Board

BOARD_SHAPE = "board_shape"  # name of the correction
BOARD_KINDS = frozenset({"pattern_corner", "target_surface", "board_outline"})
N_SHAPE_VALUES = 3
# What a positive and a negative value of bow_x, bow_y and twist look like from before the face.
SHAPE_WORDS = (
    ("bowed along its x", "middle nearer", "middle farther"),
    ("bowed along its y", "middle nearer", "middle farther"),
    ("twisted", "corners at +x+y nearer", "corners at +x+y farther"),
)


@dataclass(frozen=True)
class BoardShapeCorrection(TargetModelCorrection):
    """bow_x, bow_y and twist (3,), m, of a board, beyond those of its config (Board.warp)."""

    name = BOARD_SHAPE
    kinds = BOARD_KINDS

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(_warp_board, [FINITE_STEP_M] * N_SHAPE_VALUES)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        ratio = np.abs(values) / np.where(sigma > 0, sigma, np.inf)
        parts = [
            f"{what} by {format_value_sigma(v, s, MM_PER_M, 'mm')} ({above if v > 0 else below})"
            for (what, above, below), v, s, r in zip(SHAPE_WORDS, values, sigma, ratio, strict=True)
            if r >= min(MIN_SHOWN_SIGMAS, ratio.max())
        ]
        return f"{self.subject} is not flat: {', '.join(parts)}"

    @property
    def remedy(self) -> str:
        return (
            "set solve.estimate.board_shape: auto, or glue the print of "
            f"{self.subject} to a stiff, flat plate"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.board_shape", "auto")

    def apply_to_target(self, target: Board, values: np.ndarray) -> Board:
        return _warp_board(target, values)


def make_board_shape_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the correction of the shape of every board whose config states how flat it is."""
    for name in sorted({setup.placements[g.placement].target for g in setup.groups}):
        board = setup.targets[name]
        if isinstance(board, Board) and board.uses_exact_surface and board.flatness:
            yield BoardShapeCorrection(name, np.full(N_SHAPE_VALUES, board.flatness))


def board_shapes_json(setup: Setup, result: EstimationResult) -> dict[str, Any]:
    """Return {description, estimate, sigma, prior_sigma} of the estimated shapes, by board.

    bow_x, bow_y, twist (3,), m.
    """
    return {
        e.correction.subject: {
            "description": e.correction.describe(e.values, e.sigma),
            "estimate": e.values.tolist(),
            "sigma": e.sigma.tolist(),
            "prior_sigma": e.correction.prior_sigma.tolist(),
        }
        for e in correction_estimates(setup, result)
        if e.correction.name == BOARD_SHAPE
    }


def _warp_board(board: Board, values: np.ndarray) -> Board:
    bow_x, bow_y, twist = np.add(board.warp, values).tolist()
    return replace(board, warp=(bow_x, bow_y, twist))
