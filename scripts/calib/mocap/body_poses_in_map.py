"""Poses of a body in the map, composed from those of the frames between."""

import numpy as np

from calib.geometry.se3 import pose_from_xyz_quat, pose_to_quat
from calib.io.pose_block import pose_from_config
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.pose_faults import MAX_QUAT_NORM_ERROR


def compose_body_poses(chain, columns_by_edge, static_poses, max_gap_ns):
    """Columns of a body at the stamps of the last edge of its chain that moves; of a body that
    never does, at those of whatever moves most. None where nothing moves, or where a static
    transform is no pose."""
    moving = [e for e in chain if e in columns_by_edge]
    if moving:
        base = columns_by_edge[moving[-1]]
    elif columns_by_edge:
        base = max(columns_by_edge.values(), key=lambda c: len(c["stamp_ns"]))
        base = base | {"fault": np.full(len(base["stamp_ns"]), "", object)}
    else:
        return None
    fixed = [e for e in chain if e not in columns_by_edge]
    if not all(_is_rigid(static_poses[e]) for e in fixed):
        return None
    static_poses = {e: pose_from_config(static_poses[e]) for e in fixed}
    fine = base["fault"] == ""
    T, known = np.tile(np.eye(4), (fine.sum(), 1, 1)), np.ones(fine.sum(), bool)
    for edge in chain:
        step, there = _edge_poses_at_base(
            edge, columns_by_edge, static_poses, base, fine, max_gap_ns, edge in moving[-1:]
        )
        T, known = T @ step, known & there
    return base | _replace_good_poses(base, fine, T, known)


def _is_rigid(block):
    """Whether a static transform of a log is a rigid motion."""
    norm = np.linalg.norm(block["quat_xyzw"])
    return bool(np.isfinite(block["xyz_m"]).all() and abs(norm - 1) < MAX_QUAT_NORM_ERROR)


def _edge_poses_at_base(edge, edges, static, base, good_rows, max_gap, is_base):
    """Poses (n, 4, 4) of an edge at the base's stamps without fault, and whether they are known."""
    n = good_rows.sum()
    if is_base:
        T = pose_from_xyz_quat(base["xyz"][good_rows], base["quat"][good_rows])
        return T, np.ones(n, bool)
    if edge in edges:
        columns = edges[edge]
        rows = columns["fault"] == ""
        T = pose_from_xyz_quat(columns["xyz"][rows], columns["quat"][rows])
        return Trajectory(columns["stamp_ns"][rows], T, max_gap).poses_at(
            base["stamp_ns"][good_rows]
        )
    return np.tile(static[edge], (n, 1, 1)), np.ones(n, bool)


def _replace_good_poses(base, good_rows, T, known):
    """xyz, quat and fault of the base's rows, those without fault replaced by the poses T."""
    xyz, quat, fault = (base[k].copy() for k in ("xyz", "quat", "fault"))
    xyz[good_rows], quat[good_rows] = T[:, :3, 3], pose_to_quat(T)
    rows = np.flatnonzero(good_rows)
    fault[rows[~known]] = "no pose of its parent"
    return {"xyz": xyz, "quat": quat, "fault": fault}
