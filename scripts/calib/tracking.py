"""Targets in motion: which views of them a sensor keeps, and where each target is then."""

import numpy as np

from calib import geometry, given, mocap, motion, rig, tables, views
from calib.mocap import NS

CONSIDERED = 400  # views of one target at most that are looked at more closely
LEAST_MPS, MOST_MPS = 0.05, 1.5  # of a target's middle against the robot; slower tells no time, and
MOST_DPS = 90.0  # faster blurs
ARM_M = 1.0  # at which turning counts like moving
MOST_POINTS = 400  # of a view: more tell no better where it is between two samples of the MCS
KIND = ("corner", "limb", "surface")  # of keypoints that are used


def trajectories(columns, body, bodies, max_gap_s):
    """{target: Trajectory of T_robot_body} from the columns of mocap.parquet; bodies: target -> its
    MCS body."""
    robot = mocap.trajectory(columns, body, max_gap_s)
    return {
        target: mocap.relative(robot, mocap.trajectory(columns, name, max_gap_s))
        for target, name in sorted(bodies.items())
    }


def apart(columns, body, bodies, topics, max_gap_s):
    """{target: Trajectories of robot and body in the map} of those whose poses come by other topics
    than the robot's; topics: {body: its topics}."""
    own = set(topics.get(body, ()))
    others = {t: n for t, n in sorted(bodies.items()) if own and topics.get(n)}
    others = {t: n for t, n in others.items() if not own & set(topics[n])}
    if not others:
        return {}
    robot = mocap.trajectory(columns, body, max_gap_s)
    return {t: (robot, mocap.trajectory(columns, n, max_gap_s)) for t, n in others.items()}


def choose(sensor, target, path, stamps, T_body_target, guess, margin, options):
    """[(row of stamps (n,), T_sensor_target (4, 4), margin (6,))] of the views to keep, in order.

    sensor: of cropping.KINDS; path: the Trajectory of T_robot_body; guess: guess.json.
    In view and neither too slow nor too fast; evenly spread over all of those. The margin grows by
    what the target moves while the sensor's clock may be off.
    """
    offset, T = guess["time_offset_s"], np.array(guess["T_robot_sensor"]["matrix"])
    found = []
    for i in views.evenly(len(stamps), CONSIDERED):
        there = motion.fit(path, int(stamps[i]) + round(offset["value"] * NS))
        if there is None or not _of_use(there.velocity):
            continue
        where = geometry.inverse(T) @ there.T @ T_body_target
        wide = margin + offset["sigma"] * np.abs(there.velocity)
        if not sensor.hidden(sensor.model, target, where, wide, options):
            found.append((int(i), where, wide))
    return [found[i] for i in views.evenly(len(found), options["max_moving"])]


def _of_use(velocity):
    """Whether a twist (6,), per s, tells time and does not blur."""
    linear, angular = np.linalg.norm(velocity[:3]), np.linalg.norm(velocity[3:])
    fast = linear > MOST_MPS or angular > np.radians(MOST_DPS)
    return not fast and linear + ARM_M * angular > LEAST_MPS


def placement(session, target, sensor, t, path, T_body_target, mocap_noise, apart=None):
    """The given.Placement of a view of a target in motion at t, ns, on the clock of the MCS; None
    where that has a gap. mocap_noise: block with pose_sigma and pose_bias_sigma; apart: as that of
    motion.Moving."""
    there = motion.fit(path, t)
    if there is None:
        return None
    white, bias = (rig.pose_sigma(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma"))
    # What the MCS errs by beside noise is neither the same in all places nor new in each: once over
    # for all views, so that many tell of poses no more than one placement, and once for each.
    seen = motion.Moving(sensor, t, path, np.hypot(there.factor * white, bias), apart)
    return given.Placement(session, target, there.T, T_body_target, bias, moving=seen)


def seen(keypoints, session, sensor, offset, paths, streams, T_body_target, mocap_noise, first):
    """([Placement], [Group]) of the keypoints of a sensor's views in motion, numbered from first;
    streams: as `apart` gives them.

    Stamps are taken to the clock of the MCS by an offset, s, a first guess; each view's time is the
    mean of its keypoints'. T_body_target (4, 4) by target.
    """
    places, groups, late = [], [], round(offset * NS)
    for view in sorted(set(keypoints["view"].tolist())):
        rows = np.flatnonzero((keypoints["view"] == view) & np.isin(keypoints["kind"], KIND))
        if len(rows) == 0:
            continue
        columns = tables.select(keypoints, rows[views.evenly(len(rows), MOST_POINTS)])
        target, kind = str(columns["target"][0]), str(columns["kind"][0])
        columns = columns | {"t": columns["t"] + late}
        t = int(columns["t"][0]) + int(np.mean(columns["t"] - columns["t"][0]))
        known = T_body_target[target], mocap_noise, streams.get(target)
        place = placement(session, target, sensor, t, paths[target], *known)
        if place is not None:
            groups.append(given.Group(sensor, first + len(places), kind, columns, moving=True))
            places.append(place)
    return places, groups
