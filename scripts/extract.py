"""What one sensor saw of the targets.

Reads   views.parquet, motion.parquet, placements.parquet, mocap.parquet, guess.json
Writes  keypoints.parquet: corners; returns near a target's surface, a superset from which solve
        chooses; outline crossings. Each with its σ and stamp. Its notes hold the outcome of every
        kept view, expected against found, and the working pose that the sensor's views agree on.
        tracked.parquet: likewise of targets in motion, whose number of a placement is the view's
Starts from the guess and refines its working pose over its own views; never from a truth.
"""

from dataclasses import replace

import numpy as np

from calib import cropping, extraction, placements, rig, stage, tables, targets, tracking
from calib.extraction import job
from calib.mocap import NS
from calib.stage import logger
from calib.status import OK, failed

SCHEMAS = {"camera": tables.VIEWS_CAMERA, "lidar": tables.VIEWS_LIDAR}


def job_of(options, model, table, guess):
    """What extraction needs to know of this sensor and session."""
    sigma, mounts = np.array(guess["sigma"]), cropping.mounts(options["targets"], guess)
    return job.Job(
        name=options["name"],
        model=model,
        targets={n: targets.from_config(c) for n, c in options["targets"].items()},
        places=placements.still(table, "", options["targets"], options["mocap"], mounts),
        T_robot_sensor=np.array(guess["T_robot_sensor"]["matrix"]),
        sigma=sigma,
        margin=options["crop"]["margin_sigma"] * sigma,
        options=options["extract"],
        associate=options["associate"],
        crop=options["crop"],
    )


def in_motion(known, views, T_robot_sensor, options, poses, guess):
    """Keypoints and outcomes of the views of targets in motion; poses: columns of mocap.parquet."""
    blocks, late = options["targets"], round(guess["time_offset_s"]["value"] * NS)
    bodies = {n: c["body"] for n, c in blocks.items()}
    paths = tracking.trajectories(poses, options["body"], bodies, options["max_gap_s"])
    mounts, places = cropping.mounts(blocks, guess), {}
    for i in np.flatnonzero(views["kept"]):
        target = str(views["target"][i])
        t = int(views["t"][i]) + late
        if "dt" in views:
            t += int(np.median(views["dt"][i]))
        given = known.name, t, paths[target], mounts[target], options["mocap"]
        places[int(views["placement"][i])] = tracking.placement("", target, *given)
    there = replace(known, places={k: p for k, p in places.items() if p is not None})
    return extraction.at(options["sensor"]["kind"], there, views, T_robot_sensor)


def summary(name, outcomes, keypoints):
    """Ok, or why nothing was extracted from the kept views."""
    if len(keypoints["view"]):
        return OK
    reasons = [s.reason for _, s in outcomes]
    counts = ", ".join(f"{reasons.count(r)} × {r}" for r in sorted(set(reasons)))
    most = max((s for _, s in outcomes), key=lambda s: reasons.count(s.reason), default=OK)
    return failed(
        f"{name}: nothing found in {len(outcomes)} views",
        counts,
        "a target in some",
        most.remedy
        or "Look at the report's views; check the target's size, its body and T_robot_sensor.",
    )


def main(argv=None):
    args = stage.parser(
        __doc__,
        views="input",
        motion="input",
        placements="input",
        mocap="input",
        guess="input",
        output="output",
        tracked="output",
        options="slice of the config",
    ).parse_args(argv)
    stage.limit_threads()
    options = args.options
    kind = options["sensor"]["kind"]
    views, status, _ = tables.read(args.views, SCHEMAS[kind])
    guess = stage.read_json(args.guess)
    keypoints, outcomes, T = tables.empty(tables.KEYPOINTS), [], None
    tracked, followed = tables.empty(tables.KEYPOINTS), []
    if status.ok:
        table, _, _ = tables.read(args.placements, tables.PLACEMENTS)
        known = job_of(options, rig.model(rig.heard(options["sensor"], guess)), table, guess)
        keypoints, outcomes, T = extraction.SENSORS[kind](known, views)
        status = summary(options["name"], outcomes, keypoints)
    if status.ok:
        moving, _, _ = tables.read(args.motion, SCHEMAS[kind])
        poses, _, _ = tables.read(args.mocap, tables.MOCAP)
        tracked, followed = in_motion(known, moving, T, options, poses, guess)
    notes = {
        "outcomes": [{"view": v, "status": s.to_dict()} for v, s in outcomes],
        "T_robot_sensor": None if T is None else T.tolist(),
        "guess": guess,
    }
    tables.write(args.output, tables.KEYPOINTS, keypoints, status, notes)
    told = [{"view": v, "status": s.to_dict()} for v, s in followed]
    tables.write(args.tracked, tables.KEYPOINTS, tracked, status, {"outcomes": told})
    for view, outcome in outcomes:
        if not outcome.ok:
            logger.info("view %d: %s", view, outcome)
    used, n = sum(s.ok for _, s in outcomes), len(keypoints["view"])
    logger.info("%s: %d of %d views, %d keypoints", options["name"], used, len(outcomes), n)
    used, n = sum(s.ok for _, s in followed), len(tracked["view"])
    logger.info("%s: %d of %d in motion, %d keypoints", options["name"], used, len(followed), n)


if __name__ == "__main__":
    stage.run(main)
