"""Which frames show a target, and the part of each around it, as recorded.

Reads   placements.parquet, mocap.parquet, frames.parquet, guess.json, log.json, and the log at the
        kept frames
Writes  views.parquet: one row per (frame, target) considered, kept or not, with its reason; for
        the kept all beams in the angular window around the target at any range with their ring
        and time, or the image region as PNG bytes with its offset
        motion.parquet: likewise of a few frames of targets in motion, for the clocks
Decides by field of view, stillness and newness of the pose. Windows and limits grow by the
        uncertainty of the guess, so that no later stage depends on where within it the guess lies:
        what is kept is a superset, of which extract takes what is in view from the pose it finds.
"""

import numpy as np

from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.logs import open_log
from calib.io.stage_cli import logger
from calib.io.status import Status
from calib.mocap import body_trajectory
from calib.sensors import sensor_models
from calib.targets import target_shapes
from calib.views import frame_selection, moving_view_selection, sensor_reader


def read_views(sensor, frames, placements, guess, content_of, options):
    """Rows of views.parquet of a sensor whose guess and placements are known; content_of reads what
    it measured (cropping.reader)."""
    mounts = frame_selection.mounts(options["targets"], guess)
    shapes = {n: target_shapes.from_config(options["targets"][n]) for n in mounts}
    poses = frame_selection.placed(placements, mounts), np.array(guess["T_robot_sensor"]["matrix"])
    margin = options["crop"]["margin_sigma"] * np.array(guess["sigma"])
    where = frames, placements, poses, margin
    return frame_selection.rows(sensor, shapes, *where, content_of, options["crop"])


def read_motion(sensor, frames, poses, guess, content_of, options):
    """Rows of motion.parquet; poses: columns of mocap.parquet."""
    blocks = options["targets"]
    known = frame_selection.mounts(blocks, guess)
    bodies = {n: blocks[n]["body"] for n in known if blocks[n]["method"] == "surface"}
    paths = body_trajectory.trajectories(poses, options["body"], bodies, options["max_gap_s"])
    margin = options["crop"]["margin_sigma"] * np.array(guess["sigma"])
    rows = []
    for name, path in paths.items():
        target = target_shapes.from_config(blocks[name])
        given = path, frames["t"], known[name], guess, margin, options["crop"]
        for i, where, wide in moving_view_selection.choose(sensor, target, *given):
            place = frames["t"][i], (-np.inf, np.inf), target, where, wide
            payload, why = sensor_reader.cut(sensor, content_of, i, *place)
            about = {"t": frames["t"][i], "target": name, "kept": not why, "reason": why}
            rows.append(about | {"placement": len(rows)} | payload)
    return rows


def held(notes):
    """Status of every target in the session: whether it is ever still in front of the robot."""
    return [Status.from_dict(note) for _, note in sorted(notes.items())]


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        placements="input",
        mocap="input",
        frames="input",
        guess="input",
        audit="input log.json",
        output="output",
        motion="output",
        options="slice of the config",
    ).parse_args(argv)
    name, audit = args.options["name"], stage_cli.read_json(args.audit)
    open_log.require_same(args.options["log"], audit["fingerprint"])
    block = sensor_models.heard(args.options["sensor"], audit["sensors"][name])
    options, kind = args.options | {"sensor": block}, sensor_reader.KINDS[block["kind"]]
    guess = stage_cli.read_json(args.guess)
    placements, gated, notes = parquet_tables.read(args.placements, table_schemas.PLACEMENTS)
    frames, _, _ = parquet_tables.read(args.frames, table_schemas.FRAMES)
    guessed = Status.from_dict(guess["status"])
    status, rows, moving = gated if guessed.ok else guessed, [], []
    if status.ok:
        sensor, mine = kind(block), parquet_tables.select(frames, frames["sensor"] == name)
        mine = frame_selection.timed(mine, guess["time_offset_s"]["value"])
        placements = frame_selection.trimmed(placements, guess["time_offset_s"]["sigma"])
        content_of = sensor_reader.reader(open_log.open_log(options["log"]), block, mine)
        rows = read_views(sensor, mine, placements, guess, content_of, options)
        reasons = [r["reason"] for r in rows]
        status = (
            frame_selection.seen(name, reasons)
            if any(s.ok for s in held(notes))
            else held(notes)[0]
        )
    # Where points have no time of their own, a scan of what moves tells nothing of a clock.
    if status.ok and options["crop"]["max_moving"] and sensor.timed:
        poses, _, _ = parquet_tables.read(args.mocap, table_schemas.MOCAP)
        moving = read_motion(sensor, mine, poses, guess, content_of, options)
    write(args.output, kind.schema, rows, status)
    write(args.motion, kind.schema, moving, status)
    logger.info("%s: kept %d of %d views", name, sum(r["kept"] for r in rows), len(rows))
    logger.info("%s: %d views of targets in motion", name, sum(r["kept"] for r in moving))


def write(path, schema, rows, status):
    """Rows of views as a table of theirs, numbered."""
    table = {k: [r[k] for r in rows] for k in schema.names if k != "view"}
    parquet_tables.write(path, schema, table | {"view": np.arange(len(rows))}, status)


if __name__ == "__main__":
    stage_cli.run(main)
