"""What a log holds: poses of the motion capture, one row per sensor message, and an audit.

Reads   the log, in one pass through its index; no payload of a sensor is kept
Writes  mocap.parquet   every pose of every body as recorded, with a fault where it has one
        frames.parquet  every message of every sensor: stamp, log time, size, place in the log
        log.json        topics, rates, gaps, static transforms, and a status per body and sensor;
                        what the fields of a lidar's clouds mean, and the lens by a CameraInfo
Decides nothing about quality: a missing topic or body becomes a status, and the rest goes on.
"""

from calib import intake, logs, stage, tables
from calib.stage import logger


def audit(options, log, recording, poses, frames):
    """The content of log.json."""
    sensors = {
        name: intake.sensor_audit(name, recording, log.topics, frames)
        for name in sorted(options["sensors"])
    }
    return {
        "fingerprint": options["fingerprint"],
        "topics": {k: {"type": t, "messages": n} for k, (t, n) in sorted(log.topics.items())},
        "bodies": {name: intake.body_audit(poses, name) for name in options["bodies"]},
        "sensors": sensors,
        "static": [
            {"parent": parent, "child": child, "T": T}
            for (parent, child), T in sorted(recording.static.items())
        ],
    }


def main(argv=None):
    args = stage.parser(
        __doc__, mocap="output", frames="output", audit="output", options="slice of the config"
    ).parse_args(argv)
    options = args.options
    log = logs.open_log(options["log"])
    recording = intake.read(log, options)
    poses = intake.pose_columns(recording.poses)
    frames = intake.frame_columns(recording.frames)
    found = audit(options, log, recording, poses, frames)
    tables.write(args.mocap, tables.MOCAP, poses)
    tables.write(args.frames, tables.FRAMES, frames)
    stage.write_json(args.audit, found)
    logger.info("%d poses, %d frames", len(recording.poses), len(recording.frames))
    for name, about in found["sensors"].items():
        for what, words in about.get("told", {}).items():
            logger.info("%s: %s: %s", name, what, words)
    for name, about in (found["bodies"] | found["sensors"]).items():
        if not about["status"]["ok"]:
            logger.warning("%s: %s", name, about["status"]["reason"])


if __name__ == "__main__":
    stage.run(main)
