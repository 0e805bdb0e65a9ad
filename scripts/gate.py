"""Finds the intervals in which a target is still relative to the robot, and those between.

Reads   mocap.parquet, log.json
Writes  placements.parquet: maximal still intervals per target, trimmed at both ends, with the mean
        T_robot_body over the interval and its covariance; and the intervals between, marked moving.
        Its notes hold when the log starts, the status of each target and the noise of each body
        at rest
Decides by linear and angular speed over a window, from motion capture alone.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.io.parquet_tables import Columns, read_table, write_table
from calib.io.pose_block import pose_sigma_from_config
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import Status
from calib.io.table_schemas import MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.mocap import placements
from calib.mocap.body_trajectory import relative_trajectory, trajectory_from_columns
from calib.mocap.rest_noise import RestNoise, describe_rest_noise, measure_body_noise
from calib.mocap.stillness import StillnessLimits
from calib.mocap.stillness_losses import never_still_status


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--audit", "log.json")
    parser.add_path("--output", "placements.parquet to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    options, mocap = args.options, args.options["mocap"]
    columns, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
    log_audit = read_json(args.audit)
    audit = log_audit["bodies"]
    limits = StillnessLimits.from_config(options["gate"])
    bodies = [options["body"], *options["targets"].values()]
    noise = measure_body_noise(columns, bodies, limits, mocap["max_gap_s"])
    rows, statuses = find_placements(columns, audit, noise, options)
    status = Status.from_dict(audit[options["body"]]["status"])
    # The number of a placement is its row. Still ones come first, because people count these.
    rows.sort(key=lambda r: r["kind"] != "still")
    names = [k for k in PLACEMENTS_SCHEMA.names if k != "placement"]
    table: Columns = {k: [r[k] for r in rows] for k in names}
    table["placement"] = np.arange(len(rows))
    lines = [describe_rest_noise(name, measured, mocap) for name, measured in noise.items()]
    notes = {
        "log_start_ns": log_audit["start_ns"],
        "targets": {target: found.to_dict() for target, found in statuses.items()},
        "mocap_noise": {name: measured.to_dict() for name, measured in noise.items()},
        "mocap_notes": lines,
    }
    write_table(args.output, PLACEMENTS_SCHEMA, table, status, notes)
    for line in lines:
        logger.info("%s", line)


def find_placements(
    columns: Columns,
    audit: dict[str, Any],
    noise: dict[str, RestNoise],
    options: dict[str, Any],
) -> tuple[list[dict[str, Any]], dict[str, Status]]:
    """Return the rows of placements.parquet and the status of each target.

    columns: of mocap.parquet; audit: `bodies` of log.json; noise: of the bodies at rest.
    """
    mocap, robot_body = options["mocap"], options["body"]
    limits = StillnessLimits.from_config(options["gate"])
    sigma = pose_sigma_from_config(mocap["pose_sigma"])
    robot = trajectory_from_columns(columns, robot_body, mocap["max_gap_s"])
    used = noise if mocap["use_measured_noise"] else {}
    rows, statuses = [], {}
    for target, body in sorted(options["targets"].items()):
        trajectory = trajectory_from_columns(columns, body, mocap["max_gap_s"])
        relative = relative_trajectory(robot, trajectory)
        at_rest = {"robot": noise.get(robot_body), "body": noise.get(body)}
        raised = placements.raise_limits_by_noise(limits, relative, at_rest)
        slow_noise = {"robot": used.get(robot_body), "body": used.get(body)}
        found = placements.find_target_placements(target, relative, raised, sigma, slow_noise)
        n_still = sum(r["kind"] == "still" for r in found)
        rows += found
        status = placements.body_status(audit, robot_body, body)
        if status.ok and not n_still:
            status = never_still_status(
                robot_body,
                body,
                trajectory=relative,
                stamps_ns=trajectory.stamps_ns,
                limits=raised,
            )
        statuses[target] = status
        logger.info("%s: %d still intervals of %d", target, n_still, len(found))
    return rows, statuses


if __name__ == "__main__":
    run_stage(main)
