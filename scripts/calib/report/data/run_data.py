"""Inputs of the report as plain data."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry.se3 import invert_pose, pose_from_xyz_quat
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_from_config
from calib.io.status import Status
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA

VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}
# The payload (image, points) of all views may not fit in memory.
COLUMNS_WITHOUT_PAYLOAD = ("view", "stamp_ns", "target", "placement", "kept", "reason")

Columns = dict[str, np.ndarray]  # a table: arrays of the same length by name of the column


@dataclass(frozen=True)
class ReportStream:
    """One sensor in one session.

    guess: guess.json; views: views.parquet without the payload; status_by_view: whether the target
    was found, by number of the view.
    """

    guess: dict[str, Any]
    views: Columns
    views_status: Status
    keypoints: Columns
    keypoints_status: Status
    status_by_view: dict[int, Status]
    views_path: Path


@dataclass(frozen=True)
class ReportSession:
    """One recording.

    audit: log.json; frames: sensor, stamp and log time of each message; placements:
    placements.parquet; streams: by name of the sensor; mocap_notes: on the noise of motion capture
    at rest.
    """

    audit: dict[str, Any]
    frames: Columns
    placements: Columns
    placements_status: Status
    status_by_target: dict[str, Status]
    streams: dict[str, ReportStream]
    mocap_notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReportRun:
    """All inputs of the report of one rig.

    residuals: those of still targets; moving_residuals: those of moving targets; iterations: one
    row per round of the solve; sessions: by name.
    """

    options: dict[str, Any]
    calibration: dict[str, Any]
    verdict: dict[str, Any]
    residuals: Columns
    moving_residuals: Columns
    iterations: Columns
    sessions: dict[str, ReportSession]

    @cached_property
    def residuals_by_sensor(self) -> dict[str, dict[str, Columns]]:
        """Return the residuals of still targets by sensor and kind, both in order of name."""
        return _split_by_sensor(self.residuals)

    @cached_property
    def moving_residuals_by_sensor(self) -> dict[str, dict[str, Columns]]:
        """Return the residuals of moving targets by sensor and kind, both in order of name."""
        return _split_by_sensor(self.moving_residuals)

    @cached_property
    def used_views_by_stream(self) -> dict[tuple[str, str], set[int]]:
        """Return the numbers of the views with an inlier in the solve, by session and sensor."""
        used: dict[tuple[str, str], set[int]] = {}
        for sensor, kinds in self.residuals_by_sensor.items():
            for columns in kinds.values():
                is_inlier = np.asarray(columns["weight"]) > 0
                for session in np.unique(columns["session"][is_inlier]).tolist():
                    views = columns["view"][is_inlier & (columns["session"] == session)]
                    used.setdefault((session, sensor), set()).update(np.unique(views).tolist())
        return used

    @property
    def sensors(self) -> dict[str, dict[str, Any]]:
        """Return the blocks of calibration.json by sensor, in order of name."""
        return dict(sorted(self.calibration["sensors"].items()))

    def T_robot_sensor(self, sensor: str) -> np.ndarray | None:
        """Return the result (4, 4), or None without a pose."""
        T = self.sensors[sensor]["T_robot_sensor"] if sensor in self.sensors else None
        return None if T is None else np.array(T["matrix"])

    def T_robot_sensor_true(self, sensor: str) -> np.ndarray | None:
        """Return the true T_robot_sensor (4, 4), or None if the rig does not state it."""
        truth = self.options.get("truth", {})
        return pose_from_config(truth[sensor]) if sensor in truth else None

    @property
    def unknown_truth_sensors(self) -> list[str]:
        """Return the sensors whose truth is stated, but that are not in the calibration."""
        return sorted(set(self.options.get("truth", {})) - set(self.sensors))

    def T_robot_target(self, session: str, placement: int, use_config: bool = False) -> np.ndarray:
        """Return the mean pose (4, 4) of the target of a placement in the robot frame."""
        placements = self.sessions[session].placements
        row = np.flatnonzero(np.asarray(placements["placement"]) == placement)[0]
        T_robot_body = pose_from_xyz_quat(placements["xyz"][row], placements["quat"][row])
        return T_robot_body @ self.T_body_target(str(placements["target"][row]), use_config)

    def T_sensor_target(
        self, sensor: str, session: str, placement: int
    ) -> dict[str, np.ndarray | None]:
        """Return T_sensor_target (4, 4) or None by "guess", "result" and "truth".

        The initial guess uses the mount of the config, the others the estimated mount.
        """
        guess = self.sessions[session].streams[sensor].guess["T_robot_sensor"]
        T_robot_sensor = {
            "guess": None if guess is None else np.array(guess["matrix"]),
            "result": self.T_robot_sensor(sensor),
            "truth": self.T_robot_sensor_true(sensor),
        }
        poses: dict[str, np.ndarray | None] = {}
        for name, T in T_robot_sensor.items():
            T_robot_target = self.T_robot_target(session, placement, name == "guess")
            poses[name] = None if T is None else invert_pose(T) @ T_robot_target
        return poses

    def T_body_target(self, target: str, use_config: bool = False) -> np.ndarray:
        """Return the mount (4, 4) of a target in its MCS body, as estimated or as configured."""
        estimate = self.calibration["targets"].get(target)
        if estimate and not use_config:
            return np.array(estimate["T_body_target"]["matrix"])
        config = self.options["targets"][target].get("T_body_target")
        return pose_from_config(config) if config else np.eye(4)


def shown_pose(poses: dict[str, np.ndarray | None]) -> np.ndarray:
    """Return the result of ReportRun.T_sensor_target, or the initial guess without a result."""
    pose = poses["result"] if poses["result"] is not None else poses["guess"]
    if pose is None:
        raise ValueError("a view has neither a result nor an initial guess")
    return pose


def _split_by_sensor(residuals: Columns) -> dict[str, dict[str, Columns]]:
    """Split residuals by sensor and kind, both in order of name."""
    out = {}
    sensors = np.asarray(residuals["sensor"])
    for sensor in np.unique(sensors).tolist():
        rows = select_rows(residuals, sensors == sensor)
        out[sensor] = {
            kind: select_rows(rows, rows["kind"] == kind)
            for kind in np.unique(rows["kind"]).tolist()
        }
    return out
