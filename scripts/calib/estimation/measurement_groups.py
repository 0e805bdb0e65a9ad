"""Placements at rest and groups of keypoints, from the columns of their tables."""

from typing import Any

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement, SlowNoise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import pose_from_xyz_quat
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_from_config, pose_sigma_from_config
from calib.targets.target_shapes import is_compared_by_points

FIXED_POSE_SIGMA_FACTOR = 1e-3  # on the σ of the motion capture, for poses that are held


def make_still_placements(
    columns: dict[str, np.ndarray],
    session: str,
    *,
    targets: dict[str, dict[str, Any]],
    mocap_noise: dict[str, Any],
    mounts: dict[str, np.ndarray] | None = None,
    clock_error_s: float = 0.0,
) -> dict[int, Placement]:
    """Return the placements at rest of one session by number, from columns of placements.parquet.

    targets: config blocks by name; mocap_noise: block `mocap`; mounts: T_body_target (4, 4) where
    it is not the configured one; clock_error_s: largest σ of the sensors' time offsets, s.

    Of targets with template points the poses are held, as in the paper: as unknowns they absorb the
    offsets of the nearest points, and the search stops too early.
    """
    configured = {n: pose_from_config(block["T_body_target"]) for n, block in targets.items()}
    T_body_target, rests = configured | (mounts or {}), assign_robot_rests(columns)
    robot_sigma, body_sigma = (
        _mean_pose_sigma(columns, name, mocap_noise, clock_error_s) for name in ("robot", "body")
    )
    out = {}
    for i in np.flatnonzero(columns["kind"] == "still"):
        name = str(columns["target"][i])
        if name not in targets:
            continue
        is_held = is_compared_by_points(targets[name])
        out[int(columns["placement"][i])] = Placement(
            session=session,
            target=name,
            T_robot_body=pose_from_xyz_quat(columns["xyz"][i], columns["quat"][i]),
            T_body_target=T_body_target[name],
            mocap_sigma=body_sigma[i] * (FIXED_POSE_SIGMA_FACTOR if is_held else 1.0),
            robot_mocap_sigma=robot_sigma[i] * (FIXED_POSE_SIGMA_FACTOR if is_held else 1.0),
            robot_rest=None if is_held else int(rests[i]),
            start_ns=int(columns["start_ns"][i]),
            end_ns=int(columns["end_ns"][i]),
            slow_noise=_slow_noise(columns, int(i)),
        )
    return out


def _mean_pose_sigma(
    columns: dict[str, np.ndarray], name: str, mocap_noise: dict[str, Any], clock_error_s: float
) -> np.ndarray:
    """Return the σ (n, 6) of the mean poses of the robot or body: noise that averages within the
    placement, a bias that does not, at least the slow noise that was measured, and the drift of the
    target during an unknown time offset."""
    white, bias = (
        pose_sigma_from_config(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma")
    )
    factor, drift = np.asarray(columns["mean_pose_sigma_factor"]), columns["residual_drift"]
    bias = np.maximum(bias, columns[f"{name}_slow_sigma"])
    return np.hypot(white * factor[:, None], np.hypot(bias, clock_error_s * drift))


def _slow_noise(columns: dict[str, np.ndarray], row: int) -> SlowNoise | None:
    """Return the slow noise of motion capture in a placement, or None."""
    sigma, time_s = (
        np.stack([columns[f"{name}_slow_{quantity}"][row] for name in ("robot", "body")])
        for quantity in ("sigma", "time_s")
    )
    duration_s = float(columns["end_ns"][row] - columns["start_ns"][row]) / NS_PER_S
    return SlowNoise(sigma, time_s, duration_s) if sigma.any() else None


def assign_robot_rests(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the number (n,) of the robot's rest of each interval, -1 for moving ones.

    Still intervals belong to the same rest as an earlier one if they share more than half of the
    shorter one's time with it.
    """
    start, end = columns["start_ns"], columns["end_ns"]
    numbers, first = np.full(len(start), -1), None
    for i in np.argsort(start, kind="stable"):
        if columns["kind"][i] != "still":
            continue
        shared = -1 if first is None else min(end[first], end[i]) - start[i]
        if first is None or shared <= min(end[first] - start[first], end[i] - start[i]) / 2:
            first = i
        numbers[i] = first
    return numbers


def group_keypoints(
    keypoints: dict[str, np.ndarray], sensor: str, index_by_number: dict[int, int]
) -> list[MeasurementGroup]:
    """Return the groups of one sensor's keypoints, by kind and placement.

    index_by_number: index into the placements of the Setup, by number of the placement. A column
    candidate_feature becomes the initial features.
    """
    groups = []
    present = set(keypoints["kind"].tolist())
    for kind in (k for k in RESIDUAL_KINDS if k in present):
        for number in sorted(set(keypoints["placement"].tolist())):
            rows = (keypoints["kind"] == kind) & (keypoints["placement"] == number)
            if rows.any():
                columns = select_rows(keypoints, rows)
                groups.append(
                    MeasurementGroup(
                        sensor=sensor,
                        placement=index_by_number[number],
                        kind=kind,
                        keypoints=columns,
                        initial_features=columns.get("candidate_feature"),
                    )
                )
    return groups
