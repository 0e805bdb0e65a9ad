"""Finds the intervals in which a target is still relative to the robot, and those between.

Reads   mocap.parquet, log.json
Writes  placements.parquet: maximal still intervals per target, trimmed at both ends, with the mean
        T_robot_body over the interval and its covariance; and the intervals between, marked moving
Decides by linear and angular speed over a window, from motion capture alone.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from calib.io.parquet_tables import Columns, read_table, write_table
from calib.io.pose_block import pose_sigma_from_config
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import Status
from calib.io.table_schemas import MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.mocap import placements
from calib.mocap.body_trajectory import relative_trajectory, trajectory_from_columns
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
    options = args.options
    columns, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
    audit = read_json(args.audit)["bodies"]
    sigma = pose_sigma_from_config(options["mocap"]["pose_sigma"])
    gap = options["mocap"]["max_gap_s"]
    robot = trajectory_from_columns(columns, options["body"], gap)
    rows, notes = [], {}
    limits = StillnessLimits.from_config(options["gate"])
    for target, body in sorted(options["targets"].items()):
        trajectory = trajectory_from_columns(columns, body, gap)
        relative = relative_trajectory(robot, trajectory)
        found = placements.find_target_placements(target, relative, options["gate"], sigma)
        still = [r for r in found if r["kind"] == "still"]
        rows += found
        status = placements.body_status(audit, options["body"], body)
        if status.ok and not still:
            status = never_still_status(
                options["body"],
                body,
                trajectory=relative,
                stamps_ns=trajectory.stamps_ns,
                limits=limits,
            )
        notes[target] = status.to_dict()
        logger.info("%s: %d still intervals of %d", target, len(still), len(found))
    status = Status.from_dict(audit[options["body"]]["status"])
    # The number of a placement is its row. Still ones come first, because people count these.
    rows.sort(key=lambda r: r["kind"] != "still")
    names = [k for k in PLACEMENTS_SCHEMA.names if k != "placement"]
    table: Columns = {k: [r[k] for r in rows] for k in names}
    table["placement"] = np.arange(len(rows))
    write_table(args.output, PLACEMENTS_SCHEMA, table, status, notes)


if __name__ == "__main__":
    run_stage(main)
