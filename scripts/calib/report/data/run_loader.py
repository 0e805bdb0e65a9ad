"""The files of a report as a Run."""

import numpy as np

from calib.io.parquet_tables import read_table, select_rows
from calib.io.stage_cli import read_json
from calib.io.status import Status
from calib.io.table_schemas import (
    FRAMES_SCHEMA,
    ITERATIONS_SCHEMA,
    KEYPOINTS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.report.data.run_data import (
    COLUMNS_WITHOUT_PAYLOAD,
    VIEW_SCHEMAS,
    ReportRun,
    ReportSession,
    ReportStream,
)
from calib.sensors.lens_from_log import with_lens_from_log


def read_report_stream(sensor, config, guess, views, keypoints):
    """One sensor in one session."""
    columns, seen, _ = read_table(views, VIEW_SCHEMAS[config["kind"]], COLUMNS_WITHOUT_PAYLOAD)
    found, status, notes = read_table(keypoints, KEYPOINTS_SCHEMA)
    outcomes = {o["view"]: Status.from_dict(o["status"]) for o in notes["outcomes"]}
    return ReportStream(sensor, read_json(guess), columns, seen, found, status, outcomes, views)


def read_report_sessions(args, options):
    """Sessions by name; per-sensor files come by session, then sensor, both sorted."""
    of_sensors = zip(args.guesses, args.views, args.keypoints, strict=True)
    out = {}
    names = sorted(options["sessions"])
    paths = zip(names, args.audits, args.frames, args.placements, strict=True)
    for name, audit, frames, placements in paths:
        streams = {
            s: read_report_stream(s, options["sensors"][s], *next(of_sensors))
            for s in sorted(options["sessions"][name])
        }
        table, status, notes = read_table(placements, PLACEMENTS_SCHEMA)
        still = {target: Status.from_dict(note) for target, note in notes.items()}
        heard = read_table(frames, FRAMES_SCHEMA, ("sensor", "stamp_ns", "log_time_ns"))[0]
        out[name] = ReportSession(read_json(audit), heard, table, status, still, streams)
    return out


def read_report_run(args):
    """Everything the report shows."""
    options = args.options
    sessions = read_report_sessions(args, options)
    guesses = ((n, s.guess) for heard in sessions.values() for n, s in heard.streams.items())
    residuals = read_table(args.residuals, RESIDUALS_SCHEMA)[0]
    moving = np.asarray(residuals["is_moving"], bool)
    return ReportRun(
        options=options | {"sensors": with_lens_from_log(options["sensors"], guesses)},
        calibration=read_json(args.calibration),
        verdict=read_json(args.verdict),
        residuals=select_rows(residuals, ~moving),
        moving_residuals=select_rows(residuals, moving),
        iterations=read_table(args.iterations, ITERATIONS_SCHEMA)[0],
        sessions=sessions,
    )
