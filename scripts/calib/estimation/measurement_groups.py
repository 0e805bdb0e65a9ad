"""Placements as the estimate sees them, from the columns of placements.parquet."""

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import pose_from_xyz_quat
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_from_config, pose_sigma_from_config

FIXED_POSE_SIGMA_FACTOR = 1e-3  # of the σ of the MCS


def make_still_placements(columns, session, targets, mocap_noise, mounts=None, clock_error_s=0.0):
    """{placement number: Placement} of the still intervals of one session.

    targets: name -> config block; mocap_noise: block with pose_sigma and pose_bias_sigma; mounts: name ->
    T_body_target (4, 4) where it is not that of the config; clock_error_s: s by which the clocks of the
    sensors may be off. The σ of an averaged pose has a part that averages within the placement, a
    bias that does not, and what the target creeps while nobody knows when a sensor saw it. For
    targets compared by points the poses are held, as in the paper: freed, they take up what the
    nearest points leave, and the search settles before it has arrived.
    """
    white, bias = (
        pose_sigma_from_config(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma")
    )
    known = {n: pose_from_config(c["T_body_target"]) for n, c in targets.items()} | (mounts or {})
    out, rests = {}, assign_robot_rests(columns)
    for i in np.flatnonzero(columns["kind"] == "still"):
        name = str(columns["target"][i])
        if name in targets:
            held = targets[name]["method"] == "points"
            steady = np.hypot(bias, clock_error_s * columns["residual_drift"][i])
            out[int(columns["placement"][i])] = Placement(
                session=session,
                target=name,
                T_robot_body=pose_from_xyz_quat(columns["xyz"][i], columns["quat"][i]),
                T_body_target=known[name],
                mocap_sigma=np.hypot(white * columns["mean_pose_sigma_factor"][i], steady)
                * (FIXED_POSE_SIGMA_FACTOR if held else 1.0),
                robot_rest=None if held else int(rests[i]),
                start_ns=int(columns["start_ns"][i]),
            )
    return out


def assign_robot_rests(columns):
    """Number (n,) of the rest that each interval belongs to: still ones that have more than half of
    the shorter one's time in common, with the first of them, are one rest of the robot."""
    start, end = columns["start_ns"], columns["end_ns"]
    numbers, first = np.full(len(start), -1), None
    for i in np.argsort(start, kind="stable"):
        if columns["kind"][i] != "still":
            continue
        common = -1 if first is None else min(end[first], end[i]) - start[i]
        if first is None or common <= min(end[first] - start[first], end[i] - start[i]) / 2:
            first = i
        numbers[i] = first
    return numbers


def group_keypoints(keypoints, sensor, index_by_placement):
    """Groups of one sensor's keypoints (columns); index_by_placement: placement number -> index in the setup."""
    out = []
    present = set(keypoints["kind"].tolist())
    for kind in (k for k in RESIDUAL_KINDS if k in present):
        for number in sorted(set(keypoints["placement"].tolist())):
            rows = (keypoints["kind"] == kind) & (keypoints["placement"] == number)
            if rows.any():
                columns = select_rows(keypoints, rows)
                out.append(MeasurementGroup(sensor, index_by_placement[number], kind, columns))
    return out
