"""A target against the returns of one scan, by first guess, result and truth; paper Figs. 4, 6."""

import numpy as np

from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.geometry.se3 import invert_pose, transform_points
from calib.report.figures import svg_plots
from calib.report.figures.svg_plots import (
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
)
from calib.targets.target_shapes import target_from_config

MAX_POINTS = 2500
OVERLAY_WIDTH_IN = 5.6  # inch, of two panels
EDGE_ON_RANGE_M = (0.05, 0.3)  # half of what is shown off a surface: least and most
MARK_STYLES = {
    "other": dict(color=GREY, ms=1.6, alpha=0.5),
    "guess": dict(color=GUESS_COLOR, ms=2.4, alpha=0.75),
    "rejected": dict(color=ORANGE, ms=2.8, alpha=0.9),
    "solved": dict(color=RESULT_COLOR, ms=3.2, alpha=0.9),
    "truth": dict(color=INK_COLOR, ms=1.3, alpha=0.9),
}


def draw_lidar_overlay(run, sensor, session, row, rows):
    """Two projections of one view's returns and its target's shape, as a Drawing."""
    target = target_from_config(run.options["targets"][row["target"]])
    T = run.T_sensor_target(sensor, session, row["placement"])
    points = np.asarray(row["xyz"], float).reshape(-1, 3)
    measured = [c for k, c in rows.items() if RESIDUAL_KINDS[k].UNIT == "m"]
    sets = classify_overlay_points(points, T, measured, target)
    shown = T["solved"] if T["solved"] is not None else T["guess"]
    rays = _crossing_rays(run, sensor, session, row["view"])
    crossings = _intersect_target_plane(
        invert_pose(shown), rays if len(target.outline_edges()) else rays[:0]
    )
    views = choose_projections(target, shown, sets["guess"])
    fig, axes = svg_plots.create_panels(
        [v["share"] for v in views], OVERLAY_WIDTH_IN, _figure_height_in(views)
    )
    for ax, view, marks in zip(axes, views, (crossings, crossings[:0]), strict=True):
        _draw_projection(ax, view, sets, marks)
    caption = f"{len(sets['solved'])} members, {len(sets['rejected'])} over the target but not used"
    if T["solved"] is None:
        caption += "; no solution, so all is shown at the first guess"
    label = f"Returns of view {row['view']} of {sensor} against {row['target']}"
    return svg_plots.finish_drawing(fig, f"{sensor}-{session}-{row['view']}", label, caption)


def classify_overlay_points(points, T, measured, target):
    """{mark: (n, 3)} points, target frame, by what became of them and by which pose."""
    sets = dict.fromkeys(MARK_STYLES, np.zeros((0, 3)))
    shown = T["solved"] if T["solved"] is not None else T["guess"]
    other = transform_points(invert_pose(shown), points)
    sets["other"] = other[
        np.linalg.norm(other - target.centre, axis=1) < 1.3 * target.bounding_radius
    ]
    if not measured:
        return sets
    member = np.concatenate([np.asarray(c["weight"]) > 0 for c in measured])
    seen = np.concatenate([c["measured"] for c in measured])
    sets["solved"] = seen[member]
    sets["rejected"] = seen[~member & (_rim_depth(target, seen) > 0)]
    for name in ("guess", "truth"):
        if T[name] is not None and T["solved"] is not None:
            moved = invert_pose(T[name]) @ T["solved"]
            sets[name] = transform_points(moved, seen[member])
    return sets


def _rim_depth(target, q):
    """Depth (n,) inside the rim, m; a shape given as a cloud has no rim."""
    return target.distance_inside_rim(q) if hasattr(target, "depth") else np.ones(len(q))


def _crossing_rays(run, sensor, session, view):
    """Unit rays (n, 3), sensor frame, of a view's outline crossings."""
    k = run.sessions[session].streams[sensor].keypoints
    rows = (np.asarray(k["view"]) == view) & (np.asarray(k["kind"], str) == "board_outline")
    return np.asarray(k["xyz"], float).reshape(-1, 3)[rows]


def _intersect_target_plane(T_target_sensor, rays):
    """Where unit rays (n, 3), sensor frame, meet the plane z = 0 of the target."""
    origin, beam = T_target_sensor[:3, 3], rays @ T_target_sensor[:3, :3].T
    beam = beam[np.abs(beam[:, 2]) > 1e-6]
    return origin - beam * (origin[2] / beam[:, 2])[:, None]


def choose_projections(target, T_sensor_target, guess_points):
    """Two views of a target; guess_points (n, 3): points that should not be cut off."""
    if len(target.outline_edges()):
        return make_board_projections(target, guess_points)
    if hasattr(target, "radius"):
        return make_cylinder_projections(target, T_sensor_target)
    return make_template_projections(target)


def make_board_projections(target, guess_points):
    """Face on, and along the widest direction of the face at a magnified distance from it."""
    outline = np.vstack([target.vertices, target.vertices[:1]])
    low, high = target.vertices.min(0), target.vertices.max(0)
    wide = int(np.ptp(target.vertices, axis=0).argmax())
    off = np.quantile(np.abs(guess_points[:, 2]), 0.98) if len(guess_points) else 0.0
    edge_on = np.array([[low[wide], 0.0], [high[wide], 0.0]])
    labels = f"{'xy'[wide]}, m", "off the face, mm"
    return (
        _make_projection("face on", (0, 1), ("x, m", "y, m"), outline),
        _make_projection(
            "edge on", (wide, 2), labels, edge_on, half=1e3 * np.clip(1.1 * off, *EDGE_ON_RANGE_M)
        ),
    )


def make_cylinder_projections(target, T_sensor_target):
    """From the side, and along the axis, with the sensor below."""
    eye = invert_pose(T_sensor_target)[:3, 3]
    away = -eye[1:] / max(np.linalg.norm(eye[1:]), 1e-9)
    turn = np.eye(3)
    turn[1, 1:], turn[2, 1:] = [-away[1], away[0]], away
    x, r = target.length / 2, target.radius
    side = np.array([[-x, -r], [x, -r], [x, r], [-x, r], [-x, -r]])
    angle = np.linspace(0, 2 * np.pi, 90)
    end = r * np.column_stack([np.cos(angle), np.sin(angle)])
    labels = ("along the axis, m", "across, m"), ("across, m", "away from the sensor, m")
    return (
        _make_projection("from the side", (0, 1), labels[0], side, turn=turn, share=1.6),
        _make_projection("along the axis", (1, 2), labels[1], end, turn=turn),
    )


def make_template_projections(target):
    """From above and from the side, with the points of the template for an outline."""
    template = target.point_template.xyz
    return tuple(
        _make_projection(f"{'xyz'[a]} and {'xyz'[b]}", (a, b), (f"{'xyz'[a]}, m", f"{'xyz'[b]}, m"),
              template[:, [a, b]], line="")
        for a, b in ((0, 1), (0, 2))
    )  # fmt: skip


def _make_projection(title, axes, labels, outline, half=None, turn=None, share=1.0, line="-"):
    """A projection; half: what is shown to either side of a magnified second axis, mm."""
    turn = np.eye(3) if turn is None else turn
    known = dict(title=title, axes=axes, labels=labels, outline=outline, half=half)
    return known | dict(turn=turn, share=share, line=line)


def _projection_limits(view):
    """Lowest and highest corner (2,) of what a projection shows."""
    low, high = view["outline"].min(0), view["outline"].max(0)
    room = 0.16 * (max(high - low) if view["half"] is None else high[0] - low[0])
    low, high = low - room, high + room
    if view["half"] is not None:
        low[1], high[1] = -view["half"], view["half"]
    return low, high


def _figure_height_in(views):
    """Height, inch, of a figure in which the taller of two projections fills its panel."""
    room = OVERLAY_WIDTH_IN - 2 * MARGIN_LEFT_IN - MARGIN_RIGHT_IN
    tall = []
    for view in views:
        low, high = _projection_limits(view)
        wide = room * view["share"] / sum(v["share"] for v in views)
        share = (high[1] - low[1]) / (high[0] - low[0]) if view["half"] is None else 0.7
        tall.append(wide * min(share, 1.2))
    return MARGIN_BOTTOM_IN + MARGIN_TOP_IN + max(tall)


def _draw_projection(ax, view, sets, crossings):
    """One projection on axes."""
    scale = np.array([1.0, 1.0 if view["half"] is None else 1e3])
    style = dict(lw=1.6, ls=view["line"] or "none", marker="" if view["line"] else ".", ms=1.5)
    ax.plot(*(view["outline"] * scale).T, color=BLUE, **style)
    for mark, style in MARK_STYLES.items():
        p = _project_points(sets[mark], view) * scale
        ax.plot(*p[:: len(p) // MAX_POINTS + 1].T, ".", mew=0, rasterized=True, **style)
    if len(crossings):
        ax.plot(*_project_points(crossings, view).T, "D", ms=3.5, mew=1.1, mfc="none", color=GREEN)
    low, high = _projection_limits(view)
    ax.set(xlabel=view["labels"][0], ylabel=view["labels"][1], title=view["title"])
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    if view["half"] is None:
        ax.set(aspect="equal", anchor="W")


def _project_points(points, view):
    return (np.asarray(points) @ view["turn"].T)[:, list(view["axes"])]
