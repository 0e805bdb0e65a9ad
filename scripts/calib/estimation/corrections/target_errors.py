"""What may be wrong about a target: its sizes, and where it sits in its MCS body."""

from dataclasses import replace

import numpy as np

from calib.estimation.corrections.correction import METRE, Hypothesis, differences
from calib.estimation.corrections.number_wording import MM, PERCENT, TOLD, by, shift, way

RELATIVE = 1e-6  # step of a finite difference
CORNERS, EDGES = ("corner",), ("edge",)
MOST_EDGES = 8  # of an outline whose edges are looked at one by one
BEND = 0.1  # sine of the least bend between two such edges


def _targets(setup, has):
    """(name, target) of the targets in use that are compared exactly and have an attribute."""
    used = sorted({setup.placements[g.placement].target for g in setup.groups})
    found = [(n, setup.targets[n]) for n in used]
    return [(n, t) for n, t in found if t.points is None and getattr(t, has, None) is not None]


def squares(setup):
    """The size of a pattern about its own middle."""
    for name, target in _targets(setup, "pattern"):

        def change(view, theta):
            grown = view.target.pattern.scaled(1 + theta[0])
            return {"target": replace(view.target, pattern=grown)}

        def told(theta, sigma, name=name, square=target.pattern.square):
            return (
                f"the squares of {name} are {by(theta[0], sigma[0], PERCENT, '%')} "
                f"{way(theta[0], 'larger', 'smaller')} than the config says: square_m "
                f"{square * (1 + theta[0]):.4g}, not {square:.4g}"
            )

        remedy = f"measure square_m of {name} with a calliper over several squares"
        yield Hypothesis(
            "squares", name, False, CORNERS, 1, differences(change, [RELATIVE]), told, remedy
        )


def outlines(setup):
    """The size of a board's outline about its middle, and each of its edges apart."""
    for name, target in _targets(setup, "vertices"):

        def scaled(view, theta):
            middle = view.target.centre[:2]
            vertices = middle + (1 + theta[0]) * (view.target.vertices - middle)
            return {"target": replace(view.target, vertices=vertices)}

        def of_size(theta, sigma, name=name):
            return (
                f"the outline of {name} is {by(theta[0], sigma[0], PERCENT, '%')} "
                f"{way(theta[0], 'larger', 'smaller')} than outline_m says"
            )

        def shifted(view, theta):
            vertices = _with_edges_moved(view.target.vertices, theta)
            return {"target": replace(view.target, vertices=vertices)}

        def of_edges(theta, sigma, name=name):
            found = [
                f"edge {i + 1} {by(t, s, MM, 'mm')} {way(t, 'outside', 'inside')}"
                for i, (t, s) in enumerate(zip(theta, sigma, strict=True))
                if abs(t) > min(TOLD * s, np.abs(theta).max() * (1 - RELATIVE))
            ]
            return (
                f"the outline of {name} is not where outline_m puts it: {', '.join(found)} "
                "(edge 1 joins its first two corners)"
            )

        remedy = f"measure the sides of {name} and its place in its frame for outline_m"
        yield Hypothesis(
            "outline", name, False, EDGES, 1, differences(scaled, [RELATIVE]), of_size, remedy
        )
        n = len(target.vertices)
        if n <= MOST_EDGES and _turns(target.vertices).min() > BEND:
            steps = [METRE] * n
            change = differences(shifted, steps)
            yield Hypothesis("edges", name, False, EDGES, n, change, of_edges, remedy)


def _turns(vertices):
    """Sine (n,) of the bend of an outline (n, 2) at each corner."""
    along = np.roll(vertices, -1, 0) - vertices
    along = along / np.linalg.norm(along, axis=1)[:, None]
    before = np.roll(along, 1, 0)
    return np.abs(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0])


def _with_edges_moved(vertices, outwards):
    """The outline (n, 2) with edge i, from corner i to the next, moved outwards (n,), m."""
    along = np.roll(vertices, -1, 0) - vertices
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    x, y = vertices.T
    normal *= np.sign(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    offset = np.sum(normal * vertices, 1) + outwards
    pairs = np.stack([np.roll(normal, 1, 0), normal], 1)
    return np.linalg.solve(pairs, np.stack([np.roll(offset, 1), offset], 1)[..., None])[..., 0]


def cylinders(setup):
    """Radius and length of a cylinder."""
    for name, target in _targets(setup, "radius"):
        for what, remedy in (
            ("radius", f"measure the circumference of {name}, radius_m is it over 2π"),
            ("length", f"measure length_m of {name}"),
        ):
            now = vars(target)[what]

            def change(view, theta, what=what):
                size = getattr(view.target, what) * (1 + theta[0])
                return {"target": replace(view.target, **{what: size})}

            def told(theta, sigma, name=name, what=what, size=now):
                return (
                    f"the {what} of {name} is {by(theta[0], sigma[0], PERCENT, '%')} "
                    f"{way(theta[0], 'larger', 'smaller')} than the config says: {what}_m "
                    f"{size * (1 + theta[0]):.4g}, not {size:.4g}"
                )

            yield Hypothesis(
                what, name, False, (), 1, differences(change, [RELATIVE]), told, remedy
            )


def frames(setup):
    """Where a target sits in its MCS body, a right perturbation of T_body_target; where it is not
    estimated."""
    for name in (n for n, _ in _targets(setup, "name") if n not in setup.mounts):

        def told(theta, sigma, name=name):
            return (
                f"{name} does not sit in its MCS body where T_body_target says: along and about "
                f"the target's own x, y, z it is off by {shift(theta, sigma)}"
            )

        def joined(setup, name=name):
            T = next(p.T_body_target for p in setup.placements if p.target == name)
            return replace(setup, mounts=setup.mounts | {name: T})

        remedy = f"measure T_body_target of {name} again, or let it be estimated"
        yield Hypothesis(
            "frame",
            name,
            False,
            (),
            6,
            lambda v: np.swapaxes(v.J, 0, 1),
            told,
            remedy,
            joined=joined if name in setup.alignment else None,
        )
