"""Poses of a body in the map, composed from those of the frames between."""

import numpy as np

from calib.geometry import se3
from calib.io import pose_block
from calib.mocap import body_trajectory, pose_faults


def composed(chain, edges, static, max_gap):
    """Columns of a body at the stamps of the last edge of its chain that moves; of a body that
    never does, at those of whatever moves most. None where nothing moves, or where a static
    transform is no pose."""
    moving = [e for e in chain if e in edges]
    if moving:
        base = edges[moving[-1]]
    elif edges:
        base = max(edges.values(), key=lambda c: len(c["t"]))
        base = base | {"fault": np.full(len(base["t"]), "", object)}
    else:
        return None
    fixed = [e for e in chain if e not in edges]
    if not all(_is_pose(static[e]) for e in fixed):
        return None
    static = {e: pose_block.pose(static[e]) for e in fixed}
    fine = base["fault"] == ""
    T, known = np.tile(np.eye(4), (fine.sum(), 1, 1)), np.ones(fine.sum(), bool)
    for edge in chain:
        step, there = _at(edge, edges, static, base, fine, max_gap, edge in moving[-1:])
        T, known = T @ step, known & there
    return base | _filled(base, fine, T, known)


def _is_pose(block):
    """Whether a static transform of a log is a rigid motion."""
    norm = np.linalg.norm(block["quat_xyzw"])
    return bool(np.isfinite(block["xyz_m"]).all() and abs(norm - 1) < pose_faults.NORM)


def _at(edge, edges, static, base, fine, max_gap, is_base):
    """Poses (n, 4, 4) of an edge at the base's stamps without fault, and whether they are known."""
    n = fine.sum()
    if is_base:
        T = se3.from_xyz_quat(base["xyz"][fine], base["quat"][fine])
        return T, np.ones(n, bool)
    if edge in edges:
        columns = edges[edge]
        rows = columns["fault"] == ""
        T = se3.from_xyz_quat(columns["xyz"][rows], columns["quat"][rows])
        return body_trajectory.Trajectory(columns["t"][rows], T, max_gap).at(base["t"][fine])
    return np.tile(static[edge], (n, 1, 1)), np.ones(n, bool)


def _filled(base, fine, T, known):
    """xyz, quat and fault of the base's rows, those without fault replaced by the poses T."""
    xyz, quat, fault = (base[k].copy() for k in ("xyz", "quat", "fault"))
    xyz[fine], quat[fine] = T[:, :3, 3], se3.to_quat(T)
    rows = np.flatnonzero(fine)
    fault[rows[~known]] = "no pose of its parent"
    return {"xyz": xyz, "quat": quat, "fault": fault}
