"""Projections of a target on the page, in which a scan of it is drawn."""

from dataclasses import dataclass, field

import numpy as np

from calib.geometry.se3 import invert_pose
from calib.geometry.units import MM_PER_M
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.target_outline import trace_target_outline
from calib.targets.target_shapes import TargetShape

EDGE_ON_RANGE_M = (0.05, 0.3)  # smallest and largest shown distance from a surface
N_CIRCLE_CORNERS = 90


@dataclass(frozen=True)
class TargetProjection:
    """A target as seen from one side.

    rotation (3, 3): of the target frame before the projection; axes: those on the page; outline
    (n, 2), m: of the target; half_height_mm: shown distance of a second axis magnified to mm, or
    None; share: of the width of the figure; has_line: whether the outline is a line, not points.
    """

    title: str
    axes: tuple[int, int]
    xlabel: str
    ylabel: str
    outline: np.ndarray
    half_height_mm: float | None = None
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    share: float = 1.0
    has_line: bool = True

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return points (n, 3), target frame, on the page (n, 2), m."""
        return (np.asarray(points) @ self.rotation.T)[:, list(self.axes)]

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest corner (2,) of what is shown, m, or mm if magnified."""
        low, high = self.outline.min(0), self.outline.max(0)
        if self.half_height_mm is None:
            margin = 0.16 * (high - low).max()
            return low - margin, high + margin
        margin = 0.16 * (high[0] - low[0])
        return (
            np.array([low[0] - margin, -self.half_height_mm]),
            np.array([high[0] + margin, self.half_height_mm]),
        )


def choose_projections(
    target: TargetShape, T_sensor_target: np.ndarray, guess_points: np.ndarray
) -> tuple[TargetProjection, TargetProjection]:
    """Return two projections of a target; guess_points (n, 3), target frame, should be visible."""
    if isinstance(target, Board):
        return make_board_projections(target, guess_points)
    if isinstance(target, Cylinder):
        return make_cylinder_projections(target, T_sensor_target)
    assert target.point_template is not None  # a shape without faces consists of its points
    return make_template_projections(target.point_template.xyz)


def make_board_projections(
    board: Board, guess_points: np.ndarray
) -> tuple[TargetProjection, TargetProjection]:
    """Project a board face on, and edge on along its wider side with magnified distances."""
    outline = trace_target_outline(board)[0][:, :2]
    low, high = board.vertices.min(0), board.vertices.max(0)
    wide = int(np.ptp(board.vertices, axis=0).argmax())
    distance = np.quantile(np.abs(guess_points[:, 2]), 0.98) if len(guess_points) else 0.0
    half_height_mm = float(MM_PER_M * np.clip(1.1 * distance, *EDGE_ON_RANGE_M))
    return (
        TargetProjection("face on", (0, 1), "x, m", "y, m", outline),
        TargetProjection(
            title="edge on",
            axes=(wide, 2),
            xlabel=f"{'xy'[wide]}, m",
            ylabel="distance from the face, mm",
            outline=np.array([[low[wide], 0.0], [high[wide], 0.0]]),
            half_height_mm=half_height_mm,
        ),
    )


def make_cylinder_projections(
    cylinder: Cylinder, T_sensor_target: np.ndarray
) -> tuple[TargetProjection, TargetProjection]:
    """Project a cylinder from the side, and along its axis with the sensor below."""
    eye = invert_pose(T_sensor_target)[:3, 3]
    away = -eye[1:] / max(np.linalg.norm(eye[1:]), 1e-9)
    rotation = np.eye(3)
    rotation[1, 1:], rotation[2, 1:] = [-away[1], away[0]], away
    x, r = cylinder.length / 2, cylinder.radius
    angle = np.linspace(0, 2 * np.pi, N_CIRCLE_CORNERS)
    return (
        TargetProjection(
            title="from the side",
            axes=(0, 1),
            xlabel="along the axis, m",
            ylabel="across, m",
            outline=np.array([[-x, -r], [x, -r], [x, r], [-x, r], [-x, -r]]),
            rotation=rotation,
            share=1.6,
        ),
        TargetProjection(
            title="along the axis",
            axes=(1, 2),
            xlabel="across, m",
            ylabel="away from the sensor, m",
            outline=r * np.column_stack([np.cos(angle), np.sin(angle)]),
            rotation=rotation,
        ),
    )


def make_template_projections(
    template: np.ndarray,
) -> tuple[TargetProjection, TargetProjection]:
    """Project a template from above and from the side; its points (n, 3) are the outline."""
    above, side = (
        TargetProjection(
            title=f"x and {name}",
            axes=(0, axis),
            xlabel="x, m",
            ylabel=f"{name}, m",
            outline=template[:, [0, axis]],
            has_line=False,
        )
        for axis, name in ((1, "y"), (2, "z"))
    )
    return above, side
