"""Returns on a target's surface and crossings of its outline, or the paper's keypoints."""

import numpy as np
from scipy.spatial import cKDTree

from calib.extraction.extraction_inputs import columns_of
from calib.extraction.working_pose import LOOSE, in_view, settle, working_pose
from calib.geometry import icp, se3
from calib.initial_guess import lidar_candidates, lidar_matching
from calib.io import parquet_tables, table_schemas
from calib.io.status import OK, failed
from calib.sensors.lidar import outline_crossings, target_search
from calib.views import field_of_view

SUPERSET_M = 0.1  # returns this near to the target's surface are handed on; solve decides
ON_M = 0.05  # nearer returns, over the surface, are on the target: they show that it is there
COARSE_M = 0.05  # σ of what is found at first: of its centre, and
COARSE = COARSE_M, np.radians(3)  # of its direction
NOISE = 3.0  # times σ: what the working pose starts from
FIT_M = 0.03  # a scan point farther than this from the template that ICP laid on it spoils the view


def extract(job, views):
    """Keypoints of a lidar's views (calib.extraction.extractor_registry)."""
    found, outcomes = sought(job, views)
    parts = [surface_columns(job, views, i, _points(views, i), rows) for i, rows in found.items()]
    if not parts:
        return parquet_tables.empty(table_schemas.KEYPOINTS), outcomes, None
    keypoints = parquet_tables.concatenate(parts, table_schemas.KEYPOINTS)
    wide = COARSE_M / keypoints["sigma"].min()
    T = working_pose(job, keypoints, by_centres(job, views, found), job.associate | LOOSE, wide)
    laid = {
        i: by_template(job, views, i, _points(views, i), rows, T)
        for i, rows in found.items()
        if job.targets[views["target"][i]].points
    }
    return settle(job, lambda at: at_pose(job, views, at, laid, outcomes), T, NOISE)


def sought(job, views):
    """({row of views: returns on the target}, outcomes) of the kept views, from the guess.

    In one view of each placement, which shows where the sensor is; in all of a target that is
    compared by points.
    """
    found, outcomes, done = {}, [], set()
    for i in np.flatnonzero(views["kept"]):
        target, placement = job.targets[views["target"][i]], int(views["placement"][i])
        if placement in done:
            continue
        points, where = _points(views, i), job.expected(placement)
        rows, status = target_search.find(target, points, where, job.margin, job.model, job.options)
        if status.ok:
            found[i] = rows
            done |= set() if target.points else {placement}
        outcomes.append((int(views["view"][i]), status))
    return found, outcomes


def by_centres(job, views, found):
    """T_robot_sensor (4, 4) that lays centres and directions of what was found on the targets':
    from there the surfaces, which say little about shifts along them, lead to the right place."""
    shapes = {n: lidar_candidates.Form.of(t) for n, t in job.targets.items()}
    rows = []
    for number, (i, members) in enumerate(found.items()):
        place, name = job.places[int(views["placement"][i])], views["target"][i]
        seen = lidar_candidates.measured(
            job.targets[name], shapes[name], _points(views, i)[members]
        )
        T_robot_target = place.T_robot_body @ place.T_body_target
        rows.append(lidar_matching.pair(*seen, shapes[name], T_robot_target, number))
    pairs = lidar_matching.Pairs.of(rows)
    return lidar_matching.fitted(pairs, job.T_robot_sensor, np.arange(len(rows)), COARSE)[0]


def at_pose(job, views, T_robot_sensor, laid, outcomes):
    """(parts of the keypoints, outcomes) of the views that count at a pose of the sensor.

    laid: (columns, status) of the views that are compared by points, as they were laid on their
    template; a view of such a target that is not among them keeps its outcome.
    """
    counts, before = (
        in_view(job, views, T_robot_sensor, field_of_view.hidden_from_lidar),
        dict(outcomes),
    )
    parts, out = [], []
    for i in np.flatnonzero(views["kept"]):
        number, columns, status = int(views["view"][i]), [], counts[i]
        if status.ok and job.targets[views["target"][i]].points:
            part, status = laid.get(i, (None, before[number]))
            columns = [part] if status.ok else []
        elif status.ok:
            columns, status = around(job, views, i, T_robot_sensor)
        parts += columns if status.ok else []
        out.append((number, status))
    return parts, out


def _points(views, i):
    return np.asarray(views["xyz"][i], float).reshape(-1, 3)


def by_template(job, views, i, points, rows, T_robot_sensor=None):
    """(keypoint columns, status) of the paper's methods from the returns (rows of points (n, 3)) of
    one view: corners of the template that ICP laid on them, or all returns near it."""
    target = job.targets[views["target"][i]]
    measured, template = points[rows], target.points
    T = icp.icp(template, measured, job.expected(int(views["placement"][i]), T_robot_sensor))
    away = cKDTree(se3.transform(T, template.template)).query(measured)[0]
    sigma = np.hypot(job.model.range_sigma, template.spacing)
    if template.keypoints == "corners":
        if away.max() > FIT_M:
            found = f"a return {away.max():.3f} m from the template that ICP laid on them"
            return None, failed("returns do not fit the template", found, f"at most {FIT_M} m")
        corners = se3.transform(T, target.outline_points())
        return columns_of(views, i, "vertex", range(len(corners)), xyz=corners, sigma=sigma), OK
    near = away < icp.FARTHEST_M["all"]
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


def around(job, views, i, T_robot_sensor):
    """(parts of keypoint columns, status) of one view: returns near the surface and near the ends,
    and crossings of the outline."""
    target, placement = job.targets[views["target"][i]], int(views["placement"][i])
    points = _points(views, i)
    where = job.expected(placement, T_robot_sensor)
    q = se3.transform(se3.inverse(where), points)
    away, depth = np.abs(target.distance(*q.T)), target.depth(q)
    on = int(np.sum((away < ON_M) & (depth > 0)))
    if on < job.options["min_points"]:
        return [], failed("too few returns on the target", on, job.options["min_points"])
    rows = np.flatnonzero((away < SUPERSET_M) & (depth > -SUPERSET_M))
    parts = [surface_columns(job, views, i, points, rows)]
    ends = np.flatnonzero(target.near_ends(q, SUPERSET_M))
    parts.append(surface_columns(job, views, i, points, ends))
    parts[-1]["kind"] = np.full(len(ends), "cap")
    if len(target.edges()):
        gate = 4 * job.model.range_sigma
        ring = np.asarray(views["ring"][i])
        rays, rings = outline_crossings.crossings(target, where, points, ring, job.model, gate)
        sigma = job.model.azimuth_step / np.sqrt(12)
        parts.append(columns_of(views, i, "edge", rings, xyz=rays, sigma=sigma))
    return [p for p in parts if len(p["view"])], OK
