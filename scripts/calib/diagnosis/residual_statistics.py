"""How well measurements and model agree, sensor by sensor, as numbers to be judged."""

from dataclasses import replace

import numpy as np

from calib.diagnosis.observability import normals_and_axes
from calib.estimation import pose_chain
from calib.estimation.pose_chain import T_sensor_target, model_with_corrections
from calib.estimation.residuals.pattern_corner import score_labellings
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points
from calib.geometry.se3 import invert_pose, se3_log, transform_points

TAIL_SIGMA = 3.0  # σ
MAX_FLIPPED_MISFIT_RATIO = (
    0.3  # of the misfit: a reading that fits by so much better is what was printed
)
TARGET_FEATURE_KINDS = (
    "pattern_corner",
    "board_outline",
)  # features are the target's; of other kinds the sensor's
UNIT_BY_SENSOR_KIND = {"camera": "px", "lidar": "m"}
# What a measurement is that belongs to no part of its target: (admitted by the geometry but beyond
# the gate, with a positive or a negative residual; not admitted).
REJECTION_REGIONS = {
    "cylinder_cap": ("before the end", "behind the end", "off the end's rim or too flat"),
    "target_surface": ("before the surface", "behind the surface", "off the rim or too flat"),
    "board_outline": ("outside the outline", "inside the outline", "at a corner or along the scan"),
    "cylinder_limb": ("outside the limb", "inside the limb", "near an end"),
    "pattern_corner": ("off its place", "off its place", "not told from others"),
}
DEFAULT_REJECTION_REGIONS = ("far from the target", "far from the target", "not looked at")


def usage_counts(sensor, sensor_kind, setup, result):
    """Placements, observations and points used, share rejected, and the rms of what is left."""
    used, views, squares, candidates, members = set(), set(), [], 0, 0
    for g, a in sensor_groups(sensor, setup, result):
        member = a.feature >= 0
        candidates += int(a.is_candidate.sum())
        members += int((member & a.is_candidate).sum())
        if member.any():
            used.add(g.placement)
            session = setup.placements[g.placement].session
            views |= {(session, int(v)) for v in np.unique(g.keypoints["view"][member])}
        if UNIT_BY_SENSOR_KIND[sensor_kind] == RESIDUAL_KINDS[g.kind].UNIT:
            squares.append((a.residual[member] ** 2).sum(1))
    squares = np.concatenate(squares) if squares else np.zeros(0)
    return {
        "placements": len(used),
        "observations": len(views),
        "points": members,
        "rejected_share": 1 - members / candidates if candidates else 0.0,
        "residual": {
            "rms": float(np.sqrt(squares.mean())) if len(squares) else None,
            "unit": UNIT_BY_SENSOR_KIND[sensor_kind],
        },
        "rejected_by_region": rejected_by_region(sensor, setup, result),
    }


def sensor_groups(sensor, setup, result):
    """[(Group, Assignment)] of one sensor, without views in motion."""
    both = zip(setup.groups, result.assignments, strict=True)
    return [(g, a) for g, a in both if g.sensor == sensor and not g.is_moving]


def rejected_by_region(sensor, setup, result):
    """[{target, kind, where, count, of}] of the measurements that are no members, by target; of:
    how many of that kind were handed on."""
    found, handed = {}, {}
    for g, a in sensor_groups(sensor, setup, result):
        target = setup.placements[g.placement].target
        out, value = a.feature < 0, a.residual[:, 0]
        parts = a.is_candidate & (value >= 0), a.is_candidate & (value < 0), ~a.is_candidate
        handed[target, g.kind] = handed.get((target, g.kind), 0) + len(out)
        for words, part in zip(
            REJECTION_REGIONS.get(g.kind, DEFAULT_REJECTION_REGIONS), parts, strict=True
        ):
            key = target, g.kind, words
            found[key] = found.get(key, 0) + int(np.sum(out & part))
    return [
        {"target": t, "kind": k, "region": where, "count": n, "n_measurements": handed[t, k]}
        for (t, k, where), n in sorted(found.items())
        if n
    ]


def fit_statistics(sensor, setup, result):
    """{kind: {rejected, noise_factor, common, beyond, whiteness}} of one sensor's measurements.

    rejected: share of those that the geometry admits and the gate does not; noise_factor: noise
    over what was configured; common: the share of its variance that all repetitions have in common;
    beyond: share of the residuals beyond 3 σ, where a normal has 0.27 %; whiteness: rms over rings,
    corners or sides of the mean residual of all placements, in the σ that independent placements
    give it. Nearest points follow no such noise and are left out.
    """
    out = {}
    found = {g.kind for g, _ in sensor_groups(sensor, setup, result)}
    for kind in sorted(k for k in found if not uses_template_points(k)):
        found = [(g, a) for g, a in sensor_groups(sensor, setup, result) if g.kind == kind]
        noise = result.state.noise[sensor, kind]
        sizes = np.concatenate([np.abs(a.standardized)[a.feature >= 0] for _, a in found])
        admitted = sum(int(a.is_candidate.sum()) for _, a in found)
        out[kind] = {
            "rejected_share": 1 - len(sizes) / admitted if admitted else 0.0,
            "noise_factor": noise.total,
            "common_variance_share": noise.common**2 / noise.total**2,
            "tail_share": float(np.mean(sizes > TAIL_SIGMA)) if sizes.size else 0.0,
            "systematic_ratio": systematic_residual_ratio(found),
        }
    return out


def find_flipped_pattern(sensor, setup, result):
    """(target, its pattern, px, px) of a checkerboard of which no corner is a member: how far they
    lie from their places counted from a first square of the stated colour, and of the other, where
    that explains them by far; None otherwise."""
    for g, a in sensor_groups(sensor, setup, result):
        target = setup.placements[g.placement].target
        pattern = setup.targets[target].pattern
        if (
            g.kind == "pattern_corner"
            and not (a.feature >= 0).any()
            and hasattr(pattern, "first_square")
        ):
            T = T_sensor_target(setup, result.state, sensor, g.placement)
            points = transform_points(T, pattern.corners())
            uv, _ = model_with_corrections(setup, result.state, g).project(points)
            rows = np.flatnonzero(g.keypoints["view"] == g.keypoints["view"][0])
            either = pattern, replace(pattern, first_square_color=None)
            stated, free = (score_labellings(p, uv, g.keypoints, rows)[1].min() for p in either)
            if free < MAX_FLIPPED_MISFIT_RATIO * stated:
                return target, pattern, stated, free
    return None


def systematic_residual_ratio(found):
    """RMS of the mean residual of each feature over all placements, over its σ; 1 where placements
    are independent. found: [(Group, Assignment)] of one kind."""
    sums, weights = {}, {}
    for g, a in found:
        number = (
            a.candidate_feature if g.kind in TARGET_FEATURE_KINDS else g.keypoints["feature_index"]
        )
        for feature in np.unique(number[a.feature >= 0]).tolist():
            rows = (a.feature >= 0) & (number == feature)
            sums[feature] = sums.get(feature, 0.0) + a.weight[rows] @ a.standardized[rows]
            weights[feature] = weights.get(feature, 0.0) + a.weight[rows].sum()
    means = [np.mean(sums[k] ** 2) / weights[k] for k in sums if weights[k] > 0]
    return float(np.sqrt(np.mean(means))) if means else 1.0


def guess_deviation_in_sigma(T_robot_sensor, guess):
    """Largest of the six numbers by which a pose (4, 4) differs from its guess.json, in the σ
    stated there; None without a guess."""
    if guess["T_robot_sensor"] is None:
        return None
    T_guess = np.array(guess["T_robot_sensor"]["matrix"])
    off = se3_log(invert_pose(T_guess) @ T_robot_sensor)
    return float((np.abs(off) / np.array(guess["sigma"])).max())


def target_directions(sensor, setup, result):
    """What directions the targets had (observability.axes) in the placements that a sensor used,
    and how many those are."""
    used = sorted(
        {g.placement for g, a in sensor_groups(sensor, setup, result) if (a.feature >= 0).any()}
    )
    shapes = [setup.targets[setup.placements[k].target] for k in used]
    T = np.reshape([pose_chain.T_robot_target(setup, result.state, k) for k in used], (-1, 4, 4))
    return normals_and_axes(shapes, T), len(used)


def leave_one_out_statistics(sensor, leave_one_outs):
    """What the others say of the placements of one sensor (crossvalidation.Left): rms of the
    errors, m and rad, their size over what both σ predict, and in how many directions."""
    found = [lf.error_by_sensor[sensor] for lf in leave_one_outs if sensor in lf.error_by_sensor]
    if not found:
        return None
    errors = np.stack([h.error for h in found])
    directions = sum(h.n_directions for h in found)
    return {
        "placements": len(found),
        "n_directions": directions,
        "rms_m": float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, 1)))),
        "rms_rad": float(np.sqrt(np.mean(np.sum(errors[:, 3:] ** 2, 1)))),
        "error_over_sigma": float(np.sqrt(sum(h.nees for h in found) / directions)),
    }


def influences_json(setup, leave_one_outs):
    """[{session, target, placement, sensors: {name: {influence, nees, directions}}}] of every
    placement left out; the influence is null where the rest determines the pose no more."""
    numbers = {g.placement: int(g.keypoints["placement"][0]) for g in setup.groups}
    out = []
    for lf in leave_one_outs:
        place = setup.placements[lf.placement]
        sensors = {}
        for name in lf.error_by_sensor or lf.influence_by_sensor:
            moved, held = lf.influence_by_sensor[name], lf.error_by_sensor.get(name)
            sensors[name] = {
                "influence": moved if np.isfinite(moved) else None,
                "nees": held.nees if held else None,
                "n_directions": held.n_directions if held else 0,
            }
        where = {"session": place.session, "target": place.target}
        out.append(where | {"placement": numbers[lf.placement], "sensors": sensors})
    return out
