"""Poses of a body in the map, composed along the frames in between."""

from typing import Any, TypeAlias

import numpy as np

from calib.geometry.frame_graph import Edge
from calib.geometry.se3 import pose_from_xyz_quat, pose_to_quat
from calib.io.parquet_tables import Columns
from calib.io.pose_block import pose_from_config
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.pose_faults import MAX_QUAT_NORM_ERROR

PoseBlock: TypeAlias = dict[str, Any]  # xyz_m, quat_xyzw


def compose_body_poses(
    chain: list[Edge],
    columns_by_edge: dict[Edge, Columns],
    static_poses: dict[Edge, PoseBlock],
    max_gap_ns: int,
) -> Columns | None:
    """Return the columns of a body in the map, composed along a chain of edges.

    chain: edges (parent, child) from the map to the body; columns_by_edge: of the moving
    edges, with faults; static_poses: pose blocks of the static edges; max_gap_ns: longest
    gap to interpolate. The rows are those of the last moving edge; without one, those of the
    edge with most poses. Returns None if nothing moves, or if a static transform is not a pose.
    """
    moving = [e for e in chain if e in columns_by_edge]
    if moving:
        base = columns_by_edge[moving[-1]]
    elif columns_by_edge:
        base = max(columns_by_edge.values(), key=lambda c: len(c["stamp_ns"]))
        base = base | {"fault": np.full(len(base["stamp_ns"]), "", object)}
    else:
        return None
    static = [e for e in chain if e not in columns_by_edge]
    if not all(_is_rigid(static_poses[e]) for e in static):
        return None
    good = base["fault"] == ""
    T, known = np.tile(np.eye(4), (good.sum(), 1, 1)), np.ones(good.sum(), bool)
    for edge in chain:
        if edge in static:
            T = T @ np.tile(pose_from_config(static_poses[edge]), (good.sum(), 1, 1))
        elif edge == moving[-1]:
            T = T @ pose_from_xyz_quat(base["xyz"][good], base["quat"][good])
        else:
            trajectory = _edge_trajectory(columns_by_edge[edge], max_gap_ns)
            T_parent_child, is_known = trajectory.poses_at(base["stamp_ns"][good])
            T, known = T @ T_parent_child, known & is_known
    return base | _replace_good_poses(base, good, T, known)


def _is_rigid(block: PoseBlock) -> bool:
    """Return whether a static transform of a log is a rigid motion."""
    norm = np.linalg.norm(block["quat_xyzw"])
    return bool(np.isfinite(block["xyz_m"]).all() and abs(norm - 1) < MAX_QUAT_NORM_ERROR)


def _edge_trajectory(columns: Columns, max_gap_ns: int) -> Trajectory:
    """Return the trajectory of an edge's poses without fault."""
    rows = columns["fault"] == ""
    T = pose_from_xyz_quat(columns["xyz"][rows], columns["quat"][rows])
    return Trajectory(columns["stamp_ns"][rows], T, max_gap_ns)


def _replace_good_poses(
    base: Columns, good_rows: np.ndarray, T: np.ndarray, known: np.ndarray
) -> Columns:
    """Return xyz, quat and fault of the base's rows, with the good rows replaced by poses T."""
    xyz, quat, fault = (base[k].copy() for k in ("xyz", "quat", "fault"))
    xyz[good_rows], quat[good_rows] = T[:, :3, 3], pose_to_quat(T)
    rows = np.flatnonzero(good_rows)
    fault[rows[~known]] = "no pose of its parent"
    return {"xyz": xyz, "quat": quat, "fault": fault}
