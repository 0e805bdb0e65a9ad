"""How well measurements and model agree, sensor by sensor, as numbers to be judged."""

from dataclasses import replace

import numpy as np

from calib.diagnosis import observability
from calib.estimation import pose_chain
from calib.estimation.residuals import pattern_corner, residual_registry
from calib.geometry import se3

BEYOND = 3.0  # σ
OTHERWISE = 0.3  # of the misfit: a reading that fits by so much better is what was printed
OF_TARGET = ("corner", "edge")  # features are the target's; of other kinds the sensor's
UNIT = {"camera": "px", "lidar": "m"}
# What a measurement is that belongs to no part of its target: (admitted by the geometry but beyond
# the gate, with a positive or a negative residual; not admitted).
WHERE = {
    "cap": ("before the end", "behind the end", "off the end's rim or too flat"),
    "surface": ("before the surface", "behind the surface", "off the rim or too flat"),
    "edge": ("outside the outline", "inside the outline", "at a corner or along the scan"),
    "limb": ("outside the limb", "inside the limb", "near an end"),
    "corner": ("off its place", "off its place", "not told from others"),
}
ELSEWHERE = ("far from the target", "far from the target", "not looked at")


def counts(name, kind, setup, result):
    """Placements, observations and points used, share rejected, and the rms of what is left."""
    used, views, squares, candidates, members = set(), set(), [], 0, 0
    for g, a in own(name, setup, result):
        member = a.feature >= 0
        candidates += int(a.candidate.sum())
        members += int((member & a.candidate).sum())
        if member.any():
            used.add(g.placement)
            session = setup.placements[g.placement].session
            views |= {(session, int(v)) for v in np.unique(g.keypoints["view"][member])}
        if UNIT[kind] == residual_registry.KINDS[g.kind].UNIT:
            squares.append((a.value[member] ** 2).sum(1))
    squares = np.concatenate(squares) if squares else np.zeros(0)
    return {
        "placements": len(used),
        "observations": len(views),
        "points": members,
        "rejected": 1 - members / candidates if candidates else 0.0,
        "residual": {
            "rms": float(np.sqrt(squares.mean())) if len(squares) else None,
            "unit": UNIT[kind],
        },
        "left_out": left_out(name, setup, result),
    }


def own(name, setup, result):
    """[(Group, Assignment)] of one sensor, without views in motion."""
    both = zip(setup.groups, result.assigned, strict=True)
    return [(g, a) for g, a in both if g.sensor == name and not g.moving]


def left_out(name, setup, result):
    """[{target, kind, where, count, of}] of the measurements that are no members, by target; of:
    how many of that kind were handed on."""
    found, handed = {}, {}
    for g, a in own(name, setup, result):
        target = setup.placements[g.placement].target
        out, value = a.feature < 0, a.value[:, 0]
        parts = a.candidate & (value >= 0), a.candidate & (value < 0), ~a.candidate
        handed[target, g.kind] = handed.get((target, g.kind), 0) + len(out)
        for words, part in zip(WHERE.get(g.kind, ELSEWHERE), parts, strict=True):
            key = target, g.kind, words
            found[key] = found.get(key, 0) + int(np.sum(out & part))
    return [
        {"target": t, "kind": k, "where": where, "count": n, "of": handed[t, k]}
        for (t, k, where), n in sorted(found.items())
        if n
    ]


def fit(name, setup, result):
    """{kind: {rejected, noise_factor, common, beyond, whiteness}} of one sensor's measurements.

    rejected: share of those that the geometry admits and the gate does not; noise_factor: noise
    over what was configured; common: the share of its variance that all repetitions have in common;
    beyond: share of the residuals beyond 3 σ, where a normal has 0.27 %; whiteness: rms over rings,
    corners or sides of the mean residual of all placements, in the σ that independent placements
    give it. Nearest points follow no such noise and are left out.
    """
    out = {}
    found = {g.kind for g, _ in own(name, setup, result)}
    for kind in sorted(k for k in found if not residual_registry.by_nearest_point(k)):
        found = [(g, a) for g, a in own(name, setup, result) if g.kind == kind]
        noise = result.state.noise[name, kind]
        sizes = np.concatenate([np.abs(a.standard)[a.feature >= 0] for _, a in found])
        admitted = sum(int(a.candidate.sum()) for _, a in found)
        out[kind] = {
            "rejected": 1 - len(sizes) / admitted if admitted else 0.0,
            "noise_factor": noise.total,
            "common": noise.common**2 / noise.total**2,
            "beyond": float(np.mean(sizes > BEYOND)) if sizes.size else 0.0,
            "whiteness": whiteness(found),
        }
    return out


def misread(name, setup, result):
    """(target, its pattern, px, px) of a checkerboard of which no corner is a member: how far they
    lie from their places counted from a first square of the stated colour, and of the other, where
    that explains them by far; None otherwise."""
    for g, a in own(name, setup, result):
        target = setup.placements[g.placement].target
        pattern = setup.targets[target].pattern
        if g.kind == "corner" and not (a.feature >= 0).any() and hasattr(pattern, "first_square"):
            T = pose_chain.T_sensor_target(setup, result.state, name, g.placement)
            points = se3.transform(T, pattern.corners())
            uv, _ = pose_chain.model(setup, result.state, g).project(points)
            rows = np.flatnonzero(g.keypoints["view"] == g.keypoints["view"][0])
            either = pattern, replace(pattern, first_square=None)
            stated, free = (
                pattern_corner.readings(p, uv, g.keypoints, rows)[1].min() for p in either
            )
            if free < OTHERWISE * stated:
                return target, pattern, stated, free
    return None


def whiteness(found):
    """RMS of the mean residual of each feature over all placements, over its σ; 1 where placements
    are independent. found: [(Group, Assignment)] of one kind."""
    sums, weights = {}, {}
    for g, a in found:
        number = a.nearest if g.kind in OF_TARGET else g.keypoints["index"]
        for feature in np.unique(number[a.feature >= 0]).tolist():
            rows = (a.feature >= 0) & (number == feature)
            sums[feature] = sums.get(feature, 0.0) + a.weight[rows] @ a.standard[rows]
            weights[feature] = weights.get(feature, 0.0) + a.weight[rows].sum()
    means = [np.mean(sums[k] ** 2) / weights[k] for k in sums if weights[k] > 0]
    return float(np.sqrt(np.mean(means))) if means else 1.0


def correction(T_robot_sensor, guess):
    """Largest of the six numbers by which a pose (4, 4) differs from its guess.json, in the σ
    stated there; None without a guess."""
    if guess["T_robot_sensor"] is None:
        return None
    T_guess = np.array(guess["T_robot_sensor"]["matrix"])
    off = se3.se3_log(se3.inverse(T_guess) @ T_robot_sensor)
    return float((np.abs(off) / np.array(guess["sigma"])).max())


def seen(name, setup, result):
    """What directions the targets had (observability.axes) in the placements that a sensor used,
    and how many those are."""
    used = sorted({g.placement for g, a in own(name, setup, result) if (a.feature >= 0).any()})
    shapes = [setup.targets[setup.placements[k].target] for k in used]
    T = np.reshape([pose_chain.T_robot_target(setup, result.state, k) for k in used], (-1, 4, 4))
    return observability.axes(shapes, T), len(used)


def held_out(name, left):
    """What the others say of the placements of one sensor (crossvalidation.Left): rms of the
    errors, m and rad, their size over what both σ predict, and in how many directions."""
    found = [lf.held[name] for lf in left if name in lf.held]
    if not found:
        return None
    errors = np.stack([h.error for h in found])
    directions = sum(h.directions for h in found)
    return {
        "placements": len(found),
        "directions": directions,
        "rms_m": float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, 1)))),
        "rms_rad": float(np.sqrt(np.mean(np.sum(errors[:, 3:] ** 2, 1)))),
        "ratio": float(np.sqrt(sum(h.nees for h in found) / directions)),
    }


def influences(setup, left):
    """[{session, target, placement, sensors: {name: {influence, nees, directions}}}] of every
    placement left out; the influence is null where the rest determines the pose no more."""
    numbers = {g.placement: int(g.keypoints["placement"][0]) for g in setup.groups}
    out = []
    for lf in left:
        place = setup.placements[lf.placement]
        sensors = {}
        for name in lf.held or lf.influence:
            moved, held = lf.influence[name], lf.held.get(name)
            sensors[name] = {
                "influence": moved if np.isfinite(moved) else None,
                "nees": held.nees if held else None,
                "directions": held.directions if held else 0,
            }
        where = {"session": place.session, "target": place.target}
        out.append(where | {"placement": numbers[lf.placement], "sensors": sensors})
    return out
