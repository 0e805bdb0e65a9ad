"""Returns on a target's surface and crossings of its outline, or the paper's keypoints."""

import numpy as np
from scipy.spatial import cKDTree

from calib import crossings, finding, geometry, registration, tables
from calib import views as windows
from calib.extraction.job import LOOSE, columns_of, working_pose
from calib.status import OK, failed

SUPERSET_M = 0.1  # returns this near to the target's surface are handed on; solve decides
ROUNDS = 2
FIT_M = 0.03  # a scan point farther than this from the template that ICP laid on it spoils the view


def extract(job, views):
    """Keypoints of a lidar's views (calib.extraction)."""
    found, fixed, first, outcomes = [], [], [], []
    for i in np.flatnonzero(views["kept"]):
        points = _points(views, i)
        target, where = job.targets[views["target"][i]], job.expected(int(views["placement"][i]))
        rows, status = finding.find(target, points, where, job.margin, job.model, job.options)
        if status.ok and target.points:
            part, status = by_template(job, views, i, points, rows)
            fixed += [part] if status.ok else []
        elif status.ok:
            found.append(i)
            first.append(surface_columns(job, views, i, points, rows))
        outcomes.append((int(views["view"][i]), status))
    if not first + fixed:
        return tables.empty(tables.KEYPOINTS), outcomes, None
    keypoints = tables.concatenate(first + fixed, tables.KEYPOINTS)
    distance = np.linalg.norm(keypoints["xyz"], axis=1).mean()
    wide = windows.spread(job.margin, distance) * distance / keypoints["sigma"].min()
    T = working_pose(job, keypoints, job.T_robot_sensor, job.associate | LOOSE, wide)
    for _ in range(ROUNDS if found else 0):
        parts = [p for i in found for p in around(job, views, i, T, found)]
        keypoints = tables.concatenate(parts + fixed, tables.KEYPOINTS)
        if not parts + fixed:
            return keypoints, outcomes, None
        T = working_pose(job, keypoints, T, job.associate, 3.0)
    return keypoints, outcomes, T


def _points(views, i):
    return np.asarray(views["xyz"][i], float).reshape(-1, 3)


def by_template(job, views, i, points, rows):
    """(keypoint columns, status) of the paper's methods from the returns (rows of points (n, 3)) of
    one view: corners of the template that ICP laid on them, or all returns near it."""
    target = job.targets[views["target"][i]]
    measured, template = points[rows], target.points
    T = registration.icp(template, measured, job.expected(int(views["placement"][i])))
    away = cKDTree(geometry.transform(T, template.template)).query(measured)[0]
    sigma = np.hypot(job.model.range_sigma, template.spacing)
    if template.keypoints == "corners":
        if away.max() > FIT_M:
            found = f"a return {away.max():.3f} m from the template that ICP laid on them"
            return None, failed("returns do not fit the template", found, f"at most {FIT_M} m")
        corners = geometry.transform(T, target.outline_points())
        return columns_of(views, i, "vertex", range(len(corners)), xyz=corners, sigma=sigma), OK
    near = away < registration.FARTHEST_M["all"]
    if near.sum() < job.options["min_points"]:
        least = job.options["min_points"]
        return None, failed("too few returns near the template", int(near.sum()), least)
    columns = surface_columns(job, views, i, points, rows[near])
    return columns | {"kind": np.full(near.sum(), "point"), "sigma": np.full(near.sum(), sigma)}, OK


def surface_columns(job, views, i, points, rows):
    """Returns (rows of points (n, 3)) of a view as surface keypoints with their own stamps."""
    dt, ring = np.asarray(views["dt"][i])[rows], np.asarray(views["ring"][i])[rows]
    sigma = job.model.range_sigma
    return columns_of(views, i, "surface", ring, xyz=points[rows], sigma=sigma, dt=dt)


def around(job, views, i, T_robot_sensor, found):
    """Keypoint columns of one view: returns near the surface, and crossings of the outline."""
    target, placement = job.targets[views["target"][i]], int(views["placement"][i])
    points = _points(views, i)
    where = job.expected(placement, T_robot_sensor)
    q = geometry.transform(geometry.inverse(where), points)
    near = np.abs(target.distance(*q.T)) < SUPERSET_M
    rows = np.flatnonzero(near & (target.depth(q) > -SUPERSET_M))
    parts = [surface_columns(job, views, i, points, rows)]
    if len(target.edges()):
        gate = 4 * job.model.range_sigma
        ring = np.asarray(views["ring"][i])
        rays, rings = crossings.crossings(target, where, points, ring, job.model, gate)
        # The scans of a placement repeat its crossings: together they count as one.
        repeated = sum(views["placement"][k] == placement for k in found)
        sigma = job.model.azimuth_step / np.sqrt(12) * np.sqrt(repeated)
        parts.append(columns_of(views, i, "edge", rings, xyz=rays, sigma=sigma))
    return [p for p in parts if len(p["view"])]
