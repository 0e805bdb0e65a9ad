"""Where to look: the first guess of T_robot_sensor, its uncertainty and its source.

Reads   log.json; where something is to be found: placements.parquet, frames.parquet, and a few
        frames of the log
Writes  guess.json, with T_body_target of the targets whose mount is unknown
Decides in this order: the rig's own T_robot_sensor; the file of its guess_from; the log's
/tf_static from the robot body's frame to the frame of the sensor's messages; what the sensor saw of
the targets, whose poses in the robot frame are known. Nothing of a message is read unless it comes
to the last, or a mount is unknown: cameras tell mounts.
"""

from dataclasses import replace

import numpy as np

from calib import frames, rig, stage
from calib.found import Found
from calib.stage import logger
from calib.status import OK, InputError, Status, failed


def from_static(static, body, frame):
    """T_body_frame (4, 4) along static transforms, those of log.json or of a URDF, or None."""
    edges = {(e["parent"], e["child"]): rig.pose(e["T"]) for e in static}
    return frames.chain(edges, body, frame)


def stated(name, sensor, options, audit):
    """(source, Found) of a pose that the rig or the log states, or of none: no pose, status ok."""
    heard = audit["sensors"][name]
    sigma = rig.pose_sigma(sensor.get("guess_sigma", options["guess"]["sigma"]))
    given = options.get("given", {}).get(name, {})
    for source, known in (("config", sensor), (given.get("source"), given)):
        if "T_robot_sensor" in known:
            return source, Found(rig.pose(known["T_robot_sensor"]), sigma)
    if given.get("static"):
        T = from_static(given["static"], options["body"], heard["frame"].lstrip("/"))
        if T is not None:
            return given["source"], Found(T, sigma)
    try:
        T = from_static(audit["static"], options["body"], heard["frame"])
    except InputError as error:
        remedy = f"Mend what publishes it, or write sensors.{name}.T_robot_sensor."
        status = failed("a static transform of the log is no pose", error, "", remedy)
        return "none", Found(status=status)
    return ("none", Found()) if T is None else ("tf_static", Found(T, sigma))


def find(args, options, audit):
    """(source, Found, mounts: target -> handeye.Mount) of the first source that gives a pose."""
    name, sensor = options["name"], options["sensor"]
    status = Status.from_dict(audit["sensors"][name]["status"])
    if not status.ok:
        return "none", Found(status=status), {}
    source, found = stated(name, sensor, options, audit)
    unknown = any("mount" in c for c in options.get("targets", {}).values())
    if not found.status.ok or (found.T_robot_sensor is not None and not unknown):
        return source, found, {}
    recording, status = opened(args, options, audit)
    if not status.ok:
        return "none", Found(status=status), {}
    mounts = find_mounts(recording, options, audit)
    known = {n: rig.pose(c["T_body_target"]) for n, c in options["targets"].items()}
    known = {n: T for n, T in known.items() if n not in mounts}
    known |= {n: m.T_body_target for n, m in mounts.items() if m.status.ok}
    if not known:
        status = next(m.status for _, m in sorted(mounts.items()))
        return "none", Found(status=in_words(status, name)), mounts
    if found.T_robot_sensor is None:
        source, found = "found in the data", recording.sensor(name, sensor, known)
    if not found.status.ok:
        source, found = "none", replace(found, status=in_words(found.status, name))
    return source, found, mounts


def opened(args, options, audit):
    """(Recording, status): the session, or why nothing can be found in it."""
    stage.limit_threads()
    # 0.6 s, which only a search should pay.
    from calib import logs, tables
    from calib.guessing.recording import Recording

    logs.require_same(options["log"], audit["fingerprint"])
    placements, status, notes = tables.read(args.placements[0], tables.PLACEMENTS)
    held = [Status.from_dict(note) for _, note in sorted(notes.items())]
    if not status.ok or not any(s.ok for s in held):
        return None, held[0] if status.ok else status
    columns, _, _ = tables.read(args.frames[0], tables.FRAMES)
    log = logs.open_log(options["log"])
    return Recording(placements, columns, log, options["targets"], options["guess"]), OK


def find_mounts(recording, options, audit):
    """The handeye.Mount of every target of unknown mount, by name: by this sensor if it is a
    camera, else by another of the session."""
    own = options["name"]
    cameras = {n: options["cameras"][n] for n in sorted(options["cameras"], key=lambda n: n != own)}
    cameras = {n: c for n, c in cameras.items() if audit["sensors"][n]["status"]["ok"]}
    poses = {n: stated(n, c, options, audit)[1] for n, c in cameras.items()}
    priors = {n: (f.T_robot_sensor, f.sigma) for n, f in poses.items() if f.sigma is not None}
    return {target: recording.mount(target, cameras, priors) for target in recording.unknown()}


def in_words(status, name):
    """The status of a search, with the name of the sensor in what is said and advised."""
    remedy = f"{status.remedy} Or measure it (5 cm, 5 deg) and write sensors.{name}.T_robot_sensor."
    reason = f"no first guess for {name}: {status.reason}"
    return replace(status, reason=reason, remedy=remedy.strip())


def mounts_json(mounts):
    """The mounts that were found, as guess.json states them."""
    return {
        name: {"T_body_target": rig.pose_json(m.T_body_target), "sigma": m.sigma.tolist()}
        for name, m in mounts.items()
        if m.status.ok
    }


def main(argv=None):
    args = stage.parser(
        __doc__,
        audit="input log.json",
        placements="*input, where something is to be found",
        frames="*input, likewise",
        output="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    audit = stage.read_json(args.audit)
    source, found, mounts = find(args, options, audit)
    T, sigma = found.T_robot_sensor, found.sigma
    if T is None:
        sigma = rig.pose_sigma(options["guess"]["sigma"])
    stage.write_json(
        args.output,
        {
            "status": found.status.to_dict(),
            "T_robot_sensor": None if T is None else rig.pose_json(T),
            "sigma": np.asarray(sigma).tolist(),
            "source": source,
            "basis": found.basis,
            "mounts": mounts_json(mounts),
            "frame": audit["sensors"][options["name"]]["frame"],
            "time_offset_s": {
                "value": options["sensor"]["time_offset_s"],
                "sigma": options["sensor"]["time_offset_sigma_s"],
            },
        },
    )
    told = f"{source}{': ' if found.basis else ''}{found.basis}" if T is not None else found.status
    logger.info("%s: first guess from %s", options["name"], told)
    for name, mount in sorted(mounts.items()):
        logger.info("mount of %s: %s", name, mount.basis if mount.status.ok else mount.status)


if __name__ == "__main__":
    stage.run(main)
