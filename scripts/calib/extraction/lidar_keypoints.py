"""Returns on a target's surface and crossings of its outline, or the paper's keypoints."""

import numpy as np
from scipy.spatial import cKDTree

from calib.extraction.extraction_inputs import make_keypoint_columns
from calib.extraction.working_pose import (
    LOOSE_GATES,
    check_kept_views,
    estimate_working_pose,
    iterate_working_pose,
)
from calib.geometry.icp import MAX_ICP_DISTANCE_M, register_template_icp
from calib.geometry.se3 import invert_pose, transform_points
from calib.initial_guess.lidar_candidates import ShapeSignature, measure_candidate
from calib.initial_guess.lidar_matching import CandidateMatches, fit_match_pose, make_match
from calib.io.parquet_tables import concatenate_columns, empty_columns
from calib.io.status import OK, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.sensors.lidar.outline_crossings import find_outline_crossings
from calib.sensors.lidar.target_search import find_target_in_scan
from calib.views.field_of_view import check_lidar_visibility

MAX_SURFACE_DISTANCE_M = (
    0.1  # returns this near to the target's surface are handed on; solve decides
)
ON_TARGET_DISTANCE_M = (
    0.05  # nearer returns, over the surface, are on the target: they show that it is there
)
COARSE_CENTRE_SIGMA_M = 0.05  # σ of what is found at first: of its centre, and
COARSE_CANDIDATE_SIGMA = COARSE_CENTRE_SIGMA_M, np.radians(3)  # of its direction
LIDAR_NOISE_FACTOR = 3.0  # times σ: what the working pose starts from
MAX_TEMPLATE_DISTANCE_M = (
    0.03  # a scan point farther than this from the template that ICP laid on it spoils the view
)


def extract_lidar_keypoints(context, views):
    """Keypoints of a lidar's views (calib.extraction.extractor_registry)."""
    found, outcomes = find_target_returns(context, views)
    parts = [
        make_surface_columns(context, views, i, _view_points(views, i), rows)
        for i, rows in found.items()
    ]
    if not parts:
        return empty_columns(KEYPOINTS_SCHEMA), outcomes, None
    keypoints = concatenate_columns(parts, KEYPOINTS_SCHEMA)
    wide = COARSE_CENTRE_SIGMA_M / keypoints["sigma"].min()
    T = estimate_working_pose(
        context,
        keypoints,
        fit_pose_to_centres(context, views, found),
        context.associate_options | LOOSE_GATES,
        wide,
    )
    laid = {
        i: extract_template_keypoints(context, views, i, _view_points(views, i), rows, T)
        for i, rows in found.items()
        if not context.targets[views["target"][i]].uses_exact_surface
    }
    return iterate_working_pose(
        context,
        lambda at: lidar_keypoints_at_pose(context, views, at, laid, outcomes),
        T,
        LIDAR_NOISE_FACTOR,
    )


def find_target_returns(context, views):
    """({row of views: returns on the target}, outcomes) of the kept views, from the guess.

    In one view of each placement, which shows where the sensor is; in all of a target that is
    compared by points.
    """
    found, outcomes, done = {}, [], set()
    for i in np.flatnonzero(views["kept"]):
        target, placement = context.targets[views["target"][i]], int(views["placement"][i])
        if placement in done:
            continue
        points, where = _view_points(views, i), context.predict_target_pose(placement)
        rows, status = find_target_in_scan(
            target, points, where, context.pose_margin, context.model, context.extract_options
        )
        if status.ok:
            found[i] = rows
            done |= {placement} if target.uses_exact_surface else set()
        outcomes.append((int(views["view"][i]), status))
    return found, outcomes


def fit_pose_to_centres(context, views, returns_by_view):
    """T_robot_sensor (4, 4) that lays centres and directions of what was found on the targets':
    from there the surfaces, which say little about shifts along them, lead to the right place."""
    shapes = {n: ShapeSignature.from_target(t) for n, t in context.targets.items()}
    rows = []
    for number, (i, members) in enumerate(returns_by_view.items()):
        place, name = context.placements[int(views["placement"][i])], views["target"][i]
        seen = measure_candidate(
            context.targets[name], shapes[name], _view_points(views, i)[members]
        )
        T_robot_target = place.T_robot_body @ place.T_body_target
        rows.append(make_match(*seen, shapes[name], T_robot_target, number))
    pairs = CandidateMatches.from_rows(rows)
    return fit_match_pose(
        pairs, context.T_robot_sensor, np.arange(len(rows)), COARSE_CANDIDATE_SIGMA
    )[0]


def lidar_keypoints_at_pose(context, views, T_robot_sensor, template_fits, outcomes):
    """(parts of the keypoints, outcomes) of the views that count at a pose of the sensor.

    template_fits: (columns, status) of the views that are compared by points, as they were laid on their
    template; a view of such a target that is not among them keeps its outcome.
    """
    counts, before = (
        check_kept_views(context, views, T_robot_sensor, check_lidar_visibility),
        dict(outcomes),
    )
    parts, out = [], []
    for i in np.flatnonzero(views["kept"]):
        number, columns, status = int(views["view"][i]), [], counts[i]
        if status.ok and not context.targets[views["target"][i]].uses_exact_surface:
            part, status = template_fits.get(i, (None, before[number]))
            columns = [part] if status.ok else []
        elif status.ok:
            columns, status = extract_lidar_view(context, views, i, T_robot_sensor)
        parts += columns if status.ok else []
        out.append((number, status))
    return parts, out


def _view_points(views, i):
    return np.asarray(views["xyz"][i], float).reshape(-1, 3)


def extract_template_keypoints(context, views, i, points, rows, T_robot_sensor=None):
    """(keypoint columns, status) of the paper's methods from the returns (rows of points (n, 3)) of
    one view: corners of the template that ICP laid on them, or all returns near it."""
    target = context.targets[views["target"][i]]
    measured, template = points[rows], target.point_template
    T = register_template_icp(
        template, measured, context.predict_target_pose(int(views["placement"][i]), T_robot_sensor)
    )
    away = cKDTree(transform_points(T, template.xyz)).query(measured)[0]
    sigma = np.hypot(context.model.range_sigma, template.spacing)
    if template.keypoint_mode == "corners":
        if away.max() > MAX_TEMPLATE_DISTANCE_M:
            found = f"a return {away.max():.3f} m from the template that ICP laid on them"
            return None, failure_status(
                "returns do not fit the template", found, f"at most {MAX_TEMPLATE_DISTANCE_M} m"
            )
        corners = transform_points(T, target.outline_points())
        return make_keypoint_columns(
            views, i, "template_vertex", range(len(corners)), xyz=corners, sigma=sigma
        ), OK
    near = away < MAX_ICP_DISTANCE_M["all"]
    if near.sum() < context.extract_options["min_points"]:
        least = context.extract_options["min_points"]
        return None, failure_status("too few returns near the template", int(near.sum()), least)
    columns = make_surface_columns(context, views, i, points, rows[near])
    return columns | {
        "kind": np.full(near.sum(), "template_point"),
        "sigma": np.full(near.sum(), sigma),
    }, OK


def make_surface_columns(context, views, i, points, rows):
    """Returns (rows of points (n, 3)) of a view as surface keypoints with their own stamps."""
    dt, ring = np.asarray(views["point_time_ns"][i])[rows], np.asarray(views["ring"][i])[rows]
    sigma = context.model.range_sigma
    return make_keypoint_columns(
        views, i, "target_surface", ring, xyz=points[rows], sigma=sigma, dt=dt
    )


def extract_lidar_view(context, views, i, T_robot_sensor):
    """(parts of keypoint columns, status) of one view: returns near the surface and near the ends,
    and crossings of the outline."""
    target, placement = context.targets[views["target"][i]], int(views["placement"][i])
    points = _view_points(views, i)
    where = context.predict_target_pose(placement, T_robot_sensor)
    q = transform_points(invert_pose(where), points)
    away, depth = np.abs(target.surface_distance(*q.T)), target.distance_inside_rim(q)
    on = int(np.sum((away < ON_TARGET_DISTANCE_M) & (depth > 0)))
    if on < context.extract_options["min_points"]:
        return [], failure_status(
            "too few returns on the target", on, context.extract_options["min_points"]
        )
    rows = np.flatnonzero((away < MAX_SURFACE_DISTANCE_M) & (depth > -MAX_SURFACE_DISTANCE_M))
    parts = [make_surface_columns(context, views, i, points, rows)]
    ends = np.flatnonzero(target.is_near_cap(q, MAX_SURFACE_DISTANCE_M))
    parts.append(make_surface_columns(context, views, i, points, ends))
    parts[-1]["kind"] = np.full(len(ends), "cylinder_cap")
    if len(target.outline_edges()):
        gate = 4 * context.model.range_sigma
        ring = np.asarray(views["ring"][i])
        rays, rings = find_outline_crossings(target, where, points, ring, context.model, gate)
        sigma = context.model.azimuth_step / np.sqrt(12)
        parts.append(make_keypoint_columns(views, i, "board_outline", rings, xyz=rays, sigma=sigma))
    return [p for p in parts if len(p["view"])], OK
