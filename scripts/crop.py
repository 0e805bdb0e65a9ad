"""Select the frames that show a target, and cut out the part of each around it, as recorded.

Reads   placements.parquet, mocap.parquet, frames.parquet, guess.json, log.json, and the log at the
        kept frames
Writes  views.parquet: one row per (frame, target), kept or not, with the reason. Kept rows hold all
        returns in the angular window around the target, at any range, with ring and time, or the
        image region as PNG with its offset
        moving_views.parquet: the same for a few frames of moving targets, for the time offsets
Decides by field of view, stillness and how new the pose is. Windows and limits grow with the
        uncertainty of the initial guess, so that no later stage depends on the guess within that
        uncertainty: more views are kept than used, and extract selects again at the pose it finds.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib.io.logs.open_log import open_log, require_same_log
from calib.io.parquet_tables import read_table, select_rows, write_table
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import Status
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA
from calib.mocap.body_trajectory import target_trajectories
from calib.sensors.sensor_models import with_log_metadata
from calib.views.placement_selection import visibility_status
from calib.views.sensor_croppers import CROPPERS, make_cropper, make_frame_reader
from calib.views.target_placements import PlacementTable, trim_placement_ends
from calib.views.view_cutter import ViewCutter, ViewRow, view_columns


def cut_moving_views(
    cutter: ViewCutter, mocap_path: Path, options: dict[str, Any]
) -> list[ViewRow]:
    """Return the rows of moving_views.parquet. Targets compared by points are left out."""
    blocks = options["targets"]
    bodies = {
        name: blocks[name]["body"]
        for name, target in cutter.targets.items()
        if target.uses_exact_surface
    }
    poses, _, _ = read_table(mocap_path, MOCAP_SCHEMA)
    trajectories = target_trajectories(poses, options["body"], bodies, options["max_gap_s"])
    return cutter.cut_moving_views(trajectories)


def write_views(path: Path, kind: str, rows: list[ViewRow], status: Status) -> None:
    """Write the rows of views of a kind of sensor as a numbered table."""
    schema = CROPPERS[kind].schema
    write_table(path, schema, view_columns(rows, schema.names), status)


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--frames", "frames.parquet")
    parser.add_path("--guess", "guess.json")
    parser.add_path("--audit", "log.json")
    parser.add_path("--output", "views.parquet to write")
    parser.add_path("--moving-views", "moving_views.parquet to write")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    options, audit, guess = args.options, read_json(args.audit), read_json(args.guess)
    require_same_log(options["log"], audit["fingerprint"])
    name = options["name"]
    sensor = with_log_metadata(options["sensor"], audit["sensors"][name])
    placements = PlacementTable.read(args.placements)
    status = Status.from_dict(guess["status"])
    if status.ok:
        status = placements.status
    rows, moving_rows = [], []
    if status.ok:
        cropper = make_cropper(sensor)  # a sensor that failed may have no lens
        frames, _, _ = read_table(args.frames, FRAMES_SCHEMA)
        frames = select_rows(frames, frames["sensor"] == name)
        read_frame = make_frame_reader(open_log(options["log"]), sensor, frames)
        cutter = ViewCutter.from_guess(cropper, guess, frames, read_frame, options)
        clock_sigma_s = guess["time_offset_s"]["sigma"]
        rows = cutter.cut_still_views(trim_placement_ends(placements.columns, clock_sigma_s))
        status = placements.still_target_status()
        if status.ok:
            status = visibility_status(name, [row["reason"] for row in rows])
        # Without times of its points, a scan of a moving target says nothing about the offset.
        if status.ok and options["crop"]["max_moving_views"] and cropper.has_measurement_time:
            moving_rows = cut_moving_views(cutter, args.mocap, options)
    write_views(args.output, sensor["kind"], rows, status)
    write_views(args.moving_views, sensor["kind"], moving_rows, status)
    logger.info("%s: kept %d of %d views", name, sum(r["kept"] for r in rows), len(rows))
    logger.info("%s: %d views of moving targets", name, sum(r["kept"] for r in moving_rows))


if __name__ == "__main__":
    run_stage(main)
