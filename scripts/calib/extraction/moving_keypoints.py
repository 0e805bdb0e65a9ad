"""Extract the keypoints of moving targets, at the working pose of the sensor."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib.estimation.moving_view_poses import TargetPath, make_moving_placement
from calib.extraction.extraction_inputs import ExtractionContext, kept_rows
from calib.extraction.extraction_results import Extraction
from calib.extraction.extractor_registry import SENSOR_EXTRACTORS
from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import target_trajectories
from calib.views.target_placements import Columns, mounts_from_guess


def extract_moving_views(
    context: ExtractionContext,
    views: Columns,
    T_robot_sensor: np.ndarray,
    *,
    poses: Columns,
    guess_json: Mapping[str, Any],
    options: Mapping[str, Any],
) -> Extraction:
    """Extract the kept views of moving_views.parquet, except where the MCS has no pose.

    T_robot_sensor: working pose (4, 4). poses: columns of mocap.parquet. options: of extract.
    """
    targets = options["targets"]
    bodies = {name: block["body"] for name, block in targets.items()}
    trajectories = target_trajectories(poses, options["body"], bodies, options["max_gap_s"])
    mounts = mounts_from_guess(targets, guess_json)
    offset_ns = round(guess_json["time_offset_s"]["value"] * NS_PER_S)
    placements = {}
    for i in kept_rows(views):
        target = str(views["target"][i])
        time_ns = _measurement_time_ns(views, i) + offset_ns
        placement = make_moving_placement(
            TargetPath(target, mounts[target], trajectories[target]),
            session="",
            sensor=context.name,
            time_ns=time_ns,
            mocap_noise=options["mocap"],
        )
        if placement is not None:
            placements[int(views["placement"][i])] = placement
    moving = replace(context, placements=placements)
    extract_view = SENSOR_EXTRACTORS[options["sensor"]["kind"]].extract_view
    results = {
        i: extract_view(moving, views, i, T_robot_sensor)
        for i in kept_rows(views)
        if int(views["placement"][i]) in placements
    }
    return Extraction.collect(views, results)


def _measurement_time_ns(views: Columns, i: int) -> int:
    """Return the stamp of a view; of a scan the median time of its returns."""
    time_ns = int(views["stamp_ns"][i])
    if "point_time_ns" in views:
        time_ns += int(np.median(views["point_time_ns"][i]))
    return time_ns
