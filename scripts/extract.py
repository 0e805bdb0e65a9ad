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

from calib.estimation import measurement_groups, moving_view_poses
from calib.extraction import extraction_inputs, extractor_registry
from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.stage_cli import logger
from calib.io.status import OK, failed
from calib.mocap import body_trajectory
from calib.mocap.body_trajectory import NS
from calib.sensors import sensor_models
from calib.targets import target_shapes
from calib.views import frame_selection

SCHEMAS = {"camera": table_schemas.VIEWS_CAMERA, "lidar": table_schemas.VIEWS_LIDAR}


def job_of(options, model, table, guess):
    """What extraction needs to know of this sensor and session."""
    sigma, mounts = np.array(guess["sigma"]), frame_selection.mounts(options["targets"], guess)
    return extraction_inputs.Job(
        name=options["name"],
        model=model,
        targets={n: target_shapes.from_config(c) for n, c in options["targets"].items()},
        places=measurement_groups.still(table, "", options["targets"], options["mocap"], mounts),
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
    paths = body_trajectory.trajectories(poses, options["body"], bodies, options["max_gap_s"])
    mounts, places = frame_selection.mounts(blocks, guess), {}
    for i in np.flatnonzero(views["kept"]):
        target = str(views["target"][i])
        t = int(views["t"][i]) + late
        if "dt" in views:
            t += int(np.median(views["dt"][i]))
        given = known.name, t, paths[target], mounts[target], options["mocap"]
        places[int(views["placement"][i])] = moving_view_poses.placement("", target, *given)
    there = replace(known, places={k: p for k, p in places.items() if p is not None})
    return extractor_registry.at(options["sensor"]["kind"], there, views, T_robot_sensor)


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
    args = stage_cli.parser(
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
    stage_cli.limit_threads()
    options = args.options
    kind = options["sensor"]["kind"]
    views, status, _ = parquet_tables.read(args.views, SCHEMAS[kind])
    guess = stage_cli.read_json(args.guess)
    keypoints, outcomes, T = parquet_tables.empty(table_schemas.KEYPOINTS), [], None
    tracked, followed = parquet_tables.empty(table_schemas.KEYPOINTS), []
    if status.ok:
        table, _, _ = parquet_tables.read(args.placements, table_schemas.PLACEMENTS)
        known = job_of(
            options,
            sensor_models.model(sensor_models.heard(options["sensor"], guess)),
            table,
            guess,
        )
        keypoints, outcomes, T = extractor_registry.SENSORS[kind](known, views)
        status = summary(options["name"], outcomes, keypoints)
    if status.ok:
        moving, _, _ = parquet_tables.read(args.motion, SCHEMAS[kind])
        poses, _, _ = parquet_tables.read(args.mocap, table_schemas.MOCAP)
        tracked, followed = in_motion(known, moving, T, options, poses, guess)
    notes = {
        "outcomes": [{"view": v, "status": s.to_dict()} for v, s in outcomes],
        "T_robot_sensor": None if T is None else T.tolist(),
        "guess": guess,
    }
    parquet_tables.write(args.output, table_schemas.KEYPOINTS, keypoints, status, notes)
    told = [{"view": v, "status": s.to_dict()} for v, s in followed]
    parquet_tables.write(args.tracked, table_schemas.KEYPOINTS, tracked, status, {"outcomes": told})
    for view, outcome in outcomes:
        if not outcome.ok:
            logger.info("view %d: %s", view, outcome)
    used, n = sum(s.ok for _, s in outcomes), len(keypoints["view"])
    logger.info("%s: %d of %d views, %d keypoints", options["name"], used, len(outcomes), n)
    used, n = sum(s.ok for _, s in followed), len(tracked["view"])
    logger.info("%s: %d of %d in motion, %d keypoints", options["name"], used, len(followed), n)


if __name__ == "__main__":
    stage_cli.run(main)
