"""The files of a report as a Run."""

import numpy as np

from calib import lenses, stage, tables
from calib.report.run import LIGHT, VIEWS, Run, Session, Stream
from calib.status import Status


def read_stream(sensor, config, guess, views, keypoints):
    """One sensor in one session."""
    columns, seen, _ = tables.read(views, VIEWS[config["kind"]], LIGHT)
    found, status, notes = tables.read(keypoints, tables.KEYPOINTS)
    outcomes = {o["view"]: Status.from_dict(o["status"]) for o in notes["outcomes"]}
    return Stream(sensor, stage.read_json(guess), columns, seen, found, status, outcomes, views)


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
        table, status, notes = tables.read(placements, tables.PLACEMENTS)
        still = {target: Status.from_dict(note) for target, note in notes.items()}
        heard = tables.read(frames, tables.FRAMES, ("sensor", "t", "log_t"))[0]
        out[name] = Session(stage.read_json(audit), heard, table, status, still, streams)
    return out


def read_run(args):
    """Everything the report shows."""
    options = args.options
    sessions = read_sessions(args, options)
    guesses = ((n, s.guess) for heard in sessions.values() for n, s in heard.streams.items())
    residuals = tables.read(args.residuals, tables.RESIDUALS)[0]
    moving = np.asarray(residuals["moving"], bool)
    return Run(
        options=options | {"sensors": lenses.told(options["sensors"], guesses)},
        calibration=stage.read_json(args.calibration),
        verdict=stage.read_json(args.verdict),
        residuals=tables.select(residuals, ~moving),
        in_motion=tables.select(residuals, moving),
        iterations=tables.read(args.iterations, tables.ITERATIONS)[0],
        sessions=sessions,
    )
