"""What a log holds: poses of the motion capture, one row per sensor message, and an audit.

Reads   the log, in one pass through its index; no payload of a sensor is kept
Writes  mocap.parquet   every pose of every body as recorded, with a fault where it has one
        frames.parquet  every message of every sensor: stamp, log time, size, place in the log
        log.json        topics, rates, gaps, clocks, static transforms, what could not be read, and
                        a status per body and sensor; what the fields of a lidar's clouds mean, and
                        the lens by a CameraInfo
Decides nothing about quality: a missing topic or body becomes a status, and the rest goes on.
"""

from calib.decoding import body_tracks, decoded_log, sensor_audit
from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.logs import open_log
from calib.io.stage_cli import logger


def audit(options, log, recording, clocks, tables_of):
    """The content of log.json; tables_of: columns of mocap.parquet and of frames.parquet, and what
    was found about each topic of motion capture, in words."""
    poses, frames, words = tables_of
    mocap = options["mocap"]
    sensors = {
        name: sensor_audit.sensor_audit(name, recording, log.topics, frames, clocks)
        for name in sorted(options["sensors"])
    }
    return {
        "fingerprint": options["fingerprint"],
        "faults": [*log.faults, *sensor_audit.unread(recording)],
        "topics": {k: {"type": t, "messages": n} for k, (t, n) in sorted(log.topics.items())},
        "mocap": {t: clocks[t].to_dict() | {"found": found} for t, found in sorted(words.items())},
        "bodies": {
            n: body_tracks.audit(poses, n, recording, log, mocap) for n in options["bodies"]
        },
        "sensors": sensors,
        "static": [
            {"parent": parent, "child": child, "T": T}
            for (parent, child), T in sorted(recording.static.items())
        ],
    }


def main(argv=None):
    args = stage_cli.parser(
        __doc__, mocap="output", frames="output", audit="output", options="slice of the config"
    ).parse_args(argv)
    options = args.options
    log = open_log.open_log(options["log"])
    recording = decoded_log.read(log, options)
    clocks = decoded_log.clocks(recording)
    poses, words = body_tracks.columns(recording, clocks, options["mocap"])
    frames = decoded_log.frame_columns(recording.frames, clocks)
    found = audit(options, log, recording, clocks, (poses, frames, words))
    parquet_tables.write(
        args.mocap, table_schemas.MOCAP, poses, notes={"topics": recording.streams.topics()}
    )
    parquet_tables.write(args.frames, table_schemas.FRAMES, frames)
    stage_cli.write_json(args.audit, found)
    logger.info("%d poses, %d frames", len(poses["t"]), len(frames["t"]))
    for fault in found["faults"]:
        logger.warning("%s", fault)
    for name, about in found["sensors"].items():
        for what, words in about.get("told", {}).items():
            logger.info("%s: %s: %s", name, what, words)
    for name, about in (found["bodies"] | found["sensors"]).items():
        if not about["status"]["ok"]:
            logger.warning("%s: %s", name, about["status"]["reason"])


if __name__ == "__main__":
    stage_cli.run(main)
