"""Where and when to look: the first guess of T_robot_sensor and of the sensor's clock.

Reads   log.json; where something is to be found: mocap.parquet, placements.parquet, frames.parquet,
        and a few frames of the log
Writes  guess.json: both with their uncertainty and source, T_body_target of the targets whose mount
        is unknown, and the lens where a CameraInfo of the log tells it
Decides first by how much the clock is off, where what the sensor sees tells that. Then the pose, in
this order: the rig's own T_robot_sensor or the file of its guess_from, unless the robot's markers
were mounted anew; the log's /tf_static from the robot body's frame to the frame of the sensor's
messages; what the sensor saw of the targets, whose poses in the robot frame are known; mounts that
are unknown are found by cameras.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.initial_guess.pose_guess import PoseGuess
from calib.initial_guess.stated_pose import read_pose_guess
from calib.io.logs.open_log import open_log, require_same_log
from calib.io.pose_block import pose_from_config, pose_json, pose_sigma_from_config
from calib.io.stage_cli import (
    StageArgumentParser,
    limit_opencv_threads,
    logger,
    read_json,
    run_stage,
    write_json,
)
from calib.io.status import OK, Status
from calib.sensors.sensor_models import with_log_metadata


def find_initial_pose(args, options, audit, time_offset, log):
    """(source, Found, mounts: target -> handeye.Mount) of the first source that gives a pose;
    time_offset: the guess of the sensor's clock; log: open, or None where it is not looked into."""
    name, sensor = options["name"], options["sensor"]
    status = Status.from_dict(audit["sensors"][name]["status"])
    if not status.ok:
        return "none", PoseGuess(status=status), {}
    source, found = read_pose_guess(name, sensor, options, audit)
    settled = found.T_robot_sensor is not None and not options["remounted"]
    unknown = any("mount" in c for c in options.get("targets", {}).values())
    if not found.status.ok or (settled and not unknown):
        return source, found, {}
    recording, status = load_session_search(args, options, time_offset, log)
    if not status.ok:
        return "none", PoseGuess(status=status), {}
    mounts = find_target_mounts(recording, options, audit)
    known = {n: pose_from_config(c["T_body_target"]) for n, c in options["targets"].items()}
    known = {n: T for n, T in known.items() if n not in mounts}
    known |= {n: m.T_body_target for n, m in mounts.items() if m.status.ok}
    if not known:
        status = next(m.status for _, m in sorted(mounts.items()))
        return "none", PoseGuess(status=name_sensor_in_status(status, name)), mounts
    seen = found if settled else recording.search_sensor_pose(name, sensor, known)
    if not seen.status.ok and found.T_robot_sensor is not None:
        # Markers mounted anew: what is stated holds where they were, and may nearly hold here.
        logger.warning("%s: %s; its stated pose is tried", name, seen.status.reason)
        return source, found, mounts
    if not seen.status.ok:
        return "none", replace(seen, status=name_sensor_in_status(seen.status, name)), mounts
    return source if settled else "found in the data", seen, mounts


def guess_time_offset(args, options, log):
    """{value, sigma, source} of the offset of the sensor's clock, s."""
    name, sensor = options["name"], options["sensor"]
    told = {"value": sensor["time_offset_s"], "sigma": sensor["time_offset_sigma_s"]}
    found = search_time_offset(args, options, log, told) if args.mocap and log else None
    if found is None:
        return told | {"source": "config"}
    logger.info("%s: its clock is off by %.2f s: %s", name, found.value, found.basis)
    return {"value": found.value, "sigma": found.sigma, "source": found.basis}


def search_time_offset(args, options, log, config_offset):
    """The lag.Lag that the session tells, or None."""
    # 0.6 s, which only a search should pay.
    from calib.initial_guess import clock_lag
    from calib.io import parquet_tables, table_schemas
    from calib.mocap import body_trajectory
    from calib.views import sensor_reader

    frames, _, _ = parquet_tables.read_table(args.frames[0], table_schemas.FRAMES_SCHEMA)
    poses, _, _ = parquet_tables.read_table(args.mocap[0], table_schemas.MOCAP_SCHEMA)
    frames = parquet_tables.select_rows(frames, frames["sensor"] == options["name"])
    paths = [
        body_trajectory.trajectory_from_columns(poses, b, options["max_gap_s"])
        for b in options["bodies"]
    ]
    read = sensor_reader.make_frame_reader(log, options["sensor"], frames)
    return clock_lag.find_clock_lag(
        options["sensor"]["kind"], frames["stamp_ns"], read, paths, config_offset
    )


def open_log_if_needed(options, audit):
    """The log where it is looked into and has the sensor, else None."""
    if "log" not in options or not audit["sensors"][options["name"]]["status"]["ok"]:
        return None
    limit_opencv_threads()
    require_same_log(options["log"], audit["fingerprint"])
    return open_log(options["log"])


def load_session_search(args, options, time_offset, log):
    """(Recording, status): the session, or why nothing can be found in it."""
    # 0.6 s, which only a search should pay.
    from calib.initial_guess.session_search import SessionSearch
    from calib.io import parquet_tables, table_schemas
    from calib.views import frame_selection

    placements, status, notes = parquet_tables.read_table(
        args.placements[0], table_schemas.PLACEMENTS_SCHEMA
    )
    held = [Status.from_dict(note) for _, note in sorted(notes.items())]
    if not status.ok or not any(s.ok for s in held):
        return None, held[0] if status.ok else status
    columns, _, _ = parquet_tables.read_table(args.frames[0], table_schemas.FRAMES_SCHEMA)
    columns = frame_selection.with_mocap_time(columns, time_offset["value"])
    placements = frame_selection.trim_placement_ends(placements, time_offset["sigma"])
    return SessionSearch(placements, columns, log, options["targets"], options["guess"]), OK


def find_target_mounts(recording, options, audit):
    """The handeye.Mount of every target of unknown mount, by name: by this sensor if it is a
    camera, else by another of the session."""
    own = options["name"]
    cameras = {n: options["cameras"][n] for n in sorted(options["cameras"], key=lambda n: n != own)}
    cameras = {n: c for n, c in cameras.items() if audit["sensors"][n]["status"]["ok"]}
    poses = {n: read_pose_guess(n, c, options, audit)[1] for n, c in cameras.items()}
    priors = {n: (f.T_robot_sensor, f.sigma) for n, f in poses.items() if f.sigma is not None}
    return {
        target: recording.search_mount(target, cameras, priors)
        for target in recording.targets_without_mount()
    }


def name_sensor_in_status(status, name):
    """The status of a search, with the name of the sensor in what is said and advised."""
    remedy = f"{status.remedy} Or measure it (5 cm, 5 deg) and write sensors.{name}.T_robot_sensor."
    reason = f"no first guess for {name}: {status.reason}"
    return replace(status, reason=reason, remedy=remedy.strip())


def guess_mounts_json(mounts):
    """The mounts that were found, as guess.json states them."""
    return {
        name: {"T_body_target": pose_json(m.T_body_target), "sigma": m.sigma.tolist()}
        for name, m in mounts.items()
        if m.status.ok
    }


def add_log_metadata(options, sensor_audits):
    """The options with what the log tells of each sensor; sensor_audits: the sensors' part of the audit."""
    cameras = {
        n: with_log_metadata(c, sensor_audits[n]) for n, c in options.get("cameras", {}).items()
    }
    sensor = with_log_metadata(options["sensor"], sensor_audits[options["name"]])
    return options | {"sensor": sensor, "cameras": cameras}


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--audit", "log.json")
    parser.add_paths("--mocap", "mocap.parquet, if a time offset or a pose must be estimated")
    parser.add_paths("--placements", "placements.parquet, if a pose must be estimated")
    parser.add_paths("--frames", "frames.parquet, if a time offset or a pose must be estimated")
    parser.add_path("--output", "guess.json to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    audit = read_json(args.audit)
    options = add_log_metadata(args.options, audit["sensors"])
    log = open_log_if_needed(options, audit)
    offset = guess_time_offset(args, options, log)
    source, found, mounts = find_initial_pose(args, options, audit, offset, log)
    T, sigma = found.T_robot_sensor, found.sigma
    if T is None:
        sigma = pose_sigma_from_config(options["guess"]["sigma"])
    write_json(
        args.output,
        {
            "status": found.status.to_dict(),
            "T_robot_sensor": None if T is None else pose_json(T),
            "sigma": np.asarray(sigma).tolist(),
            "source": source,
            "basis": found.basis,
            "mounts": guess_mounts_json(mounts),
            "frame": audit["sensors"][options["name"]]["frame"],
            "camera": audit["sensors"][options["name"]].get("camera"),
            "time_offset_s": offset,
        },
    )
    told = f"{source}{': ' if found.basis else ''}{found.basis}" if T is not None else found.status
    logger.info("%s: first guess from %s", options["name"], told)
    for name, mount in sorted(mounts.items()):
        logger.info("mount of %s: %s", name, mount.basis if mount.status.ok else mount.status)


if __name__ == "__main__":
    run_stage(main)
