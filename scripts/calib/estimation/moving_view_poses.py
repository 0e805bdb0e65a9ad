"""Placements and groups of keypoints of targets in motion."""

import numpy as np

from calib.estimation import estimation_problem
from calib.io import parquet_tables, pose_block
from calib.mocap import moving_pose_fit
from calib.mocap.body_trajectory import NS
from calib.views import frame_selection

MOST_POINTS = 400  # of a view: more tell no better where it is between two samples of the MCS
KIND = ("corner", "limb", "surface")  # of keypoints that are used


def placement(session, target, sensor, t, path, T_body_target, mocap_noise, apart=None):
    """The given.Placement of a view of a target in motion at t, ns, on the clock of the MCS; None
    where that has a gap. mocap_noise: block with pose_sigma and pose_bias_sigma; apart: as that of
    motion.Moving."""
    there = moving_pose_fit.fit(path, t)
    if there is None:
        return None
    white, bias = (pose_block.pose_sigma(mocap_noise[k]) for k in ("pose_sigma", "pose_bias_sigma"))
    # What the MCS errs by beside noise is neither the same in all places nor new in each: once over
    # for all views, so that many tell of poses no more than one placement, and once for each.
    seen = moving_pose_fit.Moving(sensor, t, path, np.hypot(there.factor * white, bias), apart)
    return estimation_problem.Placement(session, target, there.T, T_body_target, bias, moving=seen)


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
        columns = parquet_tables.select(
            keypoints, rows[frame_selection.evenly(len(rows), MOST_POINTS)]
        )
        target, kind = str(columns["target"][0]), str(columns["kind"][0])
        columns = columns | {"t": columns["t"] + late}
        t = int(columns["t"][0]) + int(np.mean(columns["t"] - columns["t"][0]))
        known = T_body_target[target], mocap_noise, streams.get(target)
        place = placement(session, target, sensor, t, paths[target], *known)
        if place is not None:
            groups.append(
                estimation_problem.Group(sensor, first + len(places), kind, columns, moving=True)
            )
            places.append(place)
    return places, groups
