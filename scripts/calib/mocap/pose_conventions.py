"""Quaternion order and up axis of motion capture, inferred from the poses."""

from typing import NamedTuple

import numpy as np

from calib.geometry.frame_graph import Edge
from calib.io.parquet_tables import Columns
from calib.mocap.pose_faults import flag_single_poses

INFERRED = "auto"  # value of mocap.quaternions: the order that the poses tell
# Path of a body that drives and turns on a floor: thickness / width, width, rotation.
MAX_FLOOR_THICKNESS_RATIO, MIN_FLOOR_SPREAD_M, MIN_TURN_RAD = 0.1, 0.2, 0.5
# Cosines between the rotation axis and the floor's normal.
MIN_COS_ALONG_NORMAL, MAX_COS_ACROSS_NORMAL = 0.9, 0.5
# Cosines of the tilt of an upright body, and of one that is not.
MIN_COS_UPRIGHT, MAX_COS_LYING = 0.94, 0.5
MAX_POSES_CHECKED = 2000  # of a stream


class TurnAxes(NamedTuple):
    """Rotation axis of a body that drives on a floor.

    cos_xyzw, cos_wxyz: |cosine| of its angle to the floor's normal, with quaternions read as xyzw
    and as wxyz; normal: (3,) of the floor, map frame.
    """

    cos_xyzw: float
    cos_wxyz: float
    normal: np.ndarray


def to_xyzw(
    columns_by_edge: dict[Edge, Columns], order: str = INFERRED
) -> tuple[dict[Edge, Columns], list[str]]:
    """Return the edges of a topic with quaternions as xyzw, and notes on what was inferred.

    columns_by_edge: {(parent, child): columns}, m. order: xyzw, wxyz, or INFERRED.
    """
    notes = []
    compared = [_compare_turn_axes(c["xyz"], c["quat"]) for c in columns_by_edge.values()]
    axes = [a for a in compared if a is not None]
    rolls_as_xyzw = bool(axes) and all(
        a.cos_xyzw < MAX_COS_ACROSS_NORMAL and a.cos_wxyz > MIN_COS_ALONG_NORMAL for a in axes
    )
    if order == "wxyz" or (order == INFERRED and rolls_as_xyzw):
        if order == INFERRED:
            notes.append(
                "quaternions read as w, x, y, z: as x, y, z, w a body would roll as it drives"
            )
        columns_by_edge = {
            k: c | {"quat": np.roll(c["quat"], -1, axis=1)} for k, c in columns_by_edge.items()
        }
    elif order == INFERRED:
        upright = [child for (_, child), c in columns_by_edge.items() if _is_upright_as_wxyz(c)]
        if upright:
            notes.append(
                f"quaternion order may be w, x, y, z: {upright[0]} is upright only in that order. "
                "Read as x, y, z, w. If no target is found, set mocap.quaternions to wxyz."
            )
    if axes and all(abs(a.normal[1]) > MIN_COS_ALONG_NORMAL for a in axes):
        notes.append("the y axis of the map points up: bodies drive across it. No result changes.")
    return columns_by_edge, notes


def _is_upright_as_wxyz(columns: Columns) -> bool:
    """Return whether a body is always upright with quaternions read as wxyz, and never as xyzw."""
    xyz, quat = columns["xyz"], columns["quat"]
    quat = quat[flag_single_poses(xyz, quat) == ""]
    if len(quat) == 0:
        return False
    cos_xyzw, cos_wxyz = (1 - 2 * (q[:, :2] ** 2).sum(1) for q in (quat, np.roll(quat, -1, axis=1)))
    return bool(cos_xyzw.max() < MAX_COS_LYING and cos_wxyz.min() > MIN_COS_UPRIGHT)


def _compare_turn_axes(xyz: np.ndarray, quat: np.ndarray) -> TurnAxes | None:
    """Compare the rotation axis of a body that drives on a floor with the floor's normal.

    Returns None for a body that does not drive or does not turn.
    """
    good = np.flatnonzero(flag_single_poses(xyz, quat) == "")
    good = good[:: max(1, len(good) // MAX_POSES_CHECKED)]
    if len(good) < 10:
        return None
    _, size, axes = np.linalg.svd(xyz[good] - xyz[good].mean(0), full_matrices=False)
    size = size / np.sqrt(len(good))
    if size[1] < MIN_FLOOR_SPREAD_M or size[2] > MAX_FLOOR_THICKNESS_RATIO * size[1]:
        return None
    axis_xyzw = _find_turn_axis(quat[good])
    axis_wxyz = _find_turn_axis(np.roll(quat[good], -1, axis=1))
    if axis_xyzw is None or axis_wxyz is None:
        return None
    normal = axes[2]
    return TurnAxes(abs(float(axis_xyzw @ normal)), abs(float(axis_wxyz @ normal)), normal)


def _find_turn_axis(quat: np.ndarray) -> np.ndarray | None:
    """Return the unit axis (3,), map frame, about which orientations differ most, or None."""
    v, w, v0, w0 = quat[:, :3], quat[:, 3:], quat[0, :3], quat[0, 3]
    turns = w0 * v - w * v0 - np.cross(v, v0)  # vector part of q q0⁻¹
    _, size, axes = np.linalg.svd(turns, full_matrices=False)
    return axes[0] if size[0] / np.sqrt(len(turns)) > np.sin(MIN_TURN_RAD / 2) else None
