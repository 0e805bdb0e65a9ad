"""Reads the files of a report into a ReportRun."""

import argparse
from pathlib import Path
from typing import Any

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


def read_report_run(args: argparse.Namespace) -> ReportRun:
    """Read all inputs named on the command line of report.py."""
    options = args.options
    sessions = read_report_sessions(args, options)
    guesses = (
        (name, stream.guess)
        for session in sessions.values()
        for name, stream in session.streams.items()
    )
    residuals = read_table(args.residuals, RESIDUALS_SCHEMA)[0]
    is_moving = np.asarray(residuals["is_moving"], bool)
    return ReportRun(
        options=options | {"sensors": with_lens_from_log(options["sensors"], guesses)},
        calibration=read_json(args.calibration),
        verdict=read_json(args.verdict),
        residuals=select_rows(residuals, ~is_moving),
        moving_residuals=select_rows(residuals, is_moving),
        iterations=read_table(args.iterations, ITERATIONS_SCHEMA)[0],
        sessions=sessions,
    )


def read_report_sessions(
    args: argparse.Namespace, options: dict[str, Any]
) -> dict[str, ReportSession]:
    """Read the sessions by name.

    The command line names the files of sensors by session, then by sensor, both sorted.
    """
    sensor_paths = zip(args.guesses, args.views, args.keypoints, strict=True)
    names = sorted(options["sessions"])
    session_paths = zip(names, args.audits, args.frames, args.placements, strict=True)
    sessions = {}
    for name, audit, frames, placements in session_paths:
        streams = {
            sensor: read_report_stream(options["sensors"][sensor]["kind"], *next(sensor_paths))
            for sensor in sorted(options["sessions"][name])
        }
        placement_columns, placements_status, notes = read_table(placements, PLACEMENTS_SCHEMA)
        sessions[name] = ReportSession(
            audit=read_json(audit),
            frames=read_table(frames, FRAMES_SCHEMA, ("sensor", "stamp_ns", "log_time_ns"))[0],
            placements=placement_columns,
            placements_status=placements_status,
            status_by_target={t: Status.from_dict(note) for t, note in notes["targets"].items()},
            mocap_notes=tuple(notes["mocap_notes"]),
            streams=streams,
        )
    return sessions


def read_report_stream(kind: str, guess: Path, views: Path, keypoints: Path) -> ReportStream:
    """Read the files of one sensor, a camera or a lidar, in one session."""
    view_columns, views_status, _ = read_table(views, VIEW_SCHEMAS[kind], COLUMNS_WITHOUT_PAYLOAD)
    keypoint_columns, keypoints_status, notes = read_table(keypoints, KEYPOINTS_SCHEMA)
    return ReportStream(
        guess=read_json(guess),
        views=view_columns,
        views_status=views_status,
        keypoints=keypoint_columns,
        keypoints_status=keypoints_status,
        status_by_view={o["view"]: Status.from_dict(o["status"]) for o in notes["outcomes"]},
        views_path=views,
    )
