"""Extract returns on a target's surface and crossings of its outline, or the paper's keypoints."""

from collections.abc import Mapping
from typing import NamedTuple, cast

import numpy as np
from scipy.spatial import cKDTree

from calib.extraction.extraction_inputs import ExtractionContext, kept_rows, make_keypoint_columns
from calib.extraction.extraction_results import Extraction, ViewKeypoints
from calib.extraction.working_pose import (
    LOOSE_GATES,
    check_kept_views,
    estimate_working_pose,
    iterate_working_pose,
)
from calib.geometry.icp import MAX_ICP_DISTANCE_M, register_template_icp
from calib.geometry.se3 import invert_pose, transform_points
from calib.initial_guess.candidate_matches import CandidateMatches, fit_match_pose, make_match
from calib.initial_guess.lidar_candidates import ShapeSignature, measure_candidate
from calib.io.parquet_tables import concatenate_columns
from calib.io.status import OK, Status, failure_status
from calib.io.table_schemas import KEYPOINTS_SCHEMA
from calib.sensors.lidar.scan_line_crossings import find_outline_crossings
from calib.sensors.lidar.target_search import find_target_in_scan
from calib.targets.board import Board
from calib.targets.target_shapes import ExactSurface
from calib.views.field_of_view import check_lidar_visibility
from calib.views.target_placements import Columns

# Returns this near to the surface become keypoints; solve decides which are inliers.
MAX_SURFACE_DISTANCE_M = 0.1
ON_TARGET_DISTANCE_M = 0.05  # nearer returns show that the target is there
# σ of centre, m, and direction, rad, of a target as it is found first.
COARSE_CANDIDATE_SIGMA = np.array([0.05, np.radians(3)])
LIDAR_NOISE_FACTOR = 3.0  # times σ, that the working pose starts from
MAX_TEMPLATE_DISTANCE_M = 0.03  # of a return from the registered template
CROSSING_GATE_SIGMAS = 4  # of a range


class FoundTargets(NamedTuple):
    """Returns on the target (indices) by row of views, and the status of the searched rows."""

    returns: dict[int, np.ndarray]
    statuses: dict[int, Status]


def extract_lidar_keypoints(context: ExtractionContext, views: Columns) -> Extraction:
    """Extract the keypoints of a lidar (calib.extraction.extractor_registry)."""
    found = find_target_returns(context, views)
    if not found.returns:
        failures = {i: ViewKeypoints(None, status) for i, status in found.statuses.items()}
        return Extraction.collect(views, failures)
    parts = [make_surface_columns(context, views, i, rows) for i, rows in found.returns.items()]
    keypoints = concatenate_columns(parts, KEYPOINTS_SCHEMA)
    T, _ = estimate_working_pose(
        context,
        keypoints,
        fit_pose_to_centres(context, views, found.returns),
        context.associate_options | LOOSE_GATES,
        noise_factor=COARSE_CANDIDATE_SIGMA[0] / keypoints["sigma"].min(),
    )
    template_fits = {
        i: extract_template_keypoints(context, views, i, rows, T)
        for i, rows in found.returns.items()
        if not context.targets[views["target"][i]].uses_exact_surface
    }
    # A view of such a target in which it was not found keeps its status.
    failed_fits = {
        i: ViewKeypoints(None, status)
        for i, status in found.statuses.items()
        if i not in template_fits
    }
    return iterate_working_pose(
        context,
        views,
        lambda T: lidar_keypoints_at_pose(context, views, T, failed_fits | template_fits),
        T,
        LIDAR_NOISE_FACTOR,
    )


def find_target_returns(context: ExtractionContext, views: Columns) -> FoundTargets:
    """Find the returns on the targets in the kept views, at the initial guess.

    In one view of each placement, which is enough to find the sensor; in all views of targets that
    are compared by points.
    """
    returns: dict[int, np.ndarray] = {}
    statuses: dict[int, Status] = {}
    found_placements: set[int] = set()
    for i in kept_rows(views):
        target, placement = context.targets[views["target"][i]], int(views["placement"][i])
        if placement in found_placements:
            continue
        rows, statuses[i] = find_target_in_scan(
            target,
            view_points(views, i),
            context.predict_target_pose(placement),
            context.pose_margin,
            lidar=context.model,
            options=context.extract_options,
        )
        if statuses[i].ok:
            returns[i] = rows
            found_placements |= {placement} if target.uses_exact_surface else set()
    return FoundTargets(returns, statuses)


def fit_pose_to_centres(
    context: ExtractionContext, views: Columns, returns: Mapping[int, np.ndarray]
) -> np.ndarray:
    """Fit T_robot_sensor (4, 4) to centres and directions of the targets that were found.

    Surfaces constrain shifts along them badly; from this pose they lead to the right place.
    """
    signatures = {n: ShapeSignature.from_target(t) for n, t in context.targets.items()}
    rows = []
    for number, (i, on_target) in enumerate(returns.items()):
        place, name = context.placements[int(views["placement"][i])], views["target"][i]
        candidate = measure_candidate(
            context.targets[name], signatures[name], view_points(views, i)[on_target]
        )
        T_robot_target = place.T_robot_body @ place.T_body_target
        rows.append(make_match(candidate, signatures[name], T_robot_target, number))
    matches = CandidateMatches.from_rows(rows)
    return fit_match_pose(
        matches, context.T_robot_sensor, np.arange(len(rows)), COARSE_CANDIDATE_SIGMA
    ).T_robot_sensor


def lidar_keypoints_at_pose(
    context: ExtractionContext,
    views: Columns,
    T_robot_sensor: np.ndarray,
    template_fits: Mapping[int, ViewKeypoints],
) -> dict[int, ViewKeypoints]:
    """Return the results by row of the kept views at a pose of the lidar.

    template_fits: by row, of the views of targets that are compared by points.
    """
    statuses = check_kept_views(context, views, T_robot_sensor, check_lidar_visibility)
    results = {}
    for i in kept_rows(views):
        if not statuses[i].ok:
            results[i] = ViewKeypoints(None, statuses[i], is_wanted=False)
        elif not context.targets[views["target"][i]].uses_exact_surface:
            results[i] = template_fits[i]
        else:
            results[i] = extract_lidar_view(context, views, i, T_robot_sensor)
    return results


def view_points(views: Columns, i: int) -> np.ndarray:
    """Return the returns (n, 3), m, of the view in row i."""
    return np.asarray(views["xyz"][i], float).reshape(-1, 3)


def extract_template_keypoints(
    context: ExtractionContext,
    views: Columns,
    i: int,
    rows: np.ndarray,
    T_robot_sensor: np.ndarray | None = None,
) -> ViewKeypoints:
    """Extract the keypoints of the paper's methods from the returns on the target in a view.

    rows: indices of these returns in the view. Keypoints are the corners of the template that ICP
    registered to these returns, or all returns near it.
    """
    target = context.targets[views["target"][i]]
    template, measured = target.point_template, view_points(views, i)[rows]
    assert template is not None
    T = register_template_icp(
        template, measured, context.predict_target_pose(int(views["placement"][i]), T_robot_sensor)
    )
    distance = cKDTree(transform_points(T, template.xyz)).query(measured)[0]
    sigma = np.hypot(context.model.range_sigma, template.spacing)
    if template.keypoint_mode == "corners":
        if distance.max() > MAX_TEMPLATE_DISTANCE_M:
            return ViewKeypoints(None, _bad_template_fit_status(distance.max()))
        corners = transform_points(T, target.outline_points())
        columns = make_keypoint_columns(
            views, i, "template_vertex", range(len(corners)), xyz=corners, sigma=sigma
        )
        return ViewKeypoints(columns, OK)
    near = rows[distance < MAX_ICP_DISTANCE_M["all"]]
    n_required = context.extract_options["min_points"]
    if len(near) < n_required:
        status = failure_status("too few returns near the template", len(near), n_required)
        return ViewKeypoints(None, status)
    columns = make_surface_columns(context, views, i, near, "template_point")
    return ViewKeypoints(columns | {"sigma": np.full(len(near), sigma)}, OK)


def _bad_template_fit_status(distance_m: float) -> Status:
    return failure_status(
        "returns do not fit the template",
        f"a return {distance_m:.3f} m from the template registered by ICP",
        f"at most {MAX_TEMPLATE_DISTANCE_M} m",
    )


def make_surface_columns(
    context: ExtractionContext,
    views: Columns,
    i: int,
    rows: np.ndarray,
    kind: str = "target_surface",
) -> Columns:
    """Return the returns in some rows of a view as keypoints with their own stamps."""
    return make_keypoint_columns(
        views,
        i,
        kind,
        np.asarray(views["ring"][i])[rows],
        xyz=view_points(views, i)[rows],
        sigma=context.model.range_sigma,
        point_time_ns=np.asarray(views["point_time_ns"][i])[rows],
        intensity=np.asarray(views["intensity"][i])[rows],
    )


def extract_lidar_view(
    context: ExtractionContext, views: Columns, i: int, T_robot_sensor: np.ndarray
) -> ViewKeypoints:
    """Extract the keypoints of the view in row i at a pose of the lidar.

    Returns near the surface and near flat ends, and crossings of the outline.
    """
    target, placement = context.targets[views["target"][i]], int(views["placement"][i])
    points = view_points(views, i)
    T_sensor_target = context.predict_target_pose(placement, T_robot_sensor)
    q = transform_points(invert_pose(T_sensor_target), points)
    # All targets with uses_exact_surface have the members of this protocol.
    surface = cast(ExactSurface, target)
    distance, depth = np.abs(surface.surface_distance(*q.T)), surface.distance_inside_rim(q)
    n_on_target = int(np.sum((distance < ON_TARGET_DISTANCE_M) & (depth > 0)))
    n_required = context.extract_options["min_points"]
    if n_on_target < n_required:
        status = failure_status("too few returns on the target", n_on_target, n_required)
        return ViewKeypoints(None, status)
    is_near = (distance < MAX_SURFACE_DISTANCE_M) & (depth > -MAX_SURFACE_DISTANCE_M)
    cap_rows = np.flatnonzero(surface.is_near_cap(q, MAX_SURFACE_DISTANCE_M))
    parts = [
        make_surface_columns(context, views, i, np.flatnonzero(is_near)),
        make_surface_columns(context, views, i, cap_rows, "cylinder_cap"),
    ]
    if len(target.outline_edges()):
        parts.append(_make_crossing_columns(context, views, i, T_sensor_target))
    parts = [part for part in parts if len(part["view"])]
    return ViewKeypoints(concatenate_columns(parts, KEYPOINTS_SCHEMA), OK)


def _make_crossing_columns(
    context: ExtractionContext, views: Columns, i: int, T_sensor_target: np.ndarray
) -> Columns:
    """Return the rays at which scan lines cross the outline, as keypoints."""
    target = context.targets[views["target"][i]]
    assert isinstance(target, Board)  # only boards have outline edges
    rays, rings = find_outline_crossings(
        target,
        T_sensor_target,
        view_points(views, i),
        np.asarray(views["ring"][i]),
        azimuth_step=context.model.azimuth_step,
        gate_m=CROSSING_GATE_SIGMAS * context.model.range_sigma,
    )
    # The crossing is evenly distributed between two beams.
    sigma = context.model.azimuth_step / np.sqrt(12)
    return make_keypoint_columns(views, i, "board_outline", rings, xyz=rays, sigma=sigma)
