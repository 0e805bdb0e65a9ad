"""What a session's log can tell of its sensors' poses and of its targets' mounts."""

from dataclasses import dataclass

import numpy as np

from calib.initial_guess.camera_from_patterns import find_camera_pose
from calib.initial_guess.frame_sampling import choose_frame_samples
from calib.initial_guess.hand_eye import MountGuess, find_mount
from calib.initial_guess.lidar_matching import find_lidar_pose
from calib.initial_guess.pose_guess import PoseGuess
from calib.io.parquet_tables import select_rows
from calib.io.status import failure_status
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config
from calib.views.sensor_reader import make_frame_reader
from calib.views.target_placements import compute_target_poses


@dataclass(frozen=True)
class SessionSearch:
    """Columns of placements.parquet and frames.parquet, the open log, target blocks by name, and
    the options of guess."""

    placements: dict
    frames: dict
    log: object
    targets: dict
    options: dict

    def targets_without_mount(self):
        """Names of the targets whose mount is to be found."""
        return [n for n, c in sorted(self.targets.items()) if "mount" in c]

    def _sample_frames(self, name, sensor, mounts):
        """Looks of a sensor at the targets with a mount (name -> T_body_target), and its reader."""
        frames = select_rows(self.frames, self.frames["sensor"] == name)
        T = compute_target_poses(self.placements, mounts)
        found = [
            look
            for target in sorted(mounts)
            for look in choose_frame_samples(frames, self.placements, T, target, self.options)
        ]
        return found, make_frame_reader(self.log, sensor, frames)

    def search_mount(self, target, cameras, poses):
        """The handeye.Mount of a target by the first of the cameras (name -> block) that tells it.

        poses: what is known of cameras, name -> (T_robot_camera (4, 4), σ (6,)).
        """
        shape = target_from_config(self.targets[target])
        found = MountGuess(status=_no_camera_status(target))
        for name, sensor in cameras.items():
            seen = *self._sample_frames(name, sensor, {target: np.eye(4)}), poses.get(name)
            found = find_mount(sensor_model_from_config(sensor), shape, *seen, self.options)
            if found.status.ok:
                break
        return found

    def search_sensor_pose(self, name, sensor, mounts):
        """Found: a sensor by what it saw of the targets with a mount (name -> T_body_target)."""
        shapes = {n: target_from_config(self.targets[n]) for n in mounts}
        seen, content_of = self._sample_frames(name, sensor, mounts)
        if not seen:
            return PoseGuess(status=_no_frame_status(sorted(mounts)))
        find = POSE_SEARCHES[sensor["kind"]]
        return find(sensor_model_from_config(sensor), shapes, seen, content_of, self.options)


def _no_camera_status(target):
    return failure_status(
        f"the mount of {target} is unknown and there is no camera to find it by",
        "no camera in the session",
        "1 or more that sees its pattern",
        "Measure T_body_target, or record a camera too.",
    )


def _no_frame_status(names):
    return failure_status(
        "no pose found in the data",
        f"no frame while {' or '.join(names)} is held still",
        "frames at several placements",
        "Hold the targets still for a second at several places in view of this sensor.",
    )


POSE_SEARCHES = {"camera": find_camera_pose, "lidar": find_lidar_pose}
