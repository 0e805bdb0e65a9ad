"""Lines and points that show the shape of a target in drawings."""

import numpy as np

from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.target_shapes import TargetShape

N_CIRCLE_CORNERS = 24


def sample_outline_edges(target: TargetShape, n_per_edge: int) -> np.ndarray:
    """Return points (k, 3), m, target frame, along the straight outline edges, if it has any."""
    fraction = np.linspace(0, 1, n_per_edge)[:, None]
    return np.reshape([a + fraction * (b - a) for a, b in target.outline_edges()], (-1, 3))


def trace_target_outline(target: TargetShape) -> list[np.ndarray]:
    """Return lines (k, 3), m, target frame, that show the shape of a target.

    A board: its closed outline; a cylinder: both end circles and four lines along it; a template:
    the diagonal of its bounding box.
    """
    if isinstance(target, Board):
        closed = np.vstack([target.vertices, target.vertices[:1]])
        return [np.column_stack([closed, np.zeros(len(closed))])]
    if isinstance(target, Cylinder):
        angle = np.linspace(0, 2 * np.pi, N_CIRCLE_CORNERS)
        ring = target.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        ends = [
            np.column_stack([np.full(N_CIRCLE_CORNERS, x), ring])
            for x in (-target.length / 2, target.length / 2)
        ]
        quarters = range(0, N_CIRCLE_CORNERS - 1, N_CIRCLE_CORNERS // 4)
        return ends + [np.stack([ends[0][i], ends[1][i]]) for i in quarters]
    assert target.point_template is not None  # a shape without faces consists of its points
    low, high = target.point_template.xyz.min(0), target.point_template.xyz.max(0)
    return [np.array([low, high])]
