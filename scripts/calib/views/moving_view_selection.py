"""Which views of targets in motion a sensor keeps."""

import numpy as np

from calib.geometry.se3 import invert_pose
from calib.geometry.units import NS_PER_S
from calib.mocap.moving_pose_fit import fit_local_motion
from calib.views.frame_selection import space_evenly

MAX_CHECKED_VIEWS = 400  # views of one target at most that are looked at more closely
MIN_SPEED_MPS, MAX_SPEED_MPS = (
    0.05,
    1.5,
)  # of a target's middle against the robot; slower tells no time, and
MAX_TURN_RATE_DPS = 90.0  # faster blurs
TURN_ARM_M = 1.0  # at which turning counts like moving


def select_moving_views(
    cropper, target, trajectory, stamps_ns, T_body_target, guess, margin, options
):
    """[(row of stamps_ns (n,), T_sensor_target (4, 4), margin (6,))] of the views to keep, in order.

    cropper: of cropping.KINDS; trajectory: the Trajectory of T_robot_body; guess: guess.json.
    In view and neither too slow nor too fast; evenly spread over all of those. The margin grows by
    what the target moves while the sensor's clock may be off.
    """
    offset, T = guess["time_offset_s"], np.array(guess["T_robot_sensor"]["matrix"])
    found = []
    for i in space_evenly(len(stamps_ns), MAX_CHECKED_VIEWS):
        there = fit_local_motion(trajectory, int(stamps_ns[i]) + round(offset["value"] * NS_PER_S))
        if there is None or not _has_useful_speed(there.velocity):
            continue
        where = invert_pose(T) @ there.T_robot_body @ T_body_target
        wide = margin + offset["sigma"] * np.abs(there.velocity)
        if not cropper.check_visibility(cropper.model, target, where, wide, options):
            found.append((int(i), where, wide))
    return [found[i] for i in space_evenly(len(found), options["max_moving"])]


def _has_useful_speed(velocity):
    """Whether a twist (6,), per s, tells time and does not blur."""
    linear, angular = np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])
    fast = linear > MAX_SPEED_MPS or angular > np.radians(MAX_TURN_RATE_DPS)
    return not fast and linear + TURN_ARM_M * angular > MIN_SPEED_MPS
