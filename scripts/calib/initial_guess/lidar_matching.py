"""The pose at which most placements have a candidate where their target was, correspondences
unknown."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.geometry import se3
from calib.initial_guess import lidar_candidates, pose_voting
from calib.initial_guess.frame_sampling import readable
from calib.initial_guess.pose_guess import Found

MOST = 4000  # pairs of candidates that poses are made from, the best fitting
FLOOR = 0.005, np.radians(0.3)  # σ of a candidate's centre and direction, at least
ALIKE = 0.05  # least share of three directions that lies across the first: below, a turn is open


@dataclass(frozen=True)
class Pairs:
    """Candidates and what each would be: centre (n, 3) and direction (n, 3) in the sensor's frame,
    place (n, 3) and axis (n, 3) in the robot's; group (n,), its placement; directed, signed (n,):
    whether the direction counts, and its sign."""

    centre: np.ndarray
    direction: np.ndarray
    place: np.ndarray
    axis: np.ndarray
    group: np.ndarray
    directed: np.ndarray
    signed: np.ndarray

    @classmethod
    def of(cls, rows):
        """From rows that `pair` makes."""
        empty = [np.zeros((0, 3))] * 4 + [np.zeros(0, int)] + [np.zeros(0, bool)] * 2
        return cls(*(np.array(c) for c in (zip(*rows, strict=True) if rows else empty)))


def pair(centre, direction, form, T_robot_target, group):
    """A row of Pairs: a candidate's centre and direction, and what it would be of a shape."""
    there = se3.transform(T_robot_target, form.centre)
    axis = T_robot_target[:3, :3] @ form.direction
    return centre, direction, there, axis, group, form.directed, form.signed


def matched(pairs, looked, what, options):
    """Found: the pose T_robot_sensor at which most of `looked` placements have a candidate."""
    tolerance, least = pose_voting.tolerance(options), options["min_placements"]
    groups = len(np.unique(pairs.group))
    T = hypotheses(pairs, tolerance)
    if len(T) == 0:
        return Found(status=pose_voting.refused(what, 0, 0, groups, looked, least))
    value = np.array([score(pairs, pose, tolerance) for pose in T])
    best = T[value.argmax()]
    apart = ~pose_voting.near(T, best, (2 * tolerance[0], 2 * tolerance[1]))
    rival = value[apart].max() if apart.any() else 0.0
    best, sigma, rows = refined(pairs, best, tolerance)
    if len(rows) < least or not pose_voting.decided(value.max(), rival):
        against = round(len(rows) * rival / value.max())
        return Found(status=pose_voting.refused(what, len(rows), against, groups, looked, least))
    if (sigma > np.repeat(tolerance, 3)).any():
        return Found(status=pose_voting.open_direction(what, len(rows), sigma))
    basis = f"{what} at {len(rows)} of {looked} placements, {groups} of them with a candidate"
    return Found(best, np.maximum(sigma, pose_voting.floor(options)), basis)


def hypotheses(pairs, tolerance):
    """T_robot_sensor (m, 4, 4) from all pairs of candidates that are to each other as their targets
    are, the MOST alike of them."""
    i, j = np.triu_indices(len(pairs.group), 1)
    other = pairs.group[i] != pairs.group[j]
    i, j = i[other], j[other]
    # Twice the tolerance for two candidates, each of which may be off by as much.
    unlike = np.abs(length(pairs.centre, i, j) - length(pairs.place, i, j)) / (2 * tolerance[0])
    i, j, unlike = (a[unlike < 1] for a in (i, j, unlike))
    turned = np.abs(lean(pairs, pairs.direction, i, j) - lean(pairs, pairs.axis, i, j))
    unlike = np.hypot(unlike, turned / (2 * tolerance[1]))
    order = np.argsort(unlike, kind="stable")[:MOST]
    order = order[unlike[order] < 1]
    signs = [(a, b) for a in (1, -1) for b in (1, -1)]
    return np.concatenate([poses(pairs, i[order], j[order], s, tolerance) for s in signs])


def length(points, i, j):
    """Distances (k,) between points i and j."""
    return np.linalg.norm(points[i] - points[j], axis=1)


def lean(pairs, directions, i, j):
    """Angles (k,), rad, between directions i and j; without a sign, of the lines; 0 without one."""
    cosine = np.sum(directions[i] * directions[j], 1)
    cosine = np.where(pairs.signed[i] & pairs.signed[j], cosine, np.abs(cosine))
    return np.arccos(np.clip(cosine, -1, 1)) * (pairs.directed[i] & pairs.directed[j])


def poses(pairs, i, j, signs, tolerance):
    """T_robot_sensor (m, 4, 4) that lay baseline and directions of candidates i and j on those of
    their targets, the directions with these signs; only where they fit and leave no turn open."""
    possible = (pairs.signed[i] <= (signs[0] > 0)) & (pairs.signed[j] <= (signs[1] > 0))
    i, j = i[possible], j[possible]
    far = length(pairs.place, i, j)
    weight = np.stack([np.minimum(far, 1), pairs.directed[i], pairs.directed[j]], 1)[..., None]
    there = np.stack([unit(pairs.place[j] - pairs.place[i]), pairs.axis[i], pairs.axis[j]], 1)
    seen = [unit(pairs.centre[j] - pairs.centre[i])]
    seen += [s * pairs.direction[k] for s, k in zip(signs, (i, j), strict=True)]
    seen = np.stack(seen, 1)
    u, s, vt = np.linalg.svd(np.swapaxes(weight * there, 1, 2) @ seen)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    R = u @ vt
    off = np.arccos(np.clip(np.sum(there * (seen @ np.swapaxes(R, 1, 2)), -1), -1, 1))
    slack = np.full_like(off, 2 * tolerance[1])
    slack[:, 0] += 2 * tolerance[0] / np.maximum(far, 1e-9)
    good = ((off < slack) | (weight[..., 0] == 0)).all(1) & (s[:, 1] > ALIKE * s[:, 0])
    middle = (pairs.place[i] + pairs.place[j]) / 2
    t = middle - (R @ ((pairs.centre[i] + pairs.centre[j]) / 2)[..., None])[..., 0]
    return se3.pose(R[good], t[good])


def unit(v):
    """Vectors (n, 3) of length one."""
    return v / np.maximum(np.linalg.norm(v, axis=1), 1e-12)[:, None]


def away(pairs, T, tolerance):
    """How far (n,) every candidate is from being its target at a pose, in tolerances."""
    shift = np.linalg.norm(se3.transform(T, pairs.centre) - pairs.place, axis=1)
    cosine = np.sum((pairs.direction @ T[:3, :3].T) * pairs.axis, 1)
    cosine = np.where(pairs.signed, cosine, np.abs(cosine))
    turn = np.arccos(np.clip(cosine, -1, 1)) * pairs.directed
    return np.hypot(shift / tolerance[0], turn / tolerance[1])


def score(pairs, T, tolerance):
    """Sum over the placements of what their best candidate says for a pose: 1 at best, 0 at the
    tolerance and beyond."""
    value = np.maximum(1 - away(pairs, T, tolerance) ** 2, 0)
    best = np.zeros(pairs.group.max() + 1)
    np.maximum.at(best, pairs.group, value)
    return best.sum()


def nearest(pairs, T, tolerance):
    """Row (k,) of the best candidate of every placement that has one within the tolerance."""
    off = away(pairs, T, tolerance)
    rows = [np.flatnonzero((pairs.group == g) & (off < 1)) for g in np.unique(pairs.group)]
    return np.array([r[off[r].argmin()] for r in rows if len(r)], int)


def refined(pairs, T, tolerance):
    """(T_robot_sensor (4, 4), σ (6,), rows of the candidates that agree) from a pose near it.

    σ from the scatter of centres and directions, which also narrows what agrees.
    """
    sigma, rows = np.full(6, np.inf), nearest(pairs, T, tolerance)
    scatter = np.array(tolerance) / 3
    for _ in range(6):
        rows = nearest(pairs, T, np.minimum(tolerance, 4 * scatter))
        if len(rows) < 2:
            break
        T, sigma, scatter = fitted(pairs, T, rows, scatter)
    return T, sigma, rows


def fitted(pairs, T, rows, scatter):
    """(T_robot_sensor (4, 4), its σ (6,), scatter (2,) of centres, m, and directions, rad)."""
    axis = pairs.axis[rows]
    turned = np.sum((pairs.direction[rows] @ T[:3, :3].T) * axis, 1)
    direction = np.where(turned < 0, -1, 1)[:, None] * pairs.direction[rows]

    def parts(x):
        moved = T @ se3.se3_exp(x)
        shift = se3.transform(moved, pairs.centre[rows]) - pairs.place[rows]
        turn = np.cross(direction @ moved[:3, :3].T, axis) * pairs.directed[rows, None]
        return shift, turn

    def residual(x):
        shift, turn = parts(x)
        return np.concatenate([shift / scatter[0], turn / scatter[1]]).reshape(-1)

    found = least_squares(residual, np.zeros(6), loss="soft_l1", x_scale="jac")
    # Shares of what the six unknowns take up, alike over both kinds.
    free = max(1 - 6 / (5 * len(rows)), 0.2)
    rms = [
        np.sqrt(np.mean(np.sum(p * p, 1)) / k / free)
        for p, k in zip(parts(found.x), (3, 2), strict=True)
    ]
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return T @ se3.se3_exp(found.x), np.sqrt(np.diag(covariance)), np.maximum(rms, FLOOR)


def find(lidar, shapes, looks, content_of, options):
    """Found: the pose at which most placements have a candidate where the target was."""
    forms = {n: lidar_candidates.Form.of(s) for n, s in shapes.items()}
    rows = []
    for number, (look, (xyz, _, _)) in enumerate(readable(looks, content_of)):
        points = lidar_candidates.thinned(lidar, xyz.astype(float))
        form, target = forms[look.target], shapes[look.target]
        for seen in lidar_candidates.find(lidar, target, form, points, options):
            rows.append(pair(*seen, form, look.T_robot_target, number))
    what = "a thing like the target"
    return matched(Pairs.of(rows), len(looks), what, options)
