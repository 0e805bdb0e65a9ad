"""The files of a report as a Run."""

import numpy as np

from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.status import Status
from calib.report.data.run_data import LIGHT, VIEWS, Run, Session, Stream
from calib.sensors import lens_from_log


def read_stream(sensor, config, guess, views, keypoints):
    """One sensor in one session."""
    columns, seen, _ = parquet_tables.read(views, VIEWS[config["kind"]], LIGHT)
    found, status, notes = parquet_tables.read(keypoints, table_schemas.KEYPOINTS)
    outcomes = {o["view"]: Status.from_dict(o["status"]) for o in notes["outcomes"]}
    return Stream(sensor, stage_cli.read_json(guess), columns, seen, found, status, outcomes, views)


def read_sessions(args, options):
    """Sessions by name; per-sensor files come by session, then sensor, both sorted."""
    of_sensors = zip(args.guesses, args.views, args.keypoints, strict=True)
    out = {}
    names = sorted(options["sessions"])
    paths = zip(names, args.audits, args.frames, args.placements, strict=True)
    for name, audit, frames, placements in paths:
        streams = {
            s: read_stream(s, options["sensors"][s], *next(of_sensors))
            for s in sorted(options["sessions"][name])
        }
        table, status, notes = parquet_tables.read(placements, table_schemas.PLACEMENTS)
        still = {target: Status.from_dict(note) for target, note in notes.items()}
        heard = parquet_tables.read(frames, table_schemas.FRAMES, ("sensor", "t", "log_t"))[0]
        out[name] = Session(stage_cli.read_json(audit), heard, table, status, still, streams)
    return out


def read_run(args):
    """Everything the report shows."""
    options = args.options
    sessions = read_sessions(args, options)
    guesses = ((n, s.guess) for heard in sessions.values() for n, s in heard.streams.items())
    residuals = parquet_tables.read(args.residuals, table_schemas.RESIDUALS)[0]
    moving = np.asarray(residuals["moving"], bool)
    return Run(
        options=options | {"sensors": lens_from_log.told(options["sensors"], guesses)},
        calibration=stage_cli.read_json(args.calibration),
        verdict=stage_cli.read_json(args.verdict),
        residuals=parquet_tables.select(residuals, ~moving),
        in_motion=parquet_tables.select(residuals, moving),
        iterations=parquet_tables.read(args.iterations, table_schemas.ITERATIONS)[0],
        sessions=sessions,
    )
