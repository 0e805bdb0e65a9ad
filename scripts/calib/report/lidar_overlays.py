"""A target's exact shape against the returns of one scan, in two projections."""

import numpy as np

from calib import geometry, targets
from calib.report import plots
from calib.report.plots import BLUE, GREEN, GREY, INK, ORANGE, PURPLE

MOST_POINTS = 4000
EDGE_ON_M = 0.12  # half of what is shown off a surface
MARKS = {
    "other": dict(color=GREY, ms=1.6, alpha=0.55),
    "guess": dict(color=PURPLE, ms=2.2, alpha=0.7),
    "rejected": dict(color=ORANGE, ms=3.0, alpha=0.95),
    "member": dict(color=BLUE, ms=2.6, alpha=0.9),
}


def draw(run, sensor, session, row, rows):
    """Two projections of one view's returns and its target's shape."""
    target = targets.from_config(run.options["targets"][row["target"]])
    guess, solved = run.T_sensor_target(sensor, session, row["placement"])
    points = np.asarray(row["xyz"], float).reshape(-1, 3)
    sets = point_sets(points, guess, solved, rows.get("surface"), target)
    rays = _rays(run, sensor, session, row["view"])
    T = solved if solved is not None else guess
    crossings = _on_plane(geometry.inverse(T), rays) if len(target.edges()) else np.zeros((0, 3))
    name = f"{sensor}-{session}-{row['view']}"
    views = board(target, T) if len(target.edges()) else round_body(target, T)
    svgs = [
        _panel(f"{name}-{i}", v, sets, crossings if i == 0 else crossings[:0])
        for i, v in enumerate(views)
    ]
    n = {k: len(v) for k, v in sets.items()}
    caption = f"{n['member']} members, {n['rejected']} over the target but not used"
    if solved is None:
        caption += "; no solution, so all is shown at the first guess"
    return {"svgs": svgs, "caption": caption}


def point_sets(points, guess, solved, surface, target):
    """{mark: (n, 3)} points, target frame, by what became of them."""
    nothing = np.zeros((0, 3))
    T = solved if solved is not None else guess
    other = geometry.transform(geometry.inverse(T), points)
    other = other[np.linalg.norm(other - target.centre, axis=1) < 1.3 * target.reach]
    if surface is None or not len(surface["weight"]):
        return {"other": other, "guess": nothing, "rejected": nothing, "member": nothing}
    is_member = np.asarray(surface["weight"]) > 0
    measured = surface["measured"]
    close = target.depth(measured) > 0
    moved = nothing
    if guess is not None and solved is not None:
        moved = geometry.transform(geometry.inverse(guess) @ solved, measured[is_member])
    rejected = measured[~is_member & close]
    return {"other": other, "guess": moved, "rejected": rejected, "member": measured[is_member]}


def _rays(run, sensor, session, view):
    k = run.sessions[session].streams[sensor].keypoints
    rows = (np.asarray(k["view"]) == view) & (np.asarray(k["kind"], str) == "edge")
    return np.asarray(k["xyz"], float).reshape(-1, 3)[rows]


def _on_plane(T_target_sensor, rays):
    """Where unit rays (n, 3), sensor frame, meet the plane z = 0 of the target."""
    origin, beam = T_target_sensor[:3, 3], rays @ T_target_sensor[:3, :3].T
    beam = beam[np.abs(beam[:, 2]) > 1e-6]
    return origin - beam * (origin[2] / beam[:, 2])[:, None]


def board(target, T_sensor_target):
    """Face on, and along the widest direction of the face at a magnified distance from it."""
    outline = np.vstack([target.vertices, target.vertices[:1]])
    low, high = target.vertices.min(0), target.vertices.max(0)
    wide = int(np.ptp(target.vertices, axis=0).argmax())
    edge_on = np.array([[low[wide], 0.0], [high[wide], 0.0]])
    return (
        _view("face on", (0, 1), ("x, m", "y, m"), outline, True),
        _view("edge on", (wide, 2), (f"{'xy'[wide]}, m", "off the face, mm"), edge_on, False),
    )


def round_body(target, T_sensor_target):
    """From the side, and along the axis, with the sensor below."""
    eye = geometry.inverse(T_sensor_target)[:3, 3]
    away = -eye[1:] / max(np.linalg.norm(eye[1:]), 1e-9)
    across = np.array([-away[1], away[0]])
    turn = np.eye(3)
    turn[1, 1:], turn[2, 1:] = across, away
    x, r = target.length / 2, target.radius
    side = np.array([[-x, -r], [x, -r], [x, r], [-x, r], [-x, -r]])
    angle = np.linspace(0, 2 * np.pi, 90)
    end = r * np.column_stack([np.cos(angle), np.sin(angle)])
    return (
        _view("from the side", (0, 1), ("along the axis, m", "across, m"), side, True, turn),
        _view("along the axis", (1, 2), ("across, m", "away from the sensor, m"), end, True, turn),
    )


def _view(title, axes, labels, outline, equal, turn=None):
    turn = np.eye(3) if turn is None else turn
    return dict(title=title, axes=axes, labels=labels, outline=outline, equal=equal, turn=turn)


def _panel(name, view, sets, crossings):
    """<svg> of one projection."""
    scale = np.array([1.0, 1.0 if view["equal"] else 1e3])
    outline = view["outline"] * scale
    wide, tall = np.ptp(outline, axis=0)
    reach = 0.16 * (max(wide, tall) if view["equal"] else wide)
    share = (tall + 2 * reach) / (wide + 2 * reach) if view["equal"] else 0.7
    fig, ax = plots.figure(height=plots.height_for(share))
    for mark, style in MARKS.items():
        p = _flat(sets[mark], view) * scale
        ax.plot(*p[:: len(p) // MOST_POINTS + 1].T, ".", mew=0, rasterized=True, **style)
    ax.plot(*outline.T, color=INK, lw=1.1)
    if len(crossings):
        ax.plot(*_flat(crossings, view).T, "D", ms=3.5, mew=1.1, mfc="none", color=GREEN)
    ax.set(xlabel=view["labels"][0], ylabel=view["labels"][1], title=view["title"])
    low, high = outline.min(0) - reach, outline.max(0) + reach
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    if view["equal"]:
        ax.set_aspect("equal")
    else:
        ax.set_ylim(-1e3 * EDGE_ON_M, 1e3 * EDGE_ON_M)
    return plots.to_svg(fig, name, f"{view['title']}: returns of a view against the target")


def _flat(points, view):
    return (np.asarray(points) @ view["turn"].T)[:, list(view["axes"])]
