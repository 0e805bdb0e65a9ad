"""The inputs of the report as plain data."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calib.geometry import se3
from calib.io import parquet_tables, pose_block, table_schemas
from calib.io.status import Status

VIEWS = {"camera": table_schemas.VIEWS_CAMERA, "lidar": table_schemas.VIEWS_LIDAR}
# Of a view; its payload may not fit in memory.
LIGHT = ("view", "t", "target", "placement", "kept", "reason")


@dataclass(frozen=True)
class Stream:
    """One sensor in one session: guess, views but their payload, keypoints, outcome per view."""

    sensor: str
    guess: dict
    views: dict
    seen: Status
    keypoints: dict
    found: Status
    outcomes: dict
    path: Path


@dataclass(frozen=True)
class Session:
    """One recording: audit, columns of its frames, placements, their status and the targets',
    streams by sensor."""

    audit: dict
    frames: dict
    placements: dict
    status: Status
    targets: dict
    streams: dict


@dataclass(frozen=True)
class Run:
    """All of one rig; residuals of targets that are still, those of targets in motion, and
    iterations as columns, sessions by name."""

    options: dict
    calibration: dict
    verdict: dict
    residuals: dict
    in_motion: dict
    iterations: dict
    sessions: dict

    @cached_property
    def by_sensor(self):
        """{sensor: {kind: columns}} of the residuals, both in order of name."""
        return _by_sensor(self.residuals)

    @cached_property
    def moving_by_sensor(self):
        """{sensor: {kind: columns}} of the residuals in motion."""
        return _by_sensor(self.in_motion)

    @cached_property
    def used_views(self):
        """{(session, sensor): numbers of the views that have a member in the solve}."""
        out = {}
        for sensor, kinds in self.by_sensor.items():
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

    def truth(self, sensor):
        """The true T_robot_sensor (4, 4) where it was given, or None."""
        known = self.options.get("truth", {})
        return pose_block.pose(known[sensor]) if sensor in known else None

    @property
    def strangers(self):
        """Names of sensors of which a truth was given and that the calibration does not know."""
        return sorted(set(self.options.get("truth", {})) - set(self.sensors))

    def T_robot_target(self, session, placement, configured=False):
        """Mean pose (4, 4) of a placement's target; its mount as estimated, or as configured."""
        p = self.sessions[session].placements
        row = np.flatnonzero(np.asarray(p["placement"]) == placement)[0]
        T_robot_body = se3.from_xyz_quat(p["xyz"][row], p["quat"][row])
        return T_robot_body @ self.T_body_target(str(p["target"][row]), configured)

    def T_sensor_target(self, sensor, session, placement):
        """{"guess", "solved", "truth": (4, 4) or None}: a target by each pose of the sensor."""
        guess = self.sessions[session].streams[sensor].guess["T_robot_sensor"]
        T_guess = None if guess is None else np.array(guess["matrix"])
        poses = {"guess": T_guess, "solved": self.T_robot_sensor(sensor)}
        out = {}
        for name, T in (poses | {"truth": self.truth(sensor)}).items():
            T_robot_target = self.T_robot_target(session, placement, configured=name == "guess")
            out[name] = None if T is None else se3.inverse(T) @ T_robot_target
        return out

    def T_body_target(self, target, configured=False):
        """Where a target sits in its MCS body (4, 4)."""
        estimate = self.calibration["targets"].get(target)
        if estimate and not configured:
            return np.array(estimate["T_body_target"]["matrix"])
        config = self.options["targets"][target].get("T_body_target")
        return pose_block.pose(config) if config else np.eye(4)


def _by_sensor(columns):
    """{sensor: {kind: columns}} of columns of residuals, both in order of name."""
    out = {}
    names = np.asarray(columns["sensor"])
    for sensor in np.unique(names).tolist():
        rows = parquet_tables.select(columns, names == sensor)
        kinds = {k: rows["kind"] == k for k in np.unique(rows["kind"]).tolist()}
        out[sensor] = {k: parquet_tables.select(rows, here) for k, here in kinds.items()}
    return out
