"""When a target is still relative to the robot, and when it moves.

Reads   mocap.parquet, log.json
Writes  placements.parquet: maximal still intervals per target, trimmed at both ends, with the mean
        T_robot_body over the interval and its covariance; and the intervals between, marked moving
Decides by linear and angular speed over a window, from the MCS alone.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from calib.geometry.se3 import adjoint, invert_pose, mean_pose, pose_to_quat
from calib.io.parquet_tables import read_table, write_table
from calib.io.pose_block import pose_sigma_from_config
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import OK, Status, failure_status
from calib.io.table_schemas import MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.mocap.body_trajectory import relative_trajectory, trajectory_from_columns
from calib.mocap.stillness import (
    StillnessLimits,
    count_effective_samples,
    find_still_intervals,
    fit_residual_drift,
)


def average_still_pose(trajectory, interval_ns, pose_sigma):
    """Mean pose of a interval_ns (start, end), ns, and how far it can be trusted, as columns."""
    rows = (trajectory.stamps_ns >= interval_ns[0]) & (trajectory.stamps_ns <= interval_ns[1])
    mean, xi = mean_pose(trajectory.poses[rows])
    prior = single_pose_covariance(mean, pose_sigma)
    scatter = max(1.0, np.sqrt(np.mean(np.sum(xi * np.linalg.solve(prior, xi.T).T, 1)) / 6))
    independent = count_effective_samples(xi)
    factor = scatter / np.sqrt(independent)
    return {
        "xyz": mean[:3, 3],
        "quat": pose_to_quat(mean),
        "samples": int(rows.sum()),
        "effective_samples": independent,
        "mean_pose_sigma_factor": factor,
        "covariance": (factor**2 * prior).reshape(-1),
        "residual_drift": fit_residual_drift(trajectory.stamps_ns[rows], xi),
    }


def single_pose_covariance(T_robot_body, sigma):
    """(6, 6) of one T_robot_body when both bodies' poses err by sigma (6,)."""
    A = adjoint(invert_pose(T_robot_body))
    return np.diag(sigma**2) + A @ np.diag(sigma**2) @ A.T


def middle_moving_pose(trajectory, interval_ns):
    """The pose nearest the middle of a moving span, as columns: not averaged, not to be trusted."""
    T = trajectory.poses[
        np.abs(
            trajectory.stamps_ns - (interval_ns[0] + (interval_ns[1] - interval_ns[0]) // 2)
        ).argmin()
    ]
    return {
        "xyz": T[:3, 3],
        "quat": pose_to_quat(T),
        "samples": 1,
        "effective_samples": 1.0,
        "mean_pose_sigma_factor": 1.0,
        "covariance": np.zeros(36),
        "residual_drift": np.zeros(6),
    }


def find_moving_intervals(still_intervals, t):
    """(k, 2) what lies between spans, from the first to the last of the times t."""
    if len(t) == 0:
        return np.zeros((0, 2), np.int64)
    edges = np.concatenate([[t[0]], still_intervals.reshape(-1), [t[-1]]]).reshape(-1, 2)
    return edges[edges[:, 1] > edges[:, 0]]


def find_target_placements(target, trajectory, options, pose_sigma):
    """Rows of one target, in order of time."""
    limits = StillnessLimits(
        window_s=options["window_s"],
        max_linear_mps=options["max_linear_mps"],
        max_angular_radps=np.radians(options["max_angular_dps"]),
        trim_s=options["trim_s"],
        min_duration_s=options["min_duration_s"],
    )
    still = find_still_intervals(trajectory, limits)
    rows = [("still", s, average_still_pose(trajectory, s, pose_sigma)) for s in still]
    rows += [
        ("moving", s, middle_moving_pose(trajectory, s))
        for s in find_moving_intervals(still, trajectory.stamps_ns)
    ]
    head = [{"target": target, "kind": k, "start_ns": s[0], "end_ns": s[1]} for k, s, _ in rows]
    merged = [h | r[2] for h, r in zip(head, rows, strict=True)]
    return sorted(merged, key=lambda r: r["start_ns"])


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--audit", "log.json")
    parser.add_path("--output", "placements.parquet to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    options = args.options
    columns, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
    audit = read_json(args.audit)["bodies"]
    sigma = pose_sigma_from_config(options["mocap"]["pose_sigma"])
    gap = options["mocap"]["max_gap_s"]
    robot = trajectory_from_columns(columns, options["body"], gap)
    rows, notes = [], {}
    for target, body in sorted(options["targets"].items()):
        relative = relative_trajectory(robot, trajectory_from_columns(columns, body, gap))
        found = find_target_placements(target, relative, options["gate"], sigma)
        still = [r for r in found if r["kind"] == "still"]
        rows += found
        notes[target] = still_target_status(audit, options["body"], body, still).to_dict()
        logger.info("%s: %d still intervals of %d", target, len(still), len(found))
    status = Status.from_dict(audit[options["body"]]["status"])
    # The number of an interval is its row: the still ones come first, as people count them.
    rows.sort(key=lambda r: r["kind"] != "still")
    table = {k: [r[k] for r in rows] for k in PLACEMENTS_SCHEMA.names if k != "placement"}
    table["placement"] = np.arange(len(rows))
    write_table(args.output, PLACEMENTS_SCHEMA, table, status, notes)


def still_target_status(audit, robot, body, still_rows):
    """Why a target has no still interval, or ok."""
    for name in (robot, body):
        status = Status.from_dict(audit[name]["status"])
        if not status.ok:
            return status
    if not still_rows:
        return failure_status(
            f"{body} is never still relative to {robot}",
            "0 still intervals",
            "1 or more",
            "Hold the target still for a second, or raise gate.max_linear_mps.",
        )
    return OK


if __name__ == "__main__":
    run_stage(main)
