"""Which frames show a target, and the part of each around it, as recorded.

Reads   placements.parquet, mocap.parquet, frames.parquet, guess.json, log.json, and the log at the
        kept frames
Writes  views.parquet: one row per (frame, target) considered, kept or not, with its reason; for
        the kept all beams in the angular window around the target at any range with their ring
        and time, or the image region as PNG bytes with its offset
        moving_views.parquet: likewise of a few frames of targets in motion, for the clocks
Decides by field of view, stillness and newness of the pose. Windows and limits grow by the
        uncertainty of the guess, so that no later stage depends on where within it the guess lies:
        what is kept is a superset, of which extract takes what is in view from the pose it finds.
"""

import numpy as np

from calib.io.logs.open_log import open_log, require_same_log
from calib.io.parquet_tables import read_table, select_rows, write_table
from calib.io.stage_cli import logger, make_argument_parser, read_json, run_stage
from calib.io.status import Status
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.mocap.body_trajectory import target_trajectories
from calib.sensors.sensor_models import with_log_metadata
from calib.targets.target_shapes import target_from_config
from calib.views.frame_selection import (
    compute_target_poses,
    make_view_rows,
    mounts_from_guess,
    trim_placement_ends,
    visibility_status,
    with_mocap_time,
)
from calib.views.moving_view_selection import select_moving_views
from calib.views.sensor_reader import CROPPERS, make_frame_reader, read_and_cut_frame


def read_still_views(sensor, frames, placements, guess, read_content, options):
    """Rows of views.parquet of a sensor whose guess and placements are known; content_of reads what
    it measured (cropping.reader)."""
    mounts = mounts_from_guess(options["targets"], guess)
    shapes = {n: target_from_config(options["targets"][n]) for n in mounts}
    poses = compute_target_poses(placements, mounts), np.array(guess["T_robot_sensor"]["matrix"])
    margin = options["crop"]["margin_sigma"] * np.array(guess["sigma"])
    where = frames, placements, poses, margin
    return make_view_rows(sensor, shapes, *where, read_content, options["crop"])


def read_moving_views(sensor, frames, poses, guess, read_content, options):
    """Rows of moving_views.parquet; poses: columns of mocap.parquet."""
    blocks = options["targets"]
    known = mounts_from_guess(blocks, guess)
    targets = {n: target_from_config(blocks[n]) for n in known}
    bodies = {n: blocks[n]["body"] for n in known if targets[n].uses_exact_surface}
    paths = target_trajectories(poses, options["body"], bodies, options["max_gap_s"])
    margin = options["crop"]["margin_sigma"] * np.array(guess["sigma"])
    rows = []
    for name, path in paths.items():
        target = targets[name]
        given = path, frames["stamp_ns"], known[name], guess, margin, options["crop"]
        for i, where, wide in select_moving_views(sensor, target, *given):
            place = frames["stamp_ns"][i], (-np.inf, np.inf), target, where, wide
            payload, why = read_and_cut_frame(sensor, read_content, i, *place)
            about = {
                "stamp_ns": frames["stamp_ns"][i],
                "target": name,
                "kept": not why,
                "reason": why,
            }
            rows.append(about | {"placement": len(rows)} | payload)
    return rows


def read_target_statuses(notes):
    """Status of every target in the session: whether it is ever still in front of the robot."""
    return [Status.from_dict(note) for _, note in sorted(notes.items())]


def main(argv=None):
    args = make_argument_parser(
        __doc__,
        placements="input",
        mocap="input",
        frames="input",
        guess="input",
        audit="input log.json",
        output="output",
        moving_views="output",
        options="slice of the config",
    ).parse_args(argv)
    name, audit = args.options["name"], read_json(args.audit)
    require_same_log(args.options["log"], audit["fingerprint"])
    block = with_log_metadata(args.options["sensor"], audit["sensors"][name])
    options, kind = args.options | {"sensor": block}, CROPPERS[block["kind"]]
    guess = read_json(args.guess)
    placements, gated, notes = read_table(args.placements, PLACEMENTS_SCHEMA)
    frames, _, _ = read_table(args.frames, FRAMES_SCHEMA)
    guessed = Status.from_dict(guess["status"])
    status, rows, moving = gated if guessed.ok else guessed, [], []
    if status.ok:
        sensor, mine = kind(block), select_rows(frames, frames["sensor"] == name)
        mine = with_mocap_time(mine, guess["time_offset_s"]["value"])
        placements = trim_placement_ends(placements, guess["time_offset_s"]["sigma"])
        content_of = make_frame_reader(open_log(options["log"]), block, mine)
        rows = read_still_views(sensor, mine, placements, guess, content_of, options)
        reasons = [r["reason"] for r in rows]
        status = (
            visibility_status(name, reasons)
            if any(s.ok for s in read_target_statuses(notes))
            else read_target_statuses(notes)[0]
        )
    # Where points have no time of their own, a scan of what moves tells nothing of a clock.
    if status.ok and options["crop"]["max_moving"] and sensor.has_measurement_time:
        poses, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
        moving = read_moving_views(sensor, mine, poses, guess, content_of, options)
    write_views(args.output, kind.schema, rows, status)
    write_views(args.moving_views, kind.schema, moving, status)
    logger.info("%s: kept %d of %d views", name, sum(r["kept"] for r in rows), len(rows))
    logger.info("%s: %d views of targets in motion", name, sum(r["kept"] for r in moving))


def write_views(path, schema, rows, status):
    """Rows of views as a table of theirs, numbered."""
    table = {k: [r[k] for r in rows] for k in schema.names if k != "view"}
    write_table(path, schema, table | {"view": np.arange(len(rows))}, status)


if __name__ == "__main__":
    run_stage(main)
