"""Give the initial guess of T_robot_sensor and of the time offset of one sensor.

Reads   log.json; if something is searched: mocap.parquet, placements.parquet, frames.parquet, and a
        few frames of the log
Writes  guess.json: both with uncertainty and source, T_body_target of targets with unknown mount,
        and the lens if a CameraInfo in the log gives it
Decides first on the time offset, if the data show it. Then on the pose, in this order:
        T_robot_sensor of the rig or the file of guess_from, unless the robot's markers were
        re-attached; /tf_static of the log, from the robot body's frame to the frame of the sensor's
        messages; a search by what the sensor sees of targets at known poses. Unknown mounts are
        searched with cameras.
"""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from calib.initial_guess.sensor_guess import (
    describe_guess,
    guess_json,
    guess_sensor_pose,
    guess_time_offset,
    with_sensor_metadata,
)
from calib.io.logs.open_log import open_log, require_same_log
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import (
    StageArgumentParser,
    limit_opencv_threads,
    logger,
    read_json,
    run_stage,
    write_json,
)
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA

if TYPE_CHECKING:
    from calib.initial_guess.session_search import SessionSearch


def open_session_search(
    args: argparse.Namespace, options: dict[str, Any], audit: dict[str, Any]
) -> "SessionSearch | None":
    """Return the session to search in; None if the log is not read or lacks the sensor."""
    if not args.frames or not audit["sensors"][options["name"]]["status"]["ok"]:
        return None
    # These imports take 0.6 s, which only a search should pay.
    from calib.initial_guess.session_search import SessionSearch
    from calib.views.target_placements import PlacementTable

    limit_opencv_threads()
    require_same_log(options["log"], audit["fingerprint"])
    return SessionSearch(
        log=open_log(options["log"]),
        frames=read_table(args.frames[0], FRAMES_SCHEMA)[0],
        placements=PlacementTable.read(args.placements[0]) if args.placements else None,
        poses=read_table(args.mocap[0], MOCAP_SCHEMA)[0] if args.mocap else None,
        options=options,
    )


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--audit", "log.json")
    parser.add_paths("--mocap", "mocap.parquet, if a time offset must be estimated")
    parser.add_paths("--placements", "placements.parquet, if a pose must be estimated")
    parser.add_paths("--frames", "frames.parquet, if a time offset or a pose must be estimated")
    parser.add_path("--output", "guess.json to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    audit = read_json(args.audit)
    options = with_sensor_metadata(args.options, audit["sensors"])
    name = options["name"]
    search = open_session_search(args, options, audit)
    time_offset = guess_time_offset(options, search)
    guess = guess_sensor_pose(options, audit, search, time_offset)
    content = guess_json(guess, time_offset, audit["sensors"][name], options["guess"]["sigma"])
    write_json(args.output, content)
    logger.info("%s: initial guess: %s", name, describe_guess(guess))
    for target_name, mount in sorted(guess.mounts.items()):
        logger.info("T_body_target of %s: %s", target_name, mount.basis or mount.status)


if __name__ == "__main__":
    run_stage(main)
