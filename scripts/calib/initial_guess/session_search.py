"""What a session's log can tell of its sensors' poses and of its targets' mounts."""

from dataclasses import dataclass

import numpy as np

from calib.initial_guess import camera_from_patterns, frame_sampling, hand_eye, lidar_matching
from calib.initial_guess.pose_guess import Found
from calib.io import parquet_tables
from calib.io.status import failed
from calib.sensors import sensor_models
from calib.targets import target_shapes
from calib.views import frame_selection, sensor_reader


@dataclass(frozen=True)
class Recording:
    """Columns of placements.parquet and frames.parquet, the open log, target blocks by name, and
    the options of guess."""

    placements: dict
    frames: dict
    log: object
    targets: dict
    options: dict

    def unknown(self):
        """Names of the targets whose mount is to be found."""
        return [n for n, c in sorted(self.targets.items()) if "mount" in c]

    def _looks(self, name, sensor, mounts):
        """Looks of a sensor at the targets with a mount (name -> T_body_target), and its reader."""
        frames = parquet_tables.select(self.frames, self.frames["sensor"] == name)
        T = frame_selection.placed(self.placements, mounts)
        found = [
            look
            for target in sorted(mounts)
            for look in frame_sampling.choose(frames, self.placements, T, target, self.options)
        ]
        return found, sensor_reader.reader(self.log, sensor, frames)

    def mount(self, target, cameras, poses):
        """The handeye.Mount of a target by the first of the cameras (name -> block) that tells it.

        poses: what is known of cameras, name -> (T_robot_camera (4, 4), σ (6,)).
        """
        shape = target_shapes.from_config(self.targets[target])
        found = hand_eye.Mount(status=_no_camera(target))
        for name, sensor in cameras.items():
            seen = *self._looks(name, sensor, {target: np.eye(4)}), poses.get(name)
            found = hand_eye.find(sensor_models.model(sensor), shape, *seen, self.options)
            if found.status.ok:
                break
        return found

    def sensor(self, name, sensor, mounts):
        """Found: a sensor by what it saw of the targets with a mount (name -> T_body_target)."""
        shapes = {n: target_shapes.from_config(self.targets[n]) for n in mounts}
        seen, content_of = self._looks(name, sensor, mounts)
        if not seen:
            return Found(status=_no_frame(sorted(mounts)))
        find = SENSORS[sensor["kind"]]
        return find(sensor_models.model(sensor), shapes, seen, content_of, self.options)


def _no_camera(target):
    return failed(
        f"the mount of {target} is unknown and there is no camera to find it by",
        "no camera in the session",
        "1 or more that sees its pattern",
        "Measure T_body_target, or record a camera too.",
    )


def _no_frame(names):
    return failed(
        "no pose found in the data",
        f"no frame while {' or '.join(names)} is held still",
        "frames at several placements",
        "Hold the targets still for a second at several places in view of this sensor.",
    )


SENSORS = {"camera": camera_from_patterns.find, "lidar": lidar_matching.find}
