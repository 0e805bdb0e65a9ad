"""Placements as the estimate sees them, from the columns of placements.parquet."""

import numpy as np

from calib import geometry, rig, tables
from calib.estimation import Group, Placement

HELD = 1e-3  # of the σ of the MCS


def still(columns, session, targets, mocap):
    """{placement number: Placement} of the still intervals of one session.

    targets: name -> config block; mocap: block with pose_sigma and pose_bias_sigma. The σ of an
    averaged pose has a part that averages within the placement and a bias that does not. For
    targets compared by points the poses are held, as in the paper: freed, they take up what the
    nearest points leave, and the search settles before it has arrived.
    """
    white, bias = (rig.pose_sigma(mocap[k]) for k in ("pose_sigma", "pose_bias_sigma"))
    out = {}
    for i in np.flatnonzero(columns["kind"] == "still"):
        name = str(columns["target"][i])
        if name in targets:
            out[int(columns["placement"][i])] = Placement(
                session=session,
                target=name,
                T_robot_body=geometry.from_xyz_quat(columns["xyz"][i], columns["quat"][i]),
                T_body_target=rig.pose(targets[name]["T_body_target"]),
                sigma=np.hypot(white * columns["pose_factor"][i], bias)
                * (HELD if targets[name]["method"] == "points" else 1.0),
            )
    return out


def groups(keypoints, sensor, index):
    """Groups of one sensor's keypoints (columns); index: placement number -> index in the setup."""
    out = []
    for kind in sorted(set(keypoints["kind"].tolist())):
        for number in sorted(set(keypoints["placement"].tolist())):
            rows = (keypoints["kind"] == kind) & (keypoints["placement"] == number)
            if rows.any():
                columns = tables.select(keypoints, rows)
                out.append(Group(sensor, index[number], kind, columns))
    return out
