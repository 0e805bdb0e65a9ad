"""Find the pose of a lidar at which most placements have a candidate where their target was.

Which candidate is the target is unknown: poses are made from all pairs of candidates, and scored.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import make_pose, transform_points
from calib.initial_guess.candidate_matches import (
    CandidateMatch,
    CandidateMatches,
    fit_match_pose,
    make_match,
)
from calib.initial_guess.initial_guess import PoseGuess
from calib.initial_guess.lidar_candidates import ShapeSignature, find_candidates, thin_scan
from calib.initial_guess.pose_voting import (
    PoseTolerance,
    SearchCounts,
    is_decisive,
    is_near_pose,
    min_pose_sigma,
    no_consensus_status,
    too_few_samples_status,
    undetermined_pose_status,
)
from calib.io.status import OK, Status
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import TargetShape
from calib.views.initial_guess_frames import FrameSample, read_samples
from calib.views.sensor_croppers import FrameReader

CANDIDATE_DESCRIPTION = "a thing like the target"
MAX_MATCH_PAIRS = 4000  # best pairs of candidates that poses are made from
# Smallest share of three directions across the first one. Below it, a rotation is undetermined.
MIN_CROSS_SHARE = 0.05
N_REFINEMENT_ROUNDS = 6


class _AlignedVectors(NamedTuple):
    """Rotations R (m, 3, 3), angles (m, k) that are left, and whether R is determined (m,)."""

    R: np.ndarray
    angle: np.ndarray
    is_determined: np.ndarray


class RefinedPose(NamedTuple):
    """T_robot_sensor (4, 4), its σ (6,), and the rows of the candidates that agree."""

    T_robot_sensor: np.ndarray
    sigma: np.ndarray
    rows: np.ndarray


def find_lidar_pose(
    lidar: LidarModel,
    targets: Mapping[str, TargetShape],
    samples: list[FrameSample],
    read_frame: FrameReader,
    options: dict[str, Any],
) -> PoseGuess:
    """Search T_robot_lidar at which most placements have a candidate where the target was.

    options: block `guess`.
    """
    signatures = {name: ShapeSignature.from_target(target) for name, target in targets.items()}
    rows: list[CandidateMatch] = []
    for number, (sample, scan) in enumerate(read_samples(samples, read_frame)):
        target, signature = targets[sample.target], signatures[sample.target]
        points = thin_scan(lidar, scan.xyz.astype(float))
        for candidate in find_candidates(lidar, target, signature, points, options):
            rows.append(make_match(candidate, signature, sample.T_robot_target, number))
    matches = CandidateMatches.from_rows(rows)
    return match_pose(matches, len(samples), CANDIDATE_DESCRIPTION, options)


def check_lidar_samples(
    targets: Mapping[str, TargetShape], sampled_targets: Sequence[str], options: dict[str, Any]
) -> Status:
    """Return ok if there are enough placements to search a lidar's pose in (SampleCheck)."""
    n_required = options["min_placements"]
    if len(sampled_targets) >= n_required:
        return OK
    return too_few_samples_status("target", len(sampled_targets), n_required)


def match_pose(
    matches: CandidateMatches, n_searched: int, description: str, options: dict[str, Any]
) -> PoseGuess:
    """Return the pose at which most of n_searched placements have a candidate."""
    tolerance, n_required = PoseTolerance.from_options(options), options["min_placements"]
    n_found = len(np.unique(matches.placement))
    T = hypothesize_poses(matches, tolerance)
    score = np.array([score_pose(matches, pose, tolerance) for pose in T])
    if score.max(initial=0.0) == 0:
        counts = SearchCounts(0, 0, n_found, n_searched, n_required)
        return PoseGuess(status=no_consensus_status(description, counts))
    best = T[score.argmax()]
    is_rival = ~is_near_pose(T, best, tolerance.scaled(2))
    rival_score = score[is_rival].max() if is_rival.any() else 0.0
    pose = refine_match_pose(matches, best, tolerance)
    n_agreeing = len(pose.rows)
    if n_agreeing < n_required or not is_decisive(score.max(), rival_score):
        n_rival_votes = round(n_agreeing * rival_score / score.max())
        counts = SearchCounts(n_agreeing, n_rival_votes, n_found, n_searched, n_required)
        return PoseGuess(status=no_consensus_status(description, counts))
    if (pose.sigma > np.repeat(tolerance, 3)).any():
        return PoseGuess(status=undetermined_pose_status(description, n_agreeing, pose.sigma))
    basis = (
        f"{description} at {n_agreeing} of {n_searched} placements, {n_found} of them with a "
        "candidate"
    )
    return PoseGuess(pose.T_robot_sensor, np.maximum(pose.sigma, min_pose_sigma(options)), basis)


def hypothesize_poses(matches: CandidateMatches, tolerance: PoseTolerance) -> np.ndarray:
    """Return T_robot_sensor (m, 4, 4) from the pairs of candidates most like their targets.

    Compared are the distance of a pair and the angle between its directions.
    """
    i, j = np.triu_indices(len(matches.placement), 1)
    is_other_placement = matches.placement[i] != matches.placement[j]
    i, j = i[is_other_placement], j[is_other_placement]
    # Twice the tolerance for two candidates, each of which may be off by as much.
    misfit = np.abs(
        pair_distances(matches.centre, i, j) - pair_distances(matches.target_centre, i, j)
    ) / (2 * tolerance.shift_m)
    is_alike = misfit < 1
    i, j, misfit = i[is_alike], j[is_alike], misfit[is_alike]
    angle_error = np.abs(
        angle_between(matches, matches.direction, i, j)
        - angle_between(matches, matches.target_direction, i, j)
    )
    misfit = np.hypot(misfit, angle_error / (2 * tolerance.turn_rad))
    order = np.argsort(misfit, kind="stable")[:MAX_MATCH_PAIRS]
    order = order[misfit[order] < 1]
    signs = [(a, b) for a in (1, -1) for b in (1, -1)]
    return np.concatenate(
        [align_match_pairs(matches, i[order], j[order], s, tolerance) for s in signs]
    )


def pair_distances(points: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Return the distances (k,) between points i and j."""
    return np.linalg.norm(points[i] - points[j], axis=1)


def angle_between(
    matches: CandidateMatches, directions: np.ndarray, i: np.ndarray, j: np.ndarray
) -> np.ndarray:
    """Return the angles (k,), rad, between directions i and j.

    Between lines if a sign is unknown, and 0 if a direction is unknown.
    """
    cosine = np.sum(directions[i] * directions[j], 1)
    cosine = np.where(matches.has_sign[i] & matches.has_sign[j], cosine, np.abs(cosine))
    return np.arccos(np.clip(cosine, -1, 1)) * (matches.has_direction[i] & matches.has_direction[j])


def align_match_pairs(
    matches: CandidateMatches,
    i: np.ndarray,
    j: np.ndarray,
    signs: tuple[int, int],
    tolerance: PoseTolerance,
) -> np.ndarray:
    """Return T_robot_sensor (m, 4, 4) that align pairs of candidates with their targets.

    The baseline and the directions, with these signs, of candidates i and j are aligned. Pairs that
    do not fit, or leave a rotation undetermined, are left out.
    """
    is_possible = (matches.has_sign[i] <= (signs[0] > 0)) & (matches.has_sign[j] <= (signs[1] > 0))
    i, j = i[is_possible], j[is_possible]
    baseline = pair_distances(matches.target_centre, i, j)
    weight = np.stack(
        [np.minimum(baseline, 1), matches.has_direction[i], matches.has_direction[j]], 1
    )[..., None]
    expected = [
        normalize_vectors(matches.target_centre[j] - matches.target_centre[i]),
        matches.target_direction[i],
        matches.target_direction[j],
    ]
    measured = [
        normalize_vectors(matches.centre[j] - matches.centre[i]),
        signs[0] * matches.direction[i],
        signs[1] * matches.direction[j],
    ]
    rotation = _align_vectors(np.stack(expected, 1), np.stack(measured, 1), weight)
    max_angle = np.full_like(rotation.angle, 2 * tolerance.turn_rad)
    max_angle[:, 0] += 2 * tolerance.shift_m / np.maximum(baseline, 1e-9)
    is_fitting = ((rotation.angle < max_angle) | (weight[..., 0] == 0)).all(1)
    is_fitting &= rotation.is_determined
    target_middle = (matches.target_centre[i] + matches.target_centre[j]) / 2
    sensor_middle = (matches.centre[i] + matches.centre[j]) / 2
    t = target_middle - (rotation.R @ sensor_middle[..., None])[..., 0]
    return make_pose(rotation.R[is_fitting], t[is_fitting])


def _align_vectors(
    expected: np.ndarray, measured: np.ndarray, weight: np.ndarray
) -> _AlignedVectors:
    """Rotate k measured unit vectors (m, k, 3) onto the expected ones by the Kabsch algorithm."""
    u, s, vt = np.linalg.svd(np.swapaxes(weight * expected, 1, 2) @ measured)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    R = u @ vt
    rotated = measured @ np.swapaxes(R, 1, 2)
    angle = np.arccos(np.clip(np.sum(expected * rotated, -1), -1, 1))
    return _AlignedVectors(R, angle, s[:, 1] > MIN_CROSS_SHARE * s[:, 0])


def normalize_vectors(v: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) of length one."""
    return v / np.maximum(np.linalg.norm(v, axis=1), 1e-12)[:, None]


def distance_in_tolerances(
    matches: CandidateMatches, T: np.ndarray, tolerance: PoseTolerance
) -> np.ndarray:
    """Return how far (n,) every candidate is from its target at a pose (4, 4), in tolerances."""
    shift = np.linalg.norm(transform_points(T, matches.centre) - matches.target_centre, axis=1)
    cosine = np.sum((matches.direction @ T[:3, :3].T) * matches.target_direction, 1)
    cosine = np.where(matches.has_sign, cosine, np.abs(cosine))
    turn = np.arccos(np.clip(cosine, -1, 1)) * matches.has_direction
    return np.hypot(shift / tolerance.shift_m, turn / tolerance.turn_rad)


def score_pose(matches: CandidateMatches, T: np.ndarray, tolerance: PoseTolerance) -> float:
    """Return the sum of the scores of each placement's best candidate at a pose (4, 4).

    A score is 1 at best, and 0 at the tolerance and beyond.
    """
    score = np.maximum(1 - distance_in_tolerances(matches, T, tolerance) ** 2, 0)
    best = np.zeros(matches.placement.max() + 1)
    np.maximum.at(best, matches.placement, score)
    return best.sum()


def select_best_matches(
    matches: CandidateMatches, T: np.ndarray, tolerance: PoseTolerance
) -> np.ndarray:
    """Return the row (k,) of each placement's best candidate, within the tolerance."""
    distance = distance_in_tolerances(matches, T, tolerance)
    rows = [
        np.flatnonzero((matches.placement == g) & (distance < 1))
        for g in np.unique(matches.placement)
    ]
    return np.array([r[distance[r].argmin()] for r in rows if len(r)], int)


def refine_match_pose(
    matches: CandidateMatches, T: np.ndarray, tolerance: PoseTolerance
) -> RefinedPose:
    """Refine a pose (4, 4) with the candidates that agree.

    The scatter of their centres and directions gives σ, and narrows the tolerance.
    """
    sigma, rows = np.full(6, np.inf), select_best_matches(matches, T, tolerance)
    scatter = np.array(tolerance) / 3
    for _ in range(N_REFINEMENT_ROUNDS):
        narrowed = PoseTolerance(*np.minimum(tolerance, 4 * scatter))
        rows = select_best_matches(matches, T, narrowed)
        if len(rows) < 2:
            break
        T, sigma, scatter = fit_match_pose(matches, T, rows, scatter)
    return RefinedPose(T, sigma, rows)
