"""Still placements of the targets in one session, their poses, and the frames taken in them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry.se3 import pose_from_xyz_quat
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config
from calib.io.status import Status
from calib.io.table_schemas import PLACEMENTS_SCHEMA

# Up to this σ of the time offset, the ends that gate cuts off the placements are enough.
NO_TRIM_CLOCK_SIGMA_S = 0.05

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class PlacementTable:
    """placements.parquet of one session: its columns, its status and the status of each target.

    mocap_notes: on the noise of motion capture at rest.
    """

    columns: Columns
    status: Status
    target_status: dict[str, Status]
    mocap_notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> "PlacementTable":
        """Read the table that the stage gate writes."""
        columns, status, notes = read_table(path, PLACEMENTS_SCHEMA)
        statuses = {name: Status.from_dict(note) for name, note in sorted(notes["targets"].items())}
        return cls(columns, status, statuses, tuple(notes["mocap_notes"]))

    def still_target_status(self) -> Status:
        """Return ok if any target stands still in this session, else why the first one does not."""
        statuses = list(self.target_status.values())
        if not self.status.ok or any(status.ok for status in statuses):
            return self.status
        return statuses[0]


def find_still_rows(placements: Columns, target_name: str) -> np.ndarray:
    """Return the rows (k,) of the still placements of one target, in order of time."""
    return np.flatnonzero((placements["target"] == target_name) & (placements["kind"] == "still"))


def mounts_from_guess(
    targets: Mapping[str, dict[str, Any]], guess_json: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """Return T_body_target (4, 4) by target name, from the config blocks or as guess found it.

    Targets are missing if their mount is unknown and was not found.
    """
    stated = {
        name: pose_from_config(block["T_body_target"])
        for name, block in targets.items()
        if "mount" not in block
    }
    searched = {
        name: np.array(mount["T_body_target"]["matrix"])
        for name, mount in guess_json["mounts"].items()
    }
    return stated | searched


def compute_target_poses(placements: Columns, mounts: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return T_robot_target (n, 4, 4) of every placement.

    mounts: T_body_target (4, 4) by target name; the identity is used for other targets.
    """
    T_robot_body = pose_from_xyz_quat(placements["xyz"], placements["quat"])
    T_body_target = [mounts.get(name, np.eye(4)) for name in placements["target"]]
    return T_robot_body @ np.reshape(T_body_target, (-1, 4, 4))


def with_mocap_time(frames: Columns, offset_s: float) -> Columns:
    """Return columns of frames.parquet with `mocap_time_ns`: stamps on the clock of the MCS.

    offset_s: time offset of the sensor, s, added to its stamps.
    """
    return frames | {"mocap_time_ns": np.asarray(frames["stamp_ns"]) + round(offset_s * NS_PER_S)}


def trim_placement_ends(placements: Columns, clock_sigma_s: float) -> Columns:
    """Return the placements with both ends of the still ones moved inwards.

    They move by twice the σ of the time offset, s, beyond NO_TRIM_CLOCK_SIGMA_S, but by no more
    than a third of the placement.
    """
    length = np.asarray(placements["end_ns"]) - placements["start_ns"]
    inset = round(2 * max(0.0, clock_sigma_s - NO_TRIM_CLOCK_SIGMA_S) * NS_PER_S)
    inset_ns = np.where(placements["kind"] == "still", np.minimum(inset, length // 3), 0)
    return placements | {
        "start_ns": placements["start_ns"] + inset_ns,
        "end_ns": placements["end_ns"] - inset_ns,
    }


def assign_frames_to_placements(
    frames: Columns, placements: Columns, target_name: str
) -> np.ndarray:
    """Return for each frame the row (n,) of the still placement of a target it lies in, or -1.

    frames: with `mocap_time_ns` (with_mocap_time).
    """
    rows = find_still_rows(placements, target_name)
    if len(rows) == 0:
        return np.full(len(frames["mocap_time_ns"]), -1)
    start, end = placements["start_ns"][rows], placements["end_ns"][rows]
    last_started = np.searchsorted(start, frames["mocap_time_ns"], "right") - 1
    is_inside = (last_started >= 0) & (frames["mocap_time_ns"] <= end[last_started])
    return np.where(is_inside, rows[last_started], -1)
