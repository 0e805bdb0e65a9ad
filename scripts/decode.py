"""Reads a log once: poses of motion capture, one row per sensor message, and an audit.

Reads   the log, through its index; images and clouds are not kept
Writes  mocap.parquet   every pose of every body as recorded, with its fault if it has one
        frames.parquet  every message of every sensor: stamp, log time, size, place in the log
        log.json        topics, rates, gaps, clocks, static transforms, read errors, the layout of
                        lidar clouds, the lens by the CameraInfo, and a status per body and sensor
Decides nothing about quality: a missing topic or body becomes a status, and the stage continues.
"""

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

from calib.decoding.body_tracks import audit_body, build_mocap_columns
from calib.decoding.clock_steps import clock_steps_json
from calib.decoding.decoded_log import (
    DecodedLog,
    build_frame_columns,
    decode_log,
    infer_stream_clocks,
)
from calib.decoding.sensor_audit import audit_sensor, describe_unreadable_messages
from calib.decoding.stream_clocks import StreamClock
from calib.io.logs.open_log import RecordedLog, open_log
from calib.io.parquet_tables import Columns, write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage, write_json
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA


class DecodedTables(NamedTuple):
    """Columns of mocap.parquet and frames.parquet; mocap_notes: {topic: what was inferred}."""

    poses: Columns
    frames: Columns
    mocap_notes: dict[str, list[str]]


def build_log_audit(
    options: dict[str, Any],
    log: RecordedLog,
    decoded: DecodedLog,
    clocks: dict[str, StreamClock],
    tables: DecodedTables,
) -> dict[str, Any]:
    """Return the content of log.json."""
    sensors = {
        name: audit_sensor(name, decoded, log.topics, tables.frames, clocks)
        for name in sorted(options["sensors"])
    }
    bodies = {
        name: audit_body(tables.poses, name, decoded, log, options["mocap"])
        for name in options["bodies"]
    }
    mocap = {
        topic: clocks[topic].to_dict() | {"found": notes}
        for topic, notes in sorted(tables.mocap_notes.items())
    }
    return {
        "fingerprint": options["fingerprint"],
        "start_ns": log.start_ns,
        "faults": [*log.read_errors, *describe_unreadable_messages(decoded)],
        "topics": {k: {"type": t, "messages": n} for k, (t, n) in sorted(log.topics.items())},
        "mocap": mocap,
        "replaced_names": log.names.describe_replaced(),
        "clock_steps": [
            step
            for name, clock in sorted(clocks.items())
            for step in clock_steps_json(name, clock.steps, log.start_ns)
        ],
        "bodies": bodies,
        "sensors": sensors,
        "static": [
            {"parent": parent, "child": child, "T": T}
            for (parent, child), T in sorted(decoded.static_transforms.items())
        ],
    }


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--mocap", "mocap.parquet to write")
    parser.add_path("--frames", "frames.parquet to write")
    parser.add_path("--audit", "log.json to write")
    return parser.parse_args(argv)


def _log_audit(audit: dict[str, Any]) -> None:
    """Log faults and replaced names of a log, what was inferred of it, and failed statuses."""
    for fault in audit["faults"] + audit["replaced_names"]:
        logger.warning("%s", fault)
    for step in audit["clock_steps"]:
        logger.warning("%s. %s", step["text"], step["remedy"])
    for name, sensor in audit["sensors"].items():
        for quantity, text in sensor.get("inferred", {}).items():
            logger.info("%s: %s: %s", name, quantity, text)
    for name, block in (audit["bodies"] | audit["sensors"]).items():
        if not block["status"]["ok"]:
            logger.warning("%s: %s", name, block["status"]["reason"])


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    options = args.options
    log = open_log(options["log"])
    decoded = decode_log(log, options)
    clocks = infer_stream_clocks(decoded)
    poses, mocap_notes = build_mocap_columns(decoded, clocks, options["mocap"])
    frames = build_frame_columns(decoded.frame_rows, clocks)
    tables = DecodedTables(poses, frames, mocap_notes)
    audit = build_log_audit(options, log, decoded, clocks, tables)
    topics_by_frame = decoded.streams.topics_by_frame()
    write_table(args.mocap, MOCAP_SCHEMA, poses, notes={"topics": topics_by_frame})
    write_table(args.frames, FRAMES_SCHEMA, frames)
    write_json(args.audit, audit)
    logger.info("%d poses, %d frames", len(poses["stamp_ns"]), len(frames["stamp_ns"]))
    _log_audit(audit)


if __name__ == "__main__":
    run_stage(main)
