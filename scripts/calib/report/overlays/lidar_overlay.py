"""A target over the returns of one scan, by initial guess, result and truth (paper Figs. 4, 6)."""

from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import invert_pose, transform_points
from calib.geometry.units import MM_PER_M
from calib.report.data.run_data import Columns, ReportRun, shown_pose
from calib.report.figures import figure_encoding
from calib.report.figures.figure_encoding import (
    BLUE,
    GREEN,
    GREY,
    GUESS_COLOR,
    INK_COLOR,
    MARGIN_BOTTOM_IN,
    MARGIN_LEFT_IN,
    MARGIN_RIGHT_IN,
    MARGIN_TOP_IN,
    ORANGE,
    RESULT_COLOR,
    Drawing,
)
from calib.report.overlays.target_projections import TargetProjection, choose_projections
from calib.targets.target_shapes import ExactSurface, TargetShape, target_from_config
from calib.targets.template_cloud import TemplateCloud

MAX_POINTS = 2500
OVERLAY_WIDTH_IN = 5.6  # of two panels
MAX_OTHER_RADIUS = 1.3  # other returns are shown up to here, in bounding radii of the target
MARK_STYLES: dict[str, dict[str, Any]] = {
    "other": {"color": GREY, "ms": 1.6, "alpha": 0.5},
    "guess": {"color": GUESS_COLOR, "ms": 2.4, "alpha": 0.75},
    "rejected": {"color": ORANGE, "ms": 2.8, "alpha": 0.9},
    "result": {"color": RESULT_COLOR, "ms": 3.2, "alpha": 0.9},
    "truth": {"color": INK_COLOR, "ms": 1.3, "alpha": 0.9},
}


def draw_lidar_overlay(
    run: ReportRun, sensor: str, session: str, view: dict[str, Any], residuals: dict[str, Columns]
) -> Drawing:
    """Draw two projections of the returns of a view and of its target.

    view: row of views.parquet with its payload; residuals: of the view, by kind.
    """
    target = target_from_config(run.options["targets"][view["target"]])
    poses = run.T_sensor_target(sensor, session, view["placement"])
    points = np.asarray(view["xyz"], float).reshape(-1, 3)
    measured = [c for k, c in residuals.items() if RESIDUAL_KINDS[k].UNIT == "m"]
    points_by_mark = classify_overlay_points(points, poses, measured, target)
    T_sensor_target = shown_pose(poses)
    crossings = np.zeros((0, 3))
    if len(target.outline_edges()):
        rays = _crossing_rays(run.sessions[session].streams[sensor].keypoints, view["view"])
        crossings = _intersect_target_plane(invert_pose(T_sensor_target), rays)
    projections = choose_projections(target, T_sensor_target, points_by_mark["guess"])
    shares = [p.share for p in projections]
    fig, axes = figure_encoding.create_panels(
        shares, OVERLAY_WIDTH_IN, _figure_height_in(projections)
    )
    for ax, projection in zip(axes, projections, strict=True):
        _draw_projection(ax, projection, points_by_mark)
    if len(crossings):
        marks = projections[0].project(crossings)
        axes[0].plot(*marks.T, "D", ms=3.5, mew=1.1, mfc="none", color=GREEN)
    n_inliers, n_rejected = (len(points_by_mark[k]) for k in ("result", "rejected"))
    caption = f"{n_inliers} inliers, {n_rejected} over the target but not used"
    if poses["result"] is None:
        caption += "; no result, so everything is shown at the initial guess"
    label = f"Returns of view {view['view']} of {sensor} against {view['target']}"
    name = f"{sensor}-{session}-{view['view']}"
    return figure_encoding.finish_drawing(fig, name, label=label, caption=caption)


def classify_overlay_points(
    points: np.ndarray,
    poses: dict[str, np.ndarray | None],
    measured: list[Columns],
    target: TargetShape,
) -> dict[str, np.ndarray]:
    """Return points (n, 3), target frame, by mark of MARK_STYLES.

    points (n, 3): all returns, sensor frame; poses: of ReportRun.T_sensor_target; measured:
    residuals of the view.
    """
    marks = dict.fromkeys(MARK_STYLES, np.zeros((0, 3)))
    T_result = poses["result"]
    other = transform_points(invert_pose(shown_pose(poses)), points)
    distance = np.linalg.norm(other - target.centre, axis=1)
    marks["other"] = other[distance < MAX_OTHER_RADIUS * target.bounding_radius]
    if not measured:
        return marks
    is_inlier = np.concatenate([np.asarray(c["weight"]) > 0 for c in measured])
    in_target = np.concatenate([c["measured"] for c in measured])
    marks["result"] = in_target[is_inlier]
    marks["rejected"] = in_target[~is_inlier & _is_inside_rim(target, in_target)]
    for name in ("guess", "truth"):
        T = poses[name]
        if T is not None and T_result is not None:
            marks[name] = transform_points(invert_pose(T) @ T_result, in_target[is_inlier])
    return marks


def _is_inside_rim(target: TargetShape, points: np.ndarray) -> np.ndarray:
    """Return whether points (n, 3), target frame, lie inside the rim. A template has no rim."""
    if isinstance(target, TemplateCloud):
        return np.ones(len(points), bool)
    # All targets except templates have the members of this protocol.
    return cast(ExactSurface, target).distance_inside_rim(points) > 0


def _crossing_rays(keypoints: Columns, view: int) -> np.ndarray:
    """Return unit rays (n, 3), sensor frame, of the outline crossings of a view."""
    is_crossing = np.asarray(keypoints["kind"], str) == "board_outline"
    rows = (np.asarray(keypoints["view"]) == view) & is_crossing
    return np.asarray(keypoints["xyz"], float).reshape(-1, 3)[rows]


def _intersect_target_plane(T_target_sensor: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return the intersections of unit rays (n, 3), sensor frame, with z = 0 of the target."""
    origin, beam = T_target_sensor[:3, 3], rays @ T_target_sensor[:3, :3].T
    beam = beam[np.abs(beam[:, 2]) > 1e-6]
    return origin - beam * (origin[2] / beam[:, 2])[:, None]


def _figure_height_in(projections: tuple[TargetProjection, ...]) -> float:
    """Return the height, inch, of a figure in which the taller projection fills its panel."""
    width_in = OVERLAY_WIDTH_IN - 2 * MARGIN_LEFT_IN - MARGIN_RIGHT_IN
    heights = []
    for projection in projections:
        (width, height) = np.subtract(*projection.limits()[::-1])
        panel_width = width_in * projection.share / sum(p.share for p in projections)
        aspect = height / width if projection.half_height_mm is None else 0.7
        heights.append(panel_width * min(aspect, 1.2))
    return MARGIN_BOTTOM_IN + MARGIN_TOP_IN + max(heights)


def _draw_projection(
    ax: Axes, projection: TargetProjection, points_by_mark: dict[str, np.ndarray]
) -> None:
    """Draw the outline and the points of one projection."""
    is_magnified = projection.half_height_mm is not None
    scale = np.array([1.0, MM_PER_M if is_magnified else 1.0])
    outline_style: dict[str, Any] = (
        {"ls": "-"} if projection.has_line else {"ls": "none", "marker": "."}
    )
    ax.plot(*(projection.outline * scale).T, color=BLUE, lw=1.6, ms=1.5, **outline_style)
    for mark, style in MARK_STYLES.items():
        points = projection.project(points_by_mark[mark]) * scale
        every = len(points) // MAX_POINTS + 1
        ax.plot(*points[::every].T, ".", mew=0, rasterized=True, **style)
    low, high = projection.limits()
    ax.set(xlabel=projection.xlabel, ylabel=projection.ylabel, title=projection.title)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    if not is_magnified:
        ax.set(aspect="equal", anchor="W")
