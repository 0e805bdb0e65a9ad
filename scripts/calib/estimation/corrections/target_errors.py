"""Possible errors of a target: its sizes, and its mount T_body_target."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from calib.estimation.corrections.base import TargetCorrection
from calib.estimation.corrections.group_linearization import (
    FINITE_STEP_M,
    FINITE_STEP_RATIO,
    GroupLinearization,
)
from calib.estimation.corrections.number_wording import (
    MIN_SHOWN_SIGMAS,
    choose_by_sign,
    format_twist_sigma,
    format_value_sigma,
)
from calib.estimation.estimation_problem import Setup
from calib.geometry.units import MM_PER_M, SHARE_TO_PERCENT
from calib.io.config_change import ConfigChange, pipeline_change, target_change
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder

PATTERN_KINDS, BOARD_OUTLINE_KINDS = frozenset({"pattern_corner"}), frozenset({"board_outline"})
MAX_TESTED_EDGES = 8  # an outline with more edges is tested as a whole only
MIN_BEND_SINE = 0.1  # at every corner of an outline whose edges are tested one by one
MAX_SIZE_SHARE = 0.5  # relative error of a size
Shape = TypeVar("Shape")


@dataclass(frozen=True)
class SquareSizeCorrection(TargetCorrection):
    """Relative error of the size of a pattern about its middle. square_m: as configured."""

    name = "square_size"
    kinds = PATTERN_KINDS
    n_values = 1
    max_size = MAX_SIZE_SHARE
    square_m: float

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(_scale_pattern, [FINITE_STEP_RATIO])

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the squares of {self.subject} are {_format_share(values, sigma)} "
            f"{choose_by_sign(values[0], 'larger', 'smaller')} than configured: square_m "
            f"{self.square_m * (1 + values[0]):.4g}, not {self.square_m:.4g}"
        )

    @property
    def remedy(self) -> str:
        return f"measure square_m of {self.subject} with a calliper over several squares"

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return _size_change(self.subject, "pattern.square_m", self.square_m, values)


@dataclass(frozen=True)
class OutlineSizeCorrection(TargetCorrection):
    """Relative error of the size of a board's outline about its middle."""

    name = "outline_size"
    kinds = BOARD_OUTLINE_KINDS
    n_values = 1
    max_size = MAX_SIZE_SHARE

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(_scale_outline, [FINITE_STEP_RATIO])

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the outline of {self.subject} is {_format_share(values, sigma)} "
            f"{choose_by_sign(values[0], 'larger', 'smaller')} than outline_m"
        )

    @property
    def remedy(self) -> str:
        return _outline_remedy(self.subject)


@dataclass(frozen=True)
class EdgeOffsetCorrection(TargetCorrection):
    """Offsets of the n_edges edges of a board's outline, outwards, m."""

    name = "outline_edges"
    kinds = BOARD_OUTLINE_KINDS
    n_edges: int

    @property
    def n_values(self) -> int:
        return self.n_edges

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(_offset_edges, [FINITE_STEP_M] * self.n_edges)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        largest = np.abs(values).max() * (1 - FINITE_STEP_RATIO)
        edges = [
            f"edge {i + 1} {format_value_sigma(t, s, MM_PER_M, 'mm')} "
            f"{choose_by_sign(t, 'outside', 'inside')}"
            for i, (t, s) in enumerate(zip(values, sigma, strict=True))
            if abs(t) > min(MIN_SHOWN_SIGMAS * s, largest)
        ]
        return (
            f"the outline of {self.subject} differs from outline_m: {', '.join(edges)} "
            "(edge 1 joins the first two corners)"
        )

    @property
    def remedy(self) -> str:
        return _outline_remedy(self.subject)


@dataclass(frozen=True)
class RadiusCorrection(TargetCorrection):
    """Relative error of the radius of a cylinder. radius_m: as configured."""

    name = "radius"
    n_values = 1
    max_size = MAX_SIZE_SHARE
    radius_m: float

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(
            lambda target, values: replace(target, radius=target.radius * (1 + values[0])),
            [FINITE_STEP_RATIO],
        )

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return _describe_cylinder_size("radius", self.subject, self.radius_m, values, sigma)

    @property
    def remedy(self) -> str:
        return f"measure the circumference of {self.subject}; radius_m is circumference / 2π"

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return _size_change(self.subject, "radius_m", self.radius_m, values)


@dataclass(frozen=True)
class LengthCorrection(TargetCorrection):
    """Relative error of the length of a cylinder. length_m: as configured."""

    name = "length"
    n_values = 1
    max_size = MAX_SIZE_SHARE
    length_m: float

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.derivative_by_target(
            lambda target, values: replace(target, length=target.length * (1 + values[0])),
            [FINITE_STEP_RATIO],
        )

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return _describe_cylinder_size("length", self.subject, self.length_m, values, sigma)

    @property
    def remedy(self) -> str:
        return f"measure length_m of {self.subject}"

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return _size_change(self.subject, "length_m", self.length_m, values)


@dataclass(frozen=True)
class MountCorrection(TargetCorrection):
    """Right perturbation of T_body_target, of a target whose mount is not estimated.

    T_body_target: (4, 4) as configured.
    """

    name = "mount"
    n_values = 6
    T_body_target: np.ndarray = field(repr=False)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        return linearization.pose_derivative

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"T_body_target of {self.subject} is off along and about the target's own x, y, z by "
            f"{format_twist_sigma(values, sigma)}"
        )

    @property
    def remedy(self) -> str:
        return (
            f"measure T_body_target of {self.subject} again, or set "
            "solve.estimate.target_alignment: true"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange:
        return pipeline_change("solve.estimate.target_alignment", True)

    def add_to_setup(self, setup: Setup) -> Setup | None:
        if self.subject not in setup.mount_sigma:
            return None
        mounts = setup.initial_mounts | {self.subject: self.T_body_target}
        return replace(setup, initial_mounts=mounts)


def make_square_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the correction of the pattern of every board that has one."""
    for name, board in _targets_of_shape(setup, Board):
        pattern: Any = board.pattern
        if pattern is not None:
            yield SquareSizeCorrection(name, pattern.square_m)


def make_outline_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the corrections of the outline of every board: as a whole, and edge by edge."""
    for name, board in _targets_of_shape(setup, Board):
        yield OutlineSizeCorrection(name)
        n = len(board.vertices)
        if n <= MAX_TESTED_EDGES and _bend_sines(board.vertices).min() > MIN_BEND_SINE:
            yield EdgeOffsetCorrection(name, n)


def make_cylinder_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the corrections of radius and length of every cylinder."""
    for name, cylinder in _targets_of_shape(setup, Cylinder):
        yield RadiusCorrection(name, cylinder.radius)
        yield LengthCorrection(name, cylinder.length)


def make_mount_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the correction of every mount that is not estimated."""
    for name, _ in _targets_of_shape(setup, object):
        if name not in setup.initial_mounts:
            T = next(p.T_body_target for p in setup.placements if p.target == name)
            yield MountCorrection(name, T)


def _targets_of_shape(setup: Setup, shape: type[Shape]) -> list[tuple[str, Shape]]:
    """Return (name, target) of the targets in use of a shape that are compared exactly."""
    used = sorted({setup.placements[g.placement].target for g in setup.groups})
    targets = [(n, setup.targets[n]) for n in used]
    return [(n, t) for n, t in targets if t.uses_exact_surface and isinstance(t, shape)]


def _scale_pattern(board: Board, values: np.ndarray) -> Board:
    pattern: Any = board.pattern
    return replace(board, pattern=pattern.with_scale(1 + values[0]))


def _scale_outline(board: Board, values: np.ndarray) -> Board:
    middle = board.centre[:2]
    return replace(board, vertices=middle + (1 + values[0]) * (board.vertices - middle))


def _offset_edges(board: Board, values: np.ndarray) -> Board:
    return replace(board, vertices=_move_edges(board.vertices, values))


def _move_edges(vertices: np.ndarray, outwards: np.ndarray) -> np.ndarray:
    """Return the outline (n, 2) with edge i, from corner i to the next, moved outwards[i], m."""
    along = np.roll(vertices, -1, 0) - vertices
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    x, y = vertices.T
    normal *= np.sign(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    offset = np.sum(normal * vertices, 1) + outwards
    pairs = np.stack([np.roll(normal, 1, 0), normal], 1)
    return np.linalg.solve(pairs, np.stack([np.roll(offset, 1), offset], 1)[..., None])[..., 0]


def _bend_sines(vertices: np.ndarray) -> np.ndarray:
    """Return the sine (n,) of the bend of an outline (n, 2) at each corner."""
    along = np.roll(vertices, -1, 0) - vertices
    along = along / np.linalg.norm(along, axis=1)[:, None]
    before = np.roll(along, 1, 0)
    return np.abs(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0])


def _format_share(values: np.ndarray, sigma: np.ndarray) -> str:
    return format_value_sigma(values[0], sigma[0], SHARE_TO_PERCENT, "%")


def _describe_cylinder_size(
    size: str, name: str, configured_m: float, values: np.ndarray, sigma: np.ndarray
) -> str:
    return (
        f"the {size} of {name} is {_format_share(values, sigma)} "
        f"{choose_by_sign(values[0], 'larger', 'smaller')} than configured: {size}_m "
        f"{configured_m * (1 + values[0]):.4g}, not {configured_m:.4g}"
    )


def _size_change(name: str, key: str, configured_m: float, values: np.ndarray) -> ConfigChange:
    """Return the change of a size to the estimate; values: (relative error,)."""
    return target_change(name, key, float(f"{configured_m * (1 + values[0]):.6g}"))


def _outline_remedy(name: str) -> str:
    return f"measure the sides of {name} and their place in its frame for outline_m"
