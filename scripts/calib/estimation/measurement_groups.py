"""Placements as the estimate sees them, from the columns of placements.parquet."""

import numpy as np

from calib.estimation.estimation_problem import Group, Placement
from calib.geometry import se3
from calib.io import parquet_tables, pose_block

HELD = 1e-3  # of the σ of the MCS


def still(columns, session, targets, mocap, mounts=None, late=0.0):
    """{placement number: Placement} of the still intervals of one session.

    targets: name -> config block; mocap: block with pose_sigma and pose_bias_sigma; mounts: name ->
    T_body_target (4, 4) where it is not that of the config; late: s by which the clocks of the
    sensors may be off. The σ of an averaged pose has a part that averages within the placement, a
    bias that does not, and what the target creeps while nobody knows when a sensor saw it. For
    targets compared by points the poses are held, as in the paper: freed, they take up what the
    nearest points leave, and the search settles before it has arrived.
    """
    white, bias = (pose_block.pose_sigma(mocap[k]) for k in ("pose_sigma", "pose_bias_sigma"))
    known = {n: pose_block.pose(c["T_body_target"]) for n, c in targets.items()} | (mounts or {})
    out, rests = {}, together(columns)
    for i in np.flatnonzero(columns["kind"] == "still"):
        name = str(columns["target"][i])
        if name in targets:
            held = targets[name]["method"] == "points"
            steady = np.hypot(bias, late * columns["creep"][i])
            out[int(columns["placement"][i])] = Placement(
                session=session,
                target=name,
                T_robot_body=se3.from_xyz_quat(columns["xyz"][i], columns["quat"][i]),
                T_body_target=known[name],
                sigma=np.hypot(white * columns["pose_factor"][i], steady) * (HELD if held else 1.0),
                rest=None if held else int(rests[i]),
                start=int(columns["start"][i]),
            )
    return out


def together(columns):
    """Number (n,) of the rest that each interval belongs to: still ones that have more than half of
    the shorter one's time in common, with the first of them, are one rest of the robot."""
    start, end = columns["start"], columns["end"]
    numbers, first = np.full(len(start), -1), None
    for i in np.argsort(start, kind="stable"):
        if columns["kind"][i] != "still":
            continue
        common = -1 if first is None else min(end[first], end[i]) - start[i]
        if first is None or common <= min(end[first] - start[first], end[i] - start[i]) / 2:
            first = i
        numbers[i] = first
    return numbers


def groups(keypoints, sensor, index):
    """Groups of one sensor's keypoints (columns); index: placement number -> index in the setup."""
    out = []
    for kind in sorted(set(keypoints["kind"].tolist())):
        for number in sorted(set(keypoints["placement"].tolist())):
            rows = (keypoints["kind"] == kind) & (keypoints["placement"] == number)
            if rows.any():
                columns = parquet_tables.select(keypoints, rows)
                out.append(Group(sensor, index[number], kind, columns))
    return out
