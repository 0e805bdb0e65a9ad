"""The inputs of the report as plain data."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calib.geometry.se3 import invert_pose, pose_from_xyz_quat
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_from_config
from calib.io.status import Status
from calib.io.table_schemas import CAMERA_VIEWS_SCHEMA, LIDAR_VIEWS_SCHEMA

VIEW_SCHEMAS = {"camera": CAMERA_VIEWS_SCHEMA, "lidar": LIDAR_VIEWS_SCHEMA}
# Of a view; its payload may not fit in memory.
COLUMNS_WITHOUT_PAYLOAD = ("view", "stamp_ns", "target", "placement", "kept", "reason")


@dataclass(frozen=True)
class ReportStream:
    """One sensor in one session: guess, views but their payload, keypoints, outcome per view."""

    sensor: str
    guess: dict
    views: dict
    views_status: Status
    keypoints: dict
    keypoints_status: Status
    status_by_view: dict
    views_path: Path


@dataclass(frozen=True)
class ReportSession:
    """One recording: audit, columns of its frames, placements, their status and the targets',
    streams by sensor."""

    audit: dict
    frames: dict
    placements: dict
    placements_status: Status
    status_by_target: dict
    streams: dict


@dataclass(frozen=True)
class ReportRun:
    """All of one rig; residuals of targets that are still, those of targets in motion, and
    iterations as columns, sessions by name."""

    options: dict
    calibration: dict
    verdict: dict
    residuals: dict
    moving_residuals: dict
    iterations: dict
    sessions: dict

    @cached_property
    def residuals_by_sensor(self):
        """{sensor: {kind: columns}} of the residuals, both in order of name."""
        return _split_by_sensor(self.residuals)

    @cached_property
    def moving_residuals_by_sensor(self):
        """{sensor: {kind: columns}} of the residuals in motion."""
        return _split_by_sensor(self.moving_residuals)

    @cached_property
    def used_views_by_stream(self):
        """{(session, sensor): numbers of the views that have a member in the solve}."""
        out = {}
        for sensor, kinds in self.residuals_by_sensor.items():
            for c in kinds.values():
                member = np.asarray(c["weight"]) > 0
                for session in np.unique(c["session"][member]).tolist():
                    views = c["view"][member & (c["session"] == session)]
                    out.setdefault((session, sensor), set()).update(np.unique(views).tolist())
        return out

    @property
    def sensors(self):
        """Content of calibration.json by sensor, in order of name."""
        return dict(sorted(self.calibration["sensors"].items()))

    def T_robot_sensor(self, sensor):
        """The estimate (4, 4), or None."""
        T = self.sensors[sensor]["T_robot_sensor"] if sensor in self.sensors else None
        return None if T is None else np.array(T["matrix"])

    def T_robot_sensor_true(self, sensor):
        """The true T_robot_sensor (4, 4) where it was given, or None."""
        known = self.options.get("truth", {})
        return pose_from_config(known[sensor]) if sensor in known else None

    @property
    def unknown_truth_sensors(self):
        """Names of sensors of which a truth was given and that the calibration does not know."""
        return sorted(set(self.options.get("truth", {})) - set(self.sensors))

    def T_robot_target(self, session, placement, use_config=False):
        """Mean pose (4, 4) of a placement's target; its mount as estimated, or as configured."""
        p = self.sessions[session].placements
        row = np.flatnonzero(np.asarray(p["placement"]) == placement)[0]
        T_robot_body = pose_from_xyz_quat(p["xyz"][row], p["quat"][row])
        return T_robot_body @ self.T_body_target(str(p["target"][row]), use_config)

    def T_sensor_target(self, sensor, session, placement):
        """{"guess", "solved", "truth": (4, 4) or None}: a target by each pose of the sensor."""
        guess = self.sessions[session].streams[sensor].guess["T_robot_sensor"]
        T_guess = None if guess is None else np.array(guess["matrix"])
        poses = {"guess": T_guess, "solved": self.T_robot_sensor(sensor)}
        out = {}
        for name, T in (poses | {"truth": self.T_robot_sensor_true(sensor)}).items():
            T_robot_target = self.T_robot_target(session, placement, use_config=name == "guess")
            out[name] = None if T is None else invert_pose(T) @ T_robot_target
        return out

    def T_body_target(self, target, use_config=False):
        """Where a target sits in its MCS body (4, 4)."""
        estimate = self.calibration["targets"].get(target)
        if estimate and not use_config:
            return np.array(estimate["T_body_target"]["matrix"])
        config = self.options["targets"][target].get("T_body_target")
        return pose_from_config(config) if config else np.eye(4)


def _split_by_sensor(columns):
    """{sensor: {kind: columns}} of columns of residuals, both in order of name."""
    out = {}
    names = np.asarray(columns["sensor"])
    for sensor in np.unique(names).tolist():
        rows = select_rows(columns, names == sensor)
        kinds = {k: rows["kind"] == k for k in np.unique(rows["kind"]).tolist()}
        out[sensor] = {k: select_rows(rows, here) for k, here in kinds.items()}
    return out
