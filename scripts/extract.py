"""What one sensor saw of the targets.

Reads   views.parquet, placements.parquet, guess.json
Writes  keypoints.parquet: corners; returns near a target's surface, a superset from which solve
        chooses; outline crossings. Each with its σ and stamp. Its notes hold the outcome of every
        kept view, expected against found, and the working pose that the sensor's views agree on.
Starts from the guess and refines its working pose over its own views; never from a truth.
"""

import numpy as np

from calib import cropping, extraction, placements, rig, stage, tables, targets
from calib.extraction import job
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


def summary(name, outcomes, keypoints):
    """Ok, or why nothing was extracted from the kept views."""
    if len(keypoints["view"]):
        return OK
    reasons = [s.reason for _, s in outcomes]
    counts = ", ".join(f"{reasons.count(r)} × {r}" for r in sorted(set(reasons)))
    return failed(
        f"{name}: nothing found in {len(outcomes)} views",
        counts,
        "a target in some",
        "Look at the report's views; check the target's size, its body and T_robot_sensor.",
    )


def main(argv=None):
    args = stage.parser(
        __doc__,
        views="input",
        placements="input",
        guess="input",
        output="output",
        options="slice of the config",
    ).parse_args(argv)
    stage.limit_threads()
    options = args.options
    kind = options["sensor"]["kind"]
    views, status, _ = tables.read(args.views, SCHEMAS[kind])
    guess = stage.read_json(args.guess)
    keypoints, outcomes, T = tables.empty(tables.KEYPOINTS), [], None
    if status.ok:
        table, _, _ = tables.read(args.placements, tables.PLACEMENTS)
        known = job_of(options, rig.model(options["sensor"]), table, guess)
        keypoints, outcomes, T = extraction.SENSORS[kind](known, views)
        status = summary(options["name"], outcomes, keypoints)
    notes = {
        "outcomes": [{"view": v, "status": s.to_dict()} for v, s in outcomes],
        "T_robot_sensor": None if T is None else T.tolist(),
        "guess": guess,
    }
    tables.write(args.output, tables.KEYPOINTS, keypoints, status, notes)
    for view, outcome in outcomes:
        if not outcome.ok:
            logger.info("view %d: %s", view, outcome)
    used, n = sum(s.ok for _, s in outcomes), len(keypoints["view"])
    logger.info("%s: %d of %d views, %d keypoints", options["name"], used, len(outcomes), n)


if __name__ == "__main__":
    stage.run(main)
