"""Select and cut the views of one sensor in one session: the rows that the stage crop writes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from calib.mocap.body_trajectory import Trajectory
from calib.targets.target_shapes import TargetShape, target_from_config
from calib.views.field_of_view import PosedSensor
from calib.views.frame_selection import select_frames
from calib.views.moving_view_selection import select_moving_views
from calib.views.sensor_croppers import Cropper, FrameReader, TargetWindow, read_and_cut_frame
from calib.views.target_placements import (
    Columns,
    assign_frames_to_placements,
    compute_target_poses,
    mounts_from_guess,
    with_mocap_time,
)

ViewRow = dict[str, Any]


@dataclass(frozen=True)
class ViewCutter:
    """One sensor in one session, with what is needed to cut its views.

    sensor: at the initial guess, with its margin. mounts: T_body_target (4, 4) by target name;
    targets without one are not looked for. frames: columns of frames.parquet of this sensor with
    `mocap_time_ns`. read_frame: reads what the sensor measured in one of them. options: `crop`.
    """

    cropper: Cropper
    sensor: PosedSensor
    targets: dict[str, TargetShape]
    mounts: dict[str, np.ndarray]
    frames: Columns
    read_frame: FrameReader
    time_offset: dict[str, Any]
    options: dict[str, Any]

    @classmethod
    def from_guess(
        cls,
        cropper: Cropper,
        guess_json: Mapping[str, Any],
        frames: Columns,
        read_frame: FrameReader,
        options: Mapping[str, Any],
    ) -> "ViewCutter":
        """Make it from guess.json and the options of the stage crop."""
        mounts = mounts_from_guess(options["targets"], guess_json)
        sensor = PosedSensor(
            model=cropper.model,
            check_visibility=cropper.check_visibility,
            T_robot_sensor=np.array(guess_json["T_robot_sensor"]["matrix"]),
            margin=options["crop"]["margin_sigma"] * np.array(guess_json["sigma"]),
        )
        return cls(
            cropper=cropper,
            sensor=sensor,
            targets={name: target_from_config(options["targets"][name]) for name in mounts},
            mounts=mounts,
            frames=with_mocap_time(frames, guess_json["time_offset_s"]["value"]),
            read_frame=read_frame,
            time_offset=guess_json["time_offset_s"],
            options=options["crop"],
        )

    def cut_still_views(self, placements: Columns) -> list[ViewRow]:
        """Return a row of views.parquet for every frame and target, kept or with its reason.

        placements: columns of placements.parquet. Each frame is read at most once.
        """
        T_robot_target = compute_target_poses(placements, self.mounts)
        T_sensor_target = self.sensor.T_sensor_target(T_robot_target)
        selected = {}
        for name, target in sorted(self.targets.items()):
            numbers = assign_frames_to_placements(self.frames, placements, name)
            reasons = select_frames(self.sensor, target, numbers, T_robot_target, self.options)
            selected[name] = numbers, reasons
        rows = []
        for i in range(len(self.frames["stamp_ns"])):
            read_once = cache(self.read_frame)
            for name, (numbers, reasons) in selected.items():
                number, reason, payload = numbers[i], reasons[i], self.cropper.empty_payload()
                if not reason:
                    window = TargetWindow(
                        target=self.targets[name],
                        T_sensor_target=T_sensor_target[number],
                        margin=self.sensor.margin,
                        time_ns=self.frames["mocap_time_ns"][i],
                        span_ns=(placements["start_ns"][number], placements["end_ns"][number]),
                    )
                    payload, reason = read_and_cut_frame(self.cropper, read_once, i, window)
                rows.append(self._make_row(i, name, number, reason) | payload)
        return rows

    def cut_moving_views(self, trajectories: Mapping[str, Trajectory]) -> list[ViewRow]:
        """Return rows of moving_views.parquet; trajectories: of T_robot_body by target name."""
        rows: list[ViewRow] = []
        for name, trajectory in trajectories.items():
            views = select_moving_views(
                self.sensor,
                self.targets[name],
                trajectory,
                self.mounts[name],
                self.frames["stamp_ns"],
                time_offset=self.time_offset,
                options=self.options,
            )
            for view in views:
                window = TargetWindow(
                    target=self.targets[name],
                    T_sensor_target=view.T_sensor_target,
                    margin=view.margin,
                    time_ns=self.frames["stamp_ns"][view.frame],
                )
                payload, reason = read_and_cut_frame(
                    self.cropper, self.read_frame, view.frame, window
                )
                rows.append(self._make_row(view.frame, name, len(rows), reason) | payload)
        return rows

    def _make_row(self, frame: int, target_name: str, placement: int, reason: str) -> ViewRow:
        """Return the columns that all kinds of sensor have."""
        return {
            "stamp_ns": self.frames["stamp_ns"][frame],
            "target": target_name,
            "placement": placement,
            "kept": not reason,
            "reason": reason,
        }


def view_columns(rows: list[ViewRow], column_names: list[str]) -> dict[str, Any]:
    """Return the columns of a table of views, numbered in column `view`."""
    columns: dict[str, Any] = {k: [row[k] for row in rows] for k in column_names if k != "view"}
    return columns | {"view": np.arange(len(rows))}
