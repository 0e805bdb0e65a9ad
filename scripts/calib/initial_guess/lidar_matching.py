"""The pose at which most placements have a candidate where their target was, correspondences
unknown."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib.geometry.se3 import make_pose, se3_exp, transform_points
from calib.initial_guess.frame_sampling import read_samples
from calib.initial_guess.lidar_candidates import ShapeSignature, find_candidates, thin_scan
from calib.initial_guess.pose_guess import PoseGuess
from calib.initial_guess.pose_voting import (
    agreement_tolerance,
    is_decisive,
    is_near_pose,
    min_pose_sigma,
    no_consensus_status,
    undetermined_pose_status,
)

MAX_MATCH_PAIRS = 4000  # pairs of candidates that poses are made from, the best fitting
MIN_MATCH_SCATTER = 0.005, np.radians(0.3)  # σ of a candidate's centre and direction, at least
MIN_CROSS_SHARE = (
    0.05  # least share of three directions that lies across the first: below, a turn is open
)


@dataclass(frozen=True)
class CandidateMatches:
    """Candidates and what each would be: centre (n, 3) and direction (n, 3) in the sensor's frame,
    place (n, 3) and axis (n, 3) in the robot's; group (n,), its placement; directed, signed (n,):
    whether the direction counts, and its sign."""

    centre: np.ndarray
    direction: np.ndarray
    target_centre: np.ndarray
    target_direction: np.ndarray
    placement: np.ndarray
    has_direction: np.ndarray
    has_sign: np.ndarray

    @classmethod
    def from_rows(cls, rows):
        """From rows that `pair` makes."""
        empty = [np.zeros((0, 3))] * 4 + [np.zeros(0, int)] + [np.zeros(0, bool)] * 2
        return cls(*(np.array(c) for c in (zip(*rows, strict=True) if rows else empty)))


def make_match(centre, direction, signature, T_robot_target, placement):
    """A row of Pairs: a candidate's centre and direction, and what it would be of a shape."""
    there = transform_points(T_robot_target, signature.centre)
    axis = T_robot_target[:3, :3] @ signature.direction
    return centre, direction, there, axis, placement, signature.has_direction, signature.has_sign


def match_pose(matches, n_samples, description, options):
    """Found: the pose T_robot_sensor at which most of `looked` placements have a candidate."""
    tolerance, least = agreement_tolerance(options), options["min_placements"]
    groups = len(np.unique(matches.placement))
    T = hypothesize_poses(matches, tolerance)
    if len(T) == 0:
        return PoseGuess(status=no_consensus_status(description, 0, 0, groups, n_samples, least))
    value = np.array([score_pose(matches, pose, tolerance) for pose in T])
    best = T[value.argmax()]
    apart = ~is_near_pose(T, best, (2 * tolerance[0], 2 * tolerance[1]))
    rival = value[apart].max() if apart.any() else 0.0
    best, sigma, rows = refine_match_pose(matches, best, tolerance)
    if len(rows) < least or not is_decisive(value.max(), rival):
        against = round(len(rows) * rival / value.max())
        return PoseGuess(
            status=no_consensus_status(description, len(rows), against, groups, n_samples, least)
        )
    if (sigma > np.repeat(tolerance, 3)).any():
        return PoseGuess(status=undetermined_pose_status(description, len(rows), sigma))
    basis = (
        f"{description} at {len(rows)} of {n_samples} placements, {groups} of them with a candidate"
    )
    return PoseGuess(best, np.maximum(sigma, min_pose_sigma(options)), basis)


def hypothesize_poses(matches, tolerance):
    """T_robot_sensor (m, 4, 4) from all pairs of candidates that are to each other as their targets
    are, the MOST alike of them."""
    i, j = np.triu_indices(len(matches.placement), 1)
    other = matches.placement[i] != matches.placement[j]
    i, j = i[other], j[other]
    # Twice the tolerance for two candidates, each of which may be off by as much.
    unlike = np.abs(
        pair_distances(matches.centre, i, j) - pair_distances(matches.target_centre, i, j)
    ) / (2 * tolerance[0])
    i, j, unlike = (a[unlike < 1] for a in (i, j, unlike))
    turned = np.abs(
        angle_between(matches, matches.direction, i, j)
        - angle_between(matches, matches.target_direction, i, j)
    )
    unlike = np.hypot(unlike, turned / (2 * tolerance[1]))
    order = np.argsort(unlike, kind="stable")[:MAX_MATCH_PAIRS]
    order = order[unlike[order] < 1]
    signs = [(a, b) for a in (1, -1) for b in (1, -1)]
    return np.concatenate(
        [align_match_pairs(matches, i[order], j[order], s, tolerance) for s in signs]
    )


def pair_distances(points, i, j):
    """Distances (k,) between points i and j."""
    return np.linalg.norm(points[i] - points[j], axis=1)


def angle_between(matches, directions, i, j):
    """Angles (k,), rad, between directions i and j; without a sign, of the lines; 0 without one."""
    cosine = np.sum(directions[i] * directions[j], 1)
    cosine = np.where(matches.has_sign[i] & matches.has_sign[j], cosine, np.abs(cosine))
    return np.arccos(np.clip(cosine, -1, 1)) * (matches.has_direction[i] & matches.has_direction[j])


def align_match_pairs(matches, i, j, signs, tolerance):
    """T_robot_sensor (m, 4, 4) that lay baseline and directions of candidates i and j on those of
    their targets, the directions with these signs; only where they fit and leave no turn open."""
    possible = (matches.has_sign[i] <= (signs[0] > 0)) & (matches.has_sign[j] <= (signs[1] > 0))
    i, j = i[possible], j[possible]
    far = pair_distances(matches.target_centre, i, j)
    weight = np.stack([np.minimum(far, 1), matches.has_direction[i], matches.has_direction[j]], 1)[
        ..., None
    ]
    there = np.stack(
        [
            normalize_vectors(matches.target_centre[j] - matches.target_centre[i]),
            matches.target_direction[i],
            matches.target_direction[j],
        ],
        1,
    )
    seen = [normalize_vectors(matches.centre[j] - matches.centre[i])]
    seen += [s * matches.direction[k] for s, k in zip(signs, (i, j), strict=True)]
    seen = np.stack(seen, 1)
    u, s, vt = np.linalg.svd(np.swapaxes(weight * there, 1, 2) @ seen)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    R = u @ vt
    off = np.arccos(np.clip(np.sum(there * (seen @ np.swapaxes(R, 1, 2)), -1), -1, 1))
    slack = np.full_like(off, 2 * tolerance[1])
    slack[:, 0] += 2 * tolerance[0] / np.maximum(far, 1e-9)
    good = ((off < slack) | (weight[..., 0] == 0)).all(1) & (s[:, 1] > MIN_CROSS_SHARE * s[:, 0])
    middle = (matches.target_centre[i] + matches.target_centre[j]) / 2
    t = middle - (R @ ((matches.centre[i] + matches.centre[j]) / 2)[..., None])[..., 0]
    return make_pose(R[good], t[good])


def normalize_vectors(v):
    """Vectors (n, 3) of length one."""
    return v / np.maximum(np.linalg.norm(v, axis=1), 1e-12)[:, None]


def distance_in_tolerances(matches, T, tolerance):
    """How far (n,) every candidate is from being its target at a pose, in tolerances."""
    shift = np.linalg.norm(transform_points(T, matches.centre) - matches.target_centre, axis=1)
    cosine = np.sum((matches.direction @ T[:3, :3].T) * matches.target_direction, 1)
    cosine = np.where(matches.has_sign, cosine, np.abs(cosine))
    turn = np.arccos(np.clip(cosine, -1, 1)) * matches.has_direction
    return np.hypot(shift / tolerance[0], turn / tolerance[1])


def score_pose(matches, T, tolerance):
    """Sum over the placements of what their best candidate says for a pose: 1 at best, 0 at the
    tolerance and beyond."""
    value = np.maximum(1 - distance_in_tolerances(matches, T, tolerance) ** 2, 0)
    best = np.zeros(matches.placement.max() + 1)
    np.maximum.at(best, matches.placement, value)
    return best.sum()


def select_best_matches(matches, T, tolerance):
    """Row (k,) of the best candidate of every placement that has one within the tolerance."""
    off = distance_in_tolerances(matches, T, tolerance)
    rows = [
        np.flatnonzero((matches.placement == g) & (off < 1)) for g in np.unique(matches.placement)
    ]
    return np.array([r[off[r].argmin()] for r in rows if len(r)], int)


def refine_match_pose(matches, T, tolerance):
    """(T_robot_sensor (4, 4), σ (6,), rows of the candidates that agree) from a pose near it.

    σ from the scatter of centres and directions, which also narrows what agrees.
    """
    sigma, rows = np.full(6, np.inf), select_best_matches(matches, T, tolerance)
    scatter = np.array(tolerance) / 3
    for _ in range(6):
        rows = select_best_matches(matches, T, np.minimum(tolerance, 4 * scatter))
        if len(rows) < 2:
            break
        T, sigma, scatter = fit_match_pose(matches, T, rows, scatter)
    return T, sigma, rows


def fit_match_pose(matches, T, rows, scatter):
    """(T_robot_sensor (4, 4), its σ (6,), scatter (2,) of centres, m, and directions, rad)."""
    axis = matches.target_direction[rows]
    turned = np.sum((matches.direction[rows] @ T[:3, :3].T) * axis, 1)
    direction = np.where(turned < 0, -1, 1)[:, None] * matches.direction[rows]

    def parts(x):
        moved = T @ se3_exp(x)
        shift = transform_points(moved, matches.centre[rows]) - matches.target_centre[rows]
        turn = np.cross(direction @ moved[:3, :3].T, axis) * matches.has_direction[rows, None]
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
    return T @ se3_exp(found.x), np.sqrt(np.diag(covariance)), np.maximum(rms, MIN_MATCH_SCATTER)


def find_lidar_pose(lidar, targets, samples, read_frame, options):
    """Found: the pose at which most placements have a candidate where the target was."""
    forms = {n: ShapeSignature.from_target(s) for n, s in targets.items()}
    rows = []
    for number, (look, (xyz, _, _)) in enumerate(read_samples(samples, read_frame)):
        points = thin_scan(lidar, xyz.astype(float))
        form, target = forms[look.target], targets[look.target]
        for seen in find_candidates(lidar, target, form, points, options):
            rows.append(make_match(*seen, form, look.T_robot_target, number))
    what = "a thing like the target"
    return match_pose(CandidateMatches.from_rows(rows), len(samples), what, options)
