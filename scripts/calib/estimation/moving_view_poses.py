"""Placements and groups of keypoints of targets in motion."""

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement
from calib.geometry.units import NS_PER_S
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_sigma_from_config
from calib.mocap.moving_pose_fit import MovingView, fit_local_motion
from calib.views.pose_selection import space_evenly

MAX_KEYPOINTS_PER_VIEW = (
    400  # of a view: more tell no better where it is between two samples of the MCS
)
MOVING_VIEW_KINDS = (
    "pattern_corner",
    "cylinder_limb",
    "target_surface",
)  # of keypoints that are used


def make_moving_placement(
    session,
    target,
    sensor,
    time_ns,
    trajectory,
    T_body_target,
    mocap_noise,
    separate_trajectories=None,
):
    """The given.Placement of a view of a target in motion at t, ns, on the clock of the MCS; None
    where that has a gap. mocap_noise: block with pose_sigma and pose_bias_sigma; separate_trajectories: as that of
    motion.Moving."""
    there = fit_local_motion(trajectory, time_ns)
    if there is None:
        return None
    white, bias = (
        pose_sigma_from_config(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma")
    )
    # What the MCS errs by beside noise is neither the same in all places nor new in each: once over
    # for all views, so that many tell of poses no more than one placement, and once for each.
    seen = MovingView(
        sensor,
        time_ns,
        trajectory,
        np.hypot(there.sigma_factor * white, bias),
        separate_trajectories,
    )
    return Placement(session, target, there.T_robot_body, T_body_target, bias, moving_view=seen)


def build_moving_groups(
    keypoints,
    session,
    sensor,
    offset_s,
    trajectories,
    separate_trajectories,
    T_body_target,
    mocap_noise,
    first_index,
):
    """([Placement], [Group]) of the keypoints of a sensor's views in motion, numbered from first;
    separate_trajectories: as `apart` gives them.

    Stamps are taken to the clock of the MCS by an offset, s, a first guess; each view's time is the
    mean of its keypoints'. T_body_target (4, 4) by target.
    """
    places, groups, late = [], [], round(offset_s * NS_PER_S)
    for view in sorted(set(keypoints["view"].tolist())):
        rows = np.flatnonzero(
            (keypoints["view"] == view) & np.isin(keypoints["kind"], MOVING_VIEW_KINDS)
        )
        if len(rows) == 0:
            continue
        columns = select_rows(keypoints, rows[space_evenly(len(rows), MAX_KEYPOINTS_PER_VIEW)])
        target, kind = str(columns["target"][0]), str(columns["kind"][0])
        columns = columns | {"stamp_ns": columns["stamp_ns"] + late}
        t = int(columns["stamp_ns"][0]) + int(np.mean(columns["stamp_ns"] - columns["stamp_ns"][0]))
        known = T_body_target[target], mocap_noise, separate_trajectories.get(target)
        place = make_moving_placement(session, target, sensor, t, trajectories[target], *known)
        if place is not None:
            groups.append(
                MeasurementGroup(sensor, first_index + len(places), kind, columns, is_moving=True)
            )
            places.append(place)
    return places, groups
