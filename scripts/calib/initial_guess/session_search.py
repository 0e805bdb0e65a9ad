"""Search time offset, poses and mounts in the log of one session."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from calib.initial_guess.camera_from_patterns import check_camera_samples, find_camera_pose
from calib.initial_guess.clock_lag import find_clock_lag
from calib.initial_guess.hand_eye import MAX_MOUNT_SIGMA, check_mount_placements, find_mount
from calib.initial_guess.initial_guess import SOURCE_DATA, OffsetGuess, PoseGuess
from calib.initial_guess.lidar_matching import check_lidar_samples, find_lidar_pose
from calib.io.parquet_tables import select_rows
from calib.io.status import Status, failure_status
from calib.mocap.body_trajectory import trajectory_from_columns
from calib.sensors.sensor_models import camera_from_config, sensor_model_from_config
from calib.targets.target_shapes import TargetShape, target_from_config
from calib.views.initial_guess_frames import FrameSample, choose_frame_samples
from calib.views.sensor_croppers import FrameReader, make_frame_reader
from calib.views.target_placements import (
    Columns,
    PlacementTable,
    compute_target_poses,
    trim_placement_ends,
    with_mocap_time,
)


class PoseSearch(Protocol):
    """Search the pose of one kind of sensor by what it sees of targets at known poses.

    model: CameraModel or LidarModel. targets: by name. samples: frames to read. options: `guess`.
    """

    def __call__(
        self,
        model: Any,
        targets: Mapping[str, TargetShape],
        samples: list[FrameSample],
        read_frame: FrameReader,
        options: dict[str, Any],
        /,
    ) -> PoseGuess: ...


class SampleCheck(Protocol):
    """Return ok if there are enough placements for a search, known before a frame is read.

    sampled_targets: name of the target of each placement with a frame. options: block `guess`.
    """

    def __call__(
        self,
        targets: Mapping[str, TargetShape],
        sampled_targets: Sequence[str],
        options: dict[str, Any],
        /,
    ) -> Status: ...


POSE_SEARCHES: dict[str, PoseSearch] = {"camera": find_camera_pose, "lidar": find_lidar_pose}
SAMPLE_CHECKS: dict[str, SampleCheck] = {
    "camera": check_camera_samples,
    "lidar": check_lidar_samples,
}


@dataclass(frozen=True)
class SessionSearch:
    """One session to search in.

    log: the open log. frames: columns of frames.parquet. placements: if poses are searched. poses:
    columns of mocap.parquet, if the time offset is searched. options: of the stage guess.
    """

    log: Any
    frames: Columns
    placements: PlacementTable | None
    poses: Columns | None
    options: dict[str, Any]

    def with_time_offset(self, time_offset: OffsetGuess) -> "SessionSearch":
        """Return the session with frames on the clock of the MCS and trimmed placements."""
        assert self.placements is not None
        assert time_offset.value is not None and time_offset.sigma is not None
        columns = trim_placement_ends(self.placements.columns, time_offset.sigma)
        return replace(
            self,
            frames=with_mocap_time(self.frames, time_offset.value),
            placements=replace(self.placements, columns=columns),
        )

    def targets_without_mount(self) -> list[str]:
        """Return the names of the targets whose mount must be found."""
        return [name for name, block in sorted(self.options["targets"].items()) if "mount" in block]

    def search_time_offset(self, name: str, sensor: dict[str, Any]) -> OffsetGuess:
        """Search the time offset of a sensor from when its data change."""
        assert self.poses is not None  # read if the time offset is searched
        frames = self._sensor_frames(name)
        trajectories = [
            trajectory_from_columns(self.poses, body, self.options["max_gap_s"])
            for body in self.options["bodies"]
        ]
        stated = {"value": sensor["time_offset_s"], "sigma": sensor["time_offset_sigma_s"]}
        read_frame = make_frame_reader(self.log, sensor, frames)
        return find_clock_lag(sensor["kind"], frames["stamp_ns"], read_frame, trajectories, stated)

    def search_mount(
        self,
        target_name: str,
        cameras: Mapping[str, dict[str, Any]],
        camera_poses: Mapping[str, PoseGuess],
    ) -> PoseGuess:
        """Search T_body_target with the first of the cameras (name -> block) that determines it.

        camera_poses: stated poses of cameras, by name.
        """
        target = target_from_config(self.options["targets"][target_name])
        guess = PoseGuess(status=_no_camera_status(target_name))
        for name, sensor in cameras.items():
            samples = self.sample_placements(name, {target_name: np.eye(4)})
            T_robot_body = np.reshape([s.T_robot_target for s in samples], (-1, 4, 4))
            status = check_mount_placements(T_robot_body, name in camera_poses)
            guess = PoseGuess(status=status)
            if status.ok:
                prior = camera_poses.get(name)
                guess = self.find_mount_in_frames(name, sensor, target, samples, prior=prior)
            if guess.status.ok:
                break
        return guess

    def find_mount_in_frames(
        self,
        name: str,
        sensor: dict[str, Any],
        target: TargetShape,
        samples: list[FrameSample],
        *,
        prior: PoseGuess | None,
    ) -> PoseGuess:
        """Search T_body_target in samples of a camera, whose pose may be known."""
        return find_mount(
            camera_from_config(sensor),
            target,
            samples,
            self._make_reader(name, sensor),
            camera_prior=prior,
            options=self.options["guess"],
        )

    def search_sensor_pose(
        self, name: str, sensor: dict[str, Any], mounts: Mapping[str, np.ndarray]
    ) -> PoseGuess:
        """Search T_robot_sensor by the targets with a mount: T_body_target (4, 4) by name."""
        targets = {n: target_from_config(self.options["targets"][n]) for n in mounts}
        samples = self.sample_placements(name, mounts)
        if not samples:
            return PoseGuess(status=_no_frame_status(sorted(mounts)))
        sampled_targets = [sample.target for sample in samples]
        status = SAMPLE_CHECKS[sensor["kind"]](targets, sampled_targets, self.options["guess"])
        if not status.ok:
            return PoseGuess(status=status)
        guess = self.find_pose_in_frames(name, sensor, targets, samples)
        return replace(guess, source=SOURCE_DATA) if guess.status.ok else guess

    def find_pose_in_frames(
        self,
        name: str,
        sensor: dict[str, Any],
        targets: Mapping[str, TargetShape],
        samples: list[FrameSample],
    ) -> PoseGuess:
        """Search T_robot_sensor in samples of the sensor."""
        search, model = POSE_SEARCHES[sensor["kind"]], sensor_model_from_config(sensor)
        read_frame = self._make_reader(name, sensor)
        return search(model, targets, samples, read_frame, self.options["guess"])

    def _sensor_frames(self, name: str) -> Columns:
        return select_rows(self.frames, self.frames["sensor"] == name)

    def _make_reader(self, name: str, sensor: dict[str, Any]) -> FrameReader:
        return make_frame_reader(self.log, sensor, self._sensor_frames(name))

    def sample_frames(
        self, name: str, sensor: dict[str, Any], mounts: Mapping[str, np.ndarray]
    ) -> tuple[list[FrameSample], FrameReader]:
        """Return samples of the targets with a mount in the frames of a sensor, and its reader."""
        return self.sample_placements(name, mounts), self._make_reader(name, sensor)

    def sample_placements(self, name: str, mounts: Mapping[str, np.ndarray]) -> list[FrameSample]:
        """Return samples of the targets with a mount in the frames of a sensor."""
        assert self.placements is not None
        placements = self.placements.columns
        T_robot_target = compute_target_poses(placements, mounts)
        return [
            sample
            for target_name in sorted(mounts)
            for sample in choose_frame_samples(
                self._sensor_frames(name),
                placements,
                T_robot_target,
                target_name,
                self.options["guess"],
            )
        ]


@dataclass(frozen=True)
class SearchForecast(SessionSearch):
    """The same searches without the log: they fail where the real ones are certain to fail.

    What may be found is found at the origin.
    """

    def find_mount_in_frames(
        self,
        name: str,
        sensor: dict[str, Any],
        target: TargetShape,
        samples: list[FrameSample],
        *,
        prior: PoseGuess | None,
    ) -> PoseGuess:
        return PoseGuess(np.eye(4), MAX_MOUNT_SIGMA, source=SOURCE_DATA)

    def find_pose_in_frames(
        self,
        name: str,
        sensor: dict[str, Any],
        targets: Mapping[str, TargetShape],
        samples: list[FrameSample],
    ) -> PoseGuess:
        return PoseGuess(np.eye(4), MAX_MOUNT_SIGMA, source=SOURCE_DATA)


def _no_camera_status(target_name: str) -> Status:
    return failure_status(
        f"T_body_target of {target_name} is unknown and there is no camera to find it with",
        "no camera in the session",
        "1 or more that sees its pattern",
        "Measure T_body_target, or record a camera too.",
    )


def _no_frame_status(target_names: list[str]) -> Status:
    return failure_status(
        "no pose found in the data",
        f"no frame of the sensor while {' or '.join(target_names)} stands still",
        "frames at several placements",
        "Hold the targets still for a second at several places in view of this sensor.",
    )
