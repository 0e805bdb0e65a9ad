"""Which views of targets in motion a sensor keeps."""

import numpy as np

from calib.geometry import se3
from calib.mocap import moving_pose_fit
from calib.mocap.body_trajectory import NS
from calib.views import frame_selection

CONSIDERED = 400  # views of one target at most that are looked at more closely
LEAST_MPS, MOST_MPS = 0.05, 1.5  # of a target's middle against the robot; slower tells no time, and
MOST_DPS = 90.0  # faster blurs
ARM_M = 1.0  # at which turning counts like moving


def choose(sensor, target, path, stamps, T_body_target, guess, margin, options):
    """[(row of stamps (n,), T_sensor_target (4, 4), margin (6,))] of the views to keep, in order.

    sensor: of cropping.KINDS; path: the Trajectory of T_robot_body; guess: guess.json.
    In view and neither too slow nor too fast; evenly spread over all of those. The margin grows by
    what the target moves while the sensor's clock may be off.
    """
    offset, T = guess["time_offset_s"], np.array(guess["T_robot_sensor"]["matrix"])
    found = []
    for i in frame_selection.evenly(len(stamps), CONSIDERED):
        there = moving_pose_fit.fit(path, int(stamps[i]) + round(offset["value"] * NS))
        if there is None or not _of_use(there.velocity):
            continue
        where = se3.inverse(T) @ there.T @ T_body_target
        wide = margin + offset["sigma"] * np.abs(there.velocity)
        if not sensor.hidden(sensor.model, target, where, wide, options):
            found.append((int(i), where, wide))
    return [found[i] for i in frame_selection.evenly(len(found), options["max_moving"])]


def _of_use(velocity):
    """Whether a twist (6,), per s, tells time and does not blur."""
    linear, angular = np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])
    fast = linear > MOST_MPS or angular > np.radians(MOST_DPS)
    return not fast and linear + ARM_M * angular > LEAST_MPS
