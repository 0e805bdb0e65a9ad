"""Decide the initial guess of one sensor: stated if possible, else searched in the session.

The pose is the first of: T_robot_sensor of the rig, the file of `guess_from`, /tf_static, and a
search in the data. Stated poses are not used if the robot's markers were re-attached.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.initial_guess.initial_guess import OffsetGuess, PoseGuess
from calib.initial_guess.stated_pose import read_stated_pose
from calib.io.pose_block import pose_from_config, pose_json, pose_sigma_from_config
from calib.io.status import Status
from calib.sensors.sensor_models import with_log_metadata

if TYPE_CHECKING:
    # Its imports take 0.6 s, which jobs that search nothing save.
    from calib.initial_guess.session_search import SessionSearch


logger = logging.getLogger("calib")


@dataclass(frozen=True)
class SensorGuess:
    """Initial guess of T_robot_sensor, and of T_body_target of targets with unknown mount."""

    pose: PoseGuess
    mounts: dict[str, PoseGuess] = field(default_factory=dict)


def with_sensor_metadata(
    options: dict[str, Any], sensor_audits: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """Return the options with sensor blocks completed by the log. sensor_audits: of log.json."""
    cameras = {
        name: with_log_metadata(block, sensor_audits[name])
        for name, block in options.get("cameras", {}).items()
    }
    sensor = with_log_metadata(options["sensor"], sensor_audits[options["name"]])
    return options | {"sensor": sensor, "cameras": cameras}


def guess_time_offset(options: dict[str, Any], search: "SessionSearch | None") -> OffsetGuess:
    """Return the time offset of the sensor, s: found in the data, or else as stated."""
    name, sensor = options["name"], options["sensor"]
    if search is not None and search.poses is not None:
        guess = search.search_time_offset(name, sensor)
        if guess.value is not None:
            logger.info("%s: time offset %.2f s: %s", name, guess.value, guess.basis)
            return guess
        logger.info("%s: no time offset from the data: %s", name, guess.status)
    return OffsetGuess(sensor["time_offset_s"], sensor["time_offset_sigma_s"], source="config")


def guess_sensor_pose(
    options: dict[str, Any],
    audit: Mapping[str, Any],
    search: "SessionSearch | None",
    time_offset: OffsetGuess,
) -> SensorGuess:
    """Return the guess of the sensor's pose, and of unknown mounts if they are needed for it.

    options: of the stage guess (with_sensor_metadata). audit: content of log.json. search: the
    session, or None if its log is not read.
    """
    name, sensor = options["name"], options["sensor"]
    status = Status.from_dict(audit["sensors"][name]["status"])
    if not status.ok:
        return SensorGuess(PoseGuess(status=status))
    stated = read_stated_pose(name, sensor, options, audit)
    is_settled = stated.value is not None and not options["remounted"]
    has_unknown_mount = any("mount" in block for block in options.get("targets", {}).values())
    if not stated.status.ok or (is_settled and not has_unknown_mount):
        return SensorGuess(stated)
    assert search is not None and search.placements is not None
    status = search.placements.still_target_status()
    if not status.ok:
        return SensorGuess(PoseGuess(status=status))
    search = search.with_time_offset(time_offset)
    mounts = find_target_mounts(search, options, audit)
    known_mounts = list_known_mounts(options["targets"], mounts)
    if not known_mounts:
        status = next(mount.status for _, mount in sorted(mounts.items()))
        return SensorGuess(PoseGuess(status=name_sensor_in_status(status, name)), mounts)
    if is_settled:
        return SensorGuess(stated, mounts)
    pose = search.search_sensor_pose(name, sensor, known_mounts)
    if pose.status.ok:
        return SensorGuess(pose, mounts)
    if stated.value is not None:
        # The markers were re-attached: the stated pose may still be nearly right.
        logger.warning("%s: %s; its stated pose is used", name, pose.status.reason)
        return SensorGuess(stated, mounts)
    return SensorGuess(replace(pose, status=name_sensor_in_status(pose.status, name)), mounts)


def find_target_mounts(
    search: "SessionSearch", options: dict[str, Any], audit: Mapping[str, Any]
) -> dict[str, PoseGuess]:
    """Search T_body_target of every target with unknown mount.

    With this sensor if it is a camera, else with another camera of the session.
    """
    names = sorted(options["cameras"], key=lambda name: name != options["name"])
    cameras = {
        name: options["cameras"][name] for name in names if audit["sensors"][name]["status"]["ok"]
    }
    poses = {name: read_stated_pose(name, c, options, audit) for name, c in cameras.items()}
    stated_poses = {name: pose for name, pose in poses.items() if pose.value is not None}
    return {
        target: search.search_mount(target, cameras, stated_poses)
        for target in search.targets_without_mount()
    }


def list_known_mounts(
    targets: Mapping[str, dict[str, Any]], mounts: Mapping[str, PoseGuess]
) -> dict[str, np.ndarray]:
    """Return T_body_target (4, 4) by target name, stated or found; targets: config blocks."""
    stated = {
        name: pose_from_config(block["T_body_target"])
        for name, block in targets.items()
        if name not in mounts
    }
    return stated | {name: m.value for name, m in mounts.items() if m.value is not None}


def name_sensor_in_status(status: Status, sensor_name: str) -> Status:
    """Return the status of a search with the name of the sensor in its reason and remedy."""
    remedy = (
        f"{status.remedy} Or measure the pose (to 5 cm and 5 deg) and set "
        f"sensors.{sensor_name}.T_robot_sensor in the rig."
    )
    reason = f"no initial guess for {sensor_name}: {status.reason}"
    return replace(status, reason=reason, remedy=remedy.strip())


def guess_json(
    guess: SensorGuess,
    time_offset: OffsetGuess,
    sensor_audit: Mapping[str, Any],
    default_sigma: dict[str, float],
) -> dict[str, Any]:
    """Return the content of guess.json. default_sigma: block guess.sigma, if there is no pose."""
    pose = guess.pose
    sigma = pose_sigma_from_config(default_sigma) if pose.value is None else pose.sigma
    return {
        "status": pose.status.to_dict(),
        "T_robot_sensor": None if pose.value is None else pose_json(pose.value),
        "sigma": np.asarray(sigma).tolist(),
        "source": pose.source,
        "basis": pose.basis,
        "mounts": {
            name: {"T_body_target": pose_json(mount.value), "sigma": mount.sigma.tolist()}
            for name, mount in guess.mounts.items()
            if mount.value is not None and mount.sigma is not None
        },
        "frame": sensor_audit["frame"],
        "camera": sensor_audit.get("camera"),
        "time_offset_s": {
            "value": time_offset.value,
            "sigma": time_offset.sigma,
            "source": time_offset.basis or time_offset.source,
        },
    }


def describe_guess(guess: SensorGuess) -> str:
    """Return where the pose comes from, or why there is none, in words for the log."""
    pose = guess.pose
    if pose.value is None:
        return str(pose.status)
    return f"{pose.source}: {pose.basis}" if pose.basis else pose.source
