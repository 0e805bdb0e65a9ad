"""Read the pose of a sensor that the rig config, an earlier calibration or the log states."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from calib.geometry.frame_graph import lookup_transform
from calib.initial_guess.initial_guess import PoseGuess
from calib.io.pose_block import pose_from_config, pose_sigma_from_config
from calib.io.status import InputError, failure_status


def pose_from_static_transforms(
    static_transforms: Iterable[Mapping[str, Any]], body: str, frame: str
) -> np.ndarray | None:
    """Return T_body_frame (4, 4) along static transforms of log.json or a URDF, or None.

    Raises InputError if a transform is not a rigid motion.
    """
    edges = {(e["parent"], e["child"]): pose_from_config(e["T"]) for e in static_transforms}
    return lookup_transform(edges, body, frame)


def read_stated_pose(
    sensor_name: str,
    sensor: Mapping[str, Any],
    options: Mapping[str, Any],
    audit: Mapping[str, Any],
) -> PoseGuess:
    """Return the stated T_robot_sensor; without value and with status ok if nothing states it.

    The first of these that states it: the sensor block, the file of `guess_from`, /tf_static.
    audit: content of log.json.
    """
    frame = audit["sensors"][sensor_name]["frame"]
    sigma = pose_sigma_from_config(sensor.get("guess_sigma", options["guess"]["sigma"]))
    previous = options.get("previous_poses", {}).get(sensor_name, {})
    if "T_robot_sensor" in sensor:
        return PoseGuess(pose_from_config(sensor["T_robot_sensor"]), sigma, source="config")
    if "T_robot_sensor" in previous:
        previous_pose = pose_from_config(previous["T_robot_sensor"])
        return PoseGuess(previous_pose, sigma, source=previous["source"])
    if previous.get("static"):
        T = pose_from_static_transforms(previous["static"], options["body"], frame.lstrip("/"))
        if T is not None:
            return PoseGuess(T, sigma, source=previous["source"])
    try:
        T = pose_from_static_transforms(audit["static"], options["body"], frame)
    except InputError as error:
        status = failure_status(
            "a static transform of the log is not a rigid motion",
            error,
            remedy=f"Fix its publisher, or set sensors.{sensor_name}.T_robot_sensor in the rig.",
        )
        return PoseGuess(status=status)
    return PoseGuess() if T is None else PoseGuess(T, sigma, source="tf_static")
