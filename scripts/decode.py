"""What a log holds: poses of the motion capture, one row per sensor message, and an audit.

Reads   the log, in one pass through its index; no payload of a sensor is kept
Writes  mocap.parquet   every pose of every body as recorded, with a fault where it has one
        frames.parquet  every message of every sensor: stamp, log time, size, place in the log
        log.json        topics, rates, gaps, clocks, static transforms, what could not be read, and
                        a status per body and sensor; what the fields of a lidar's clouds mean, and
                        the lens by a CameraInfo
Decides nothing about quality: a missing topic or body becomes a status, and the rest goes on.
"""

import argparse
from collections.abc import Sequence

from calib.decoding.body_tracks import audit_body, build_mocap_columns
from calib.decoding.decoded_log import build_frame_columns, decode_log, infer_stream_clocks
from calib.decoding.sensor_audit import audit_sensor, describe_unreadable_messages
from calib.io.logs.open_log import open_log
from calib.io.parquet_tables import write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage, write_json
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA


def build_log_audit(options, log, recording, clocks, decoded_tables):
    """The content of log.json; decoded_tables: columns of mocap.parquet and of frames.parquet, and what
    was found about each topic of motion capture, in words."""
    poses, frames, words = decoded_tables
    mocap = options["mocap"]
    sensors = {
        name: audit_sensor(name, recording, log.topics, frames, clocks)
        for name in sorted(options["sensors"])
    }
    return {
        "fingerprint": options["fingerprint"],
        "faults": [*log.read_errors, *describe_unreadable_messages(recording)],
        "topics": {k: {"type": t, "messages": n} for k, (t, n) in sorted(log.topics.items())},
        "mocap": {t: clocks[t].to_dict() | {"found": found} for t, found in sorted(words.items())},
        "bodies": {n: audit_body(poses, n, recording, log, mocap) for n in options["bodies"]},
        "sensors": sensors,
        "static": [
            {"parent": parent, "child": child, "T": T}
            for (parent, child), T in sorted(recording.static_transforms.items())
        ],
    }


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--mocap", "mocap.parquet to write")
    parser.add_path("--frames", "frames.parquet to write")
    parser.add_path("--audit", "log.json to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    options = args.options
    log = open_log(options["log"])
    recording = decode_log(log, options)
    clocks = infer_stream_clocks(recording)
    poses, words = build_mocap_columns(recording, clocks, options["mocap"])
    frames = build_frame_columns(recording.frame_rows, clocks)
    found = build_log_audit(options, log, recording, clocks, (poses, frames, words))
    write_table(
        args.mocap,
        MOCAP_SCHEMA,
        poses,
        notes={"topics": recording.streams.topics_by_frame()},
    )
    write_table(args.frames, FRAMES_SCHEMA, frames)
    write_json(args.audit, found)
    logger.info("%d poses, %d frames", len(poses["stamp_ns"]), len(frames["stamp_ns"]))
    for fault in found["faults"]:
        logger.warning("%s", fault)
    for name, about in found["sensors"].items():
        for what, words in about.get("inferred", {}).items():
            logger.info("%s: %s: %s", name, what, words)
    for name, about in (found["bodies"] | found["sensors"]).items():
        if not about["status"]["ok"]:
            logger.warning("%s: %s", name, about["status"]["reason"])


if __name__ == "__main__":
    run_stage(main)
