"""What one sensor may see of one target, by the rules of crop and extract."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.mocap.body_trajectory import Trajectory
from calib.targets.target_shapes import TargetShape
from calib.views.field_of_view import PosedSensor, check_camera_can_find
from calib.views.frame_selection import select_crop_placements
from calib.views.moving_view_selection import select_moving_views
from calib.views.placement_selection import ENOUGH_PLACEMENTS, NOT_NEW, select_placements

NO_FRAME_REASON = "no message of the sensor during the placement"


@dataclass(frozen=True)
class TargetVisibility:
    """What one sensor may see of one target.

    T_robot_target: (n, 4, 4) of every placement. expected_reasons, possible_reasons: (n,) why a
    placement is not in view from the stated sensor pose, and from every pose within its
    uncertainty; "" if it is. n_moving_views: views in motion that constrain the time offset.
    has_known_pose: whether the poses of sensor and target are stated. If not, all is in view.
    """

    shape: TargetShape
    T_robot_target: np.ndarray
    expected_reasons: tuple[str, ...]
    possible_reasons: tuple[str, ...]
    n_moving_views: int
    has_known_pose: bool

    def count_lost_placements(self) -> dict[str, int]:
        """Return {reason: placements} of those that are certainly not in view."""
        return dict(Counter(reason for reason in self.possible_reasons if reason).most_common())


def unknown_pose(kind: str) -> PosedSensor:
    """Return a sensor whose pose is not stated: all that it can find at all may be in its view."""
    can_find = {"camera": check_camera_can_find, "lidar": lambda target: ""}[kind]
    return PosedSensor(
        model=None,
        check_visibility=lambda model, target, T, margin, options, /: can_find(target),
        T_robot_sensor=np.eye(4),
        margin=np.zeros(6),
    )


@dataclass(frozen=True)
class StillTarget:
    """A target at rest in one session.

    rows: (n,) of its placements. placement_by_frame: (m,) row of each frame of the sensor, or -1.
    T_robot_target: (k, 4, 4) of all placements. options: block `crop`.
    """

    shape: TargetShape
    rows: np.ndarray
    placement_by_frame: np.ndarray
    T_robot_target: np.ndarray
    options: dict[str, Any]

    def visibility(
        self, sensor: PosedSensor, has_known_pose: bool, lost_reason: str
    ) -> TargetVisibility:
        """Return what a sensor may see, by the rules of crop (possible) and extract (expected).

        lost_reason: why the target is not looked for at all.
        """
        crop = select_crop_placements(
            sensor, self.shape, self.placement_by_frame, self.T_robot_target, self.options
        )
        kept = [k for k, reason in crop.items() if not reason]
        n_max = self.options["max_placements"]
        exact = replace(sensor, margin=np.zeros(6))
        expected = crop | select_placements(
            exact, self.shape, self.T_robot_target, kept, self.options, n_max=n_max
        )
        possible = crop | dict.fromkeys(kept[n_max:], ENOUGH_PLACEMENTS)
        return TargetVisibility(
            shape=self.shape,
            T_robot_target=self.T_robot_target[self.rows],
            expected_reasons=self._list_reasons(expected, lost_reason),
            possible_reasons=self._list_reasons(possible, lost_reason),
            n_moving_views=0,
            has_known_pose=has_known_pose,
        )

    def _list_reasons(self, against: dict[int, str], lost_reason: str) -> tuple[str, ...]:
        """Return the reason against each of the rows (n,); "" for those that are used."""
        with_frames = set(self.placement_by_frame.tolist())
        return tuple(
            lost_reason or (against.get(int(k), NOT_NEW) if k in with_frames else NO_FRAME_REASON)
            for k in self.rows
        )


@dataclass(frozen=True)
class MovingTarget:
    """A target in motion in one session. options: block `crop`."""

    shape: TargetShape
    trajectory: Trajectory
    T_body_target: np.ndarray
    options: dict[str, Any]

    def count_views(
        self, sensor: PosedSensor, stamps_ns: np.ndarray, sensor_config: dict[str, Any]
    ) -> int:
        """Return how many views crop would read. stamps_ns: (n,) of the sensor's frames."""
        time_offset = {
            "value": sensor_config["time_offset_s"],
            "sigma": sensor_config["time_offset_sigma_s"],
        }
        views = select_moving_views(
            sensor,
            self.shape,
            self.trajectory,
            self.T_body_target,
            stamps_ns,
            time_offset=time_offset,
            options=self.options,
        )
        return len(views)
