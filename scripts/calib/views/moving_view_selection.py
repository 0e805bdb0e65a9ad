"""Select the views of moving targets that a sensor keeps."""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.mocap.body_trajectory import Trajectory
from calib.mocap.moving_pose_fit import fit_local_motion
from calib.targets.target_shapes import TargetShape
from calib.views.field_of_view import PosedSensor
from calib.views.pose_selection import space_evenly

MAX_CHECKED_VIEWS = 400  # of one target, spread over the recording
# Speed of a target relative to the robot. Slower motion does not constrain the time offset, faster
# motion blurs.
MIN_SPEED_MPS = 0.05
MAX_SPEED_MPS = 1.5
MAX_TURN_RATE_DPS = 90.0
TURN_ARM_M = 1.0  # converts a turn rate to a speed


class MovingTargetView(NamedTuple):
    """A view to keep: its frame (row), T_sensor_target (4, 4), and margin (6,), m and rad."""

    frame: int
    T_sensor_target: np.ndarray
    margin: np.ndarray


def select_moving_views(
    sensor: PosedSensor,
    target: TargetShape,
    trajectory: Trajectory,
    T_body_target: np.ndarray,
    stamps_ns: np.ndarray,
    *,
    time_offset: dict[str, Any],
    options: dict[str, Any],
) -> list[MovingTargetView]:
    """Return the views of one moving target to keep, in order of time.

    trajectory: of T_robot_body. stamps_ns: (n,) of the sensor's frames. time_offset: value and
    sigma, s. options: block `crop`.

    The kept views are in view, neither too slow nor too fast, and evenly spread. The margin grows
    by the distance that the target moves within the σ of the time offset.
    """
    visible = []
    for i in space_evenly(len(stamps_ns), MAX_CHECKED_VIEWS):
        time_ns = int(stamps_ns[i]) + round(time_offset["value"] * NS_PER_S)
        motion = fit_local_motion(trajectory, time_ns)
        if motion is None or not _has_useful_speed(motion.velocity):
            continue
        T = sensor.T_sensor_target(motion.T_robot_body) @ T_body_target
        margin = sensor.margin + time_offset["sigma"] * np.abs(motion.velocity)
        if not sensor.check_visibility(sensor.model, target, T, margin, options):
            visible.append(MovingTargetView(int(i), T, margin))
    return [visible[i] for i in space_evenly(len(visible), options["max_moving_views"])]


def _has_useful_speed(velocity: np.ndarray) -> bool:
    """Return whether a twist (6,), per s, constrains the time offset and does not blur."""
    linear, angular = np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])
    is_too_fast = linear > MAX_SPEED_MPS or angular > np.radians(MAX_TURN_RATE_DPS)
    return bool(not is_too_fast and linear + TURN_ARM_M * angular > MIN_SPEED_MPS)
