"""What one sensor saw of the targets.

Reads   views.parquet, moving_views.parquet, placements.parquet, mocap.parquet, guess.json
Writes  keypoints.parquet: corners; returns near a target's surface, a superset from which solve
        chooses; outline crossings. Each with its σ and stamp. Its notes hold the outcome of every
        kept view, expected against found, and the working pose that the sensor's views agree on.
        moving_keypoints.parquet: likewise of targets in motion, whose number of a placement is the view's
Starts from the guess and refines its working pose over its own views; never from a truth.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.estimation.measurement_groups import make_still_placements
from calib.estimation.moving_view_poses import TargetPath, make_moving_placement
from calib.extraction.extraction_inputs import ExtractionContext
from calib.extraction.extractor_registry import KEYPOINT_EXTRACTORS, extract_views_at_pose
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import empty_columns, read_table, write_table
from calib.io.stage_cli import (
    StageArgumentParser,
    limit_opencv_threads,
    logger,
    read_json,
    run_stage,
)
from calib.io.status import OK, failure_status
from calib.io.table_schemas import (
    CAMERA_VIEWS_SCHEMA,
    KEYPOINTS_SCHEMA,
    LIDAR_VIEWS_SCHEMA,
    MOCAP_SCHEMA,
    PLACEMENTS_SCHEMA,
)
from calib.mocap.body_trajectory import target_trajectories
from calib.sensors.sensor_models import sensor_model_from_config, with_log_metadata
from calib.targets.target_shapes import target_from_config
from calib.views.target_placements import mounts_from_guess

VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}


def make_extraction_context(options, model, placement_table, guess):
    """What extraction needs to know of this sensor and session."""
    sigma, mounts = np.array(guess["sigma"]), mounts_from_guess(options["targets"], guess)
    return ExtractionContext(
        name=options["name"],
        model=model,
        targets={n: target_from_config(c) for n, c in options["targets"].items()},
        placements=make_still_placements(
            placement_table,
            "",
            targets=options["targets"],
            mocap_noise=options["mocap"],
            mounts=mounts,
        ),
        T_robot_sensor=np.array(guess["T_robot_sensor"]["matrix"]),
        guess_sigma=sigma,
        pose_margin=options["crop"]["margin_sigma"] * sigma,
        extract_options=options["extract"],
        associate_options=options["associate"],
        crop_options=options["crop"],
    )


def extract_moving_views(context, views, T_robot_sensor, options, poses, guess):
    """Keypoints and outcomes of the views of targets in motion; poses: columns of mocap.parquet."""
    blocks, late = options["targets"], round(guess["time_offset_s"]["value"] * NS_PER_S)
    bodies = {n: c["body"] for n, c in blocks.items()}
    paths = target_trajectories(poses, options["body"], bodies, options["max_gap_s"])
    mounts, places = mounts_from_guess(blocks, guess), {}
    for i in np.flatnonzero(views["kept"]):
        target = str(views["target"][i])
        t = int(views["stamp_ns"][i]) + late
        if "point_time_ns" in views:
            t += int(np.median(views["point_time_ns"][i]))
        places[int(views["placement"][i])] = make_moving_placement(
            TargetPath(target, mounts[target], paths[target]),
            session="",
            sensor=context.name,
            time_ns=t,
            mocap_noise=options["mocap"],
        )
    there = replace(context, placements={k: p for k, p in places.items() if p is not None})
    return extract_views_at_pose(options["sensor"]["kind"], there, views, T_robot_sensor)


def extraction_status(name, outcomes, keypoints):
    """Ok, or why nothing was extracted from the kept views."""
    if len(keypoints["view"]):
        return OK
    reasons = [s.reason for _, s in outcomes]
    counts = ", ".join(f"{reasons.count(r)} × {r}" for r in sorted(set(reasons)))
    most = max((s for _, s in outcomes), key=lambda s: reasons.count(s.reason), default=OK)
    return failure_status(
        f"{name}: nothing found in {len(outcomes)} views",
        counts,
        "a target in some",
        most.remedy
        or "Look at the report's views; check the target's size, its body and T_robot_sensor.",
    )


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--views", "views.parquet")
    parser.add_path("--moving-views", "moving_views.parquet")
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--guess", "guess.json")
    parser.add_path("--output", "keypoints.parquet to write")
    parser.add_path("--moving-keypoints", "moving_keypoints.parquet to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    limit_opencv_threads()
    options = args.options
    kind = options["sensor"]["kind"]
    views, status, _ = read_table(args.views, VIEW_SCHEMAS[kind])
    guess = read_json(args.guess)
    keypoints, outcomes, T = empty_columns(KEYPOINTS_SCHEMA), [], None
    tracked, followed = empty_columns(KEYPOINTS_SCHEMA), []
    if status.ok:
        table, _, _ = read_table(args.placements, PLACEMENTS_SCHEMA)
        known = make_extraction_context(
            options,
            sensor_model_from_config(with_log_metadata(options["sensor"], guess)),
            table,
            guess,
        )
        keypoints, outcomes, T = KEYPOINT_EXTRACTORS[kind](known, views)
        status = extraction_status(options["name"], outcomes, keypoints)
    if status.ok:
        moving, _, _ = read_table(args.moving_views, VIEW_SCHEMAS[kind])
        poses, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
        tracked, followed = extract_moving_views(known, moving, T, options, poses, guess)
    notes = {
        "outcomes": [{"view": v, "status": s.to_dict()} for v, s in outcomes],
        "T_robot_sensor": None if T is None else T.tolist(),
        "guess": guess,
    }
    write_table(args.output, KEYPOINTS_SCHEMA, keypoints, status, notes)
    told = [{"view": v, "status": s.to_dict()} for v, s in followed]
    write_table(args.moving_keypoints, KEYPOINTS_SCHEMA, tracked, status, {"outcomes": told})
    for view, outcome in outcomes:
        if not outcome.ok:
            logger.info("view %d: %s", view, outcome)
    used, n = sum(s.ok for _, s in outcomes), len(keypoints["view"])
    logger.info("%s: %d of %d views, %d keypoints", options["name"], used, len(outcomes), n)
    used, n = sum(s.ok for _, s in followed), len(tracked["view"])
    logger.info("%s: %d of %d in motion, %d keypoints", options["name"], used, len(followed), n)


if __name__ == "__main__":
    run_stage(main)
