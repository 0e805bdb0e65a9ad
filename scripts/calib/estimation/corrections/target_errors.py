"""What may be wrong about a target: its sizes, and where it sits in its MCS body."""

from dataclasses import replace

import numpy as np

from calib.estimation.corrections.correction import (
    FINITE_STEP_M,
    Correction,
    make_finite_difference,
)
from calib.estimation.corrections.number_wording import (
    MIN_SHOWN_SIGMAS,
    choose_by_sign,
    format_twist_sigma,
    format_value_sigma,
)
from calib.geometry.units import MM_PER_M, SHARE_TO_PERCENT

RELATIVE_STEP = 1e-6  # step of a finite difference
CORNER_KINDS, OUTLINE_KINDS = ("pattern_corner",), ("board_outline",)
MAX_TESTED_EDGES = 8  # of an outline whose edges are looked at one by one
MIN_BEND_SINE = 0.1  # sine of the least bend between two such edges


def _targets_with_attribute(setup, attribute):
    """(name, target) of the targets in use that are compared exactly and have an attribute."""
    used = sorted({setup.placements[g.placement].target for g in setup.groups})
    found = [(n, setup.targets[n]) for n in used]
    return [
        (n, t) for n, t in found if t.uses_exact_surface and getattr(t, attribute, None) is not None
    ]


def make_square_corrections(setup):
    """The size of a pattern about its own middle."""
    for name, target in _targets_with_attribute(setup, "pattern"):

        def change(view, theta):
            grown = view.target.pattern.with_scale(1 + theta[0])
            return {"target": replace(view.target, pattern=grown)}

        def told(theta, sigma, name=name, square=target.pattern.square_m):
            return (
                f"the squares of {name} are {format_value_sigma(theta[0], sigma[0], SHARE_TO_PERCENT, '%')} "
                f"{choose_by_sign(theta[0], 'larger', 'smaller')} than the config says: square_m "
                f"{square * (1 + theta[0]):.4g}, not {square:.4g}"
            )

        remedy = f"measure square_m of {name} with a calliper over several squares"
        yield Correction(
            "square_size",
            name,
            False,
            CORNER_KINDS,
            1,
            make_finite_difference(change, [RELATIVE_STEP]),
            told,
            remedy,
        )


def make_outline_corrections(setup):
    """The size of a board's outline about its middle, and each of its edges apart."""
    for name, target in _targets_with_attribute(setup, "vertices"):

        def scaled(view, theta):
            middle = view.target.centre[:2]
            vertices = middle + (1 + theta[0]) * (view.target.vertices - middle)
            return {"target": replace(view.target, vertices=vertices)}

        def of_size(theta, sigma, name=name):
            return (
                f"the outline of {name} is {format_value_sigma(theta[0], sigma[0], SHARE_TO_PERCENT, '%')} "
                f"{choose_by_sign(theta[0], 'larger', 'smaller')} than outline_m says"
            )

        def shifted(view, theta):
            vertices = _move_edges(view.target.vertices, theta)
            return {"target": replace(view.target, vertices=vertices)}

        def of_edges(theta, sigma, name=name):
            found = [
                f"edge {i + 1} {format_value_sigma(t, s, MM_PER_M, 'mm')} {choose_by_sign(t, 'outside', 'inside')}"
                for i, (t, s) in enumerate(zip(theta, sigma, strict=True))
                if abs(t) > min(MIN_SHOWN_SIGMAS * s, np.abs(theta).max() * (1 - RELATIVE_STEP))
            ]
            return (
                f"the outline of {name} is not where outline_m puts it: {', '.join(found)} "
                "(edge 1 joins its first two corners)"
            )

        remedy = f"measure the sides of {name} and its place in its frame for outline_m"
        yield Correction(
            "outline_size",
            name,
            False,
            OUTLINE_KINDS,
            1,
            make_finite_difference(scaled, [RELATIVE_STEP]),
            of_size,
            remedy,
        )
        n = len(target.vertices)
        if n <= MAX_TESTED_EDGES and _bend_sines(target.vertices).min() > MIN_BEND_SINE:
            steps = [FINITE_STEP_M] * n
            change = make_finite_difference(shifted, steps)
            yield Correction(
                "outline_edges", name, False, OUTLINE_KINDS, n, change, of_edges, remedy
            )


def _bend_sines(vertices):
    """Sine (n,) of the bend of an outline (n, 2) at each corner."""
    along = np.roll(vertices, -1, 0) - vertices
    along = along / np.linalg.norm(along, axis=1)[:, None]
    before = np.roll(along, 1, 0)
    return np.abs(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0])


def _move_edges(vertices, outwards):
    """The outline (n, 2) with edge i, from corner i to the next, moved outwards (n,), m."""
    along = np.roll(vertices, -1, 0) - vertices
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    x, y = vertices.T
    normal *= np.sign(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    offset = np.sum(normal * vertices, 1) + outwards
    pairs = np.stack([np.roll(normal, 1, 0), normal], 1)
    return np.linalg.solve(pairs, np.stack([np.roll(offset, 1), offset], 1)[..., None])[..., 0]


def make_cylinder_corrections(setup):
    """Radius and length of a cylinder."""
    for name, target in _targets_with_attribute(setup, "radius"):
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
                    f"the {what} of {name} is {format_value_sigma(theta[0], sigma[0], SHARE_TO_PERCENT, '%')} "
                    f"{choose_by_sign(theta[0], 'larger', 'smaller')} than the config says: {what}_m "
                    f"{size * (1 + theta[0]):.4g}, not {size:.4g}"
                )

            yield Correction(
                what,
                name,
                False,
                (),
                1,
                make_finite_difference(change, [RELATIVE_STEP]),
                told,
                remedy,
            )


def make_mount_corrections(setup):
    """Where a target sits in its MCS body, a right perturbation of T_body_target; where it is not
    estimated."""
    for name in (
        n for n, _ in _targets_with_attribute(setup, "name") if n not in setup.initial_mounts
    ):

        def told(theta, sigma, name=name):
            return (
                f"{name} does not sit in its MCS body where T_body_target says: along and about "
                f"the target's own x, y, z it is off by {format_twist_sigma(theta, sigma)}"
            )

        def joined(setup, name=name):
            T = next(p.T_body_target for p in setup.placements if p.target == name)
            return replace(setup, initial_mounts=setup.initial_mounts | {name: T})

        remedy = f"measure T_body_target of {name} again, or let it be estimated"
        yield Correction(
            "mount",
            name,
            False,
            (),
            6,
            lambda v: np.swapaxes(v.J_pose, 0, 1),
            told,
            remedy,
            as_free_mount=joined if name in setup.mount_sigma else None,
        )
