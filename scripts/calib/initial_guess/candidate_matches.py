"""Candidates in scans matched with targets at known poses, and the pose that fits them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.geometry.se3 import se3_exp, transform_points
from calib.initial_guess.lidar_candidates import ShapeSignature, TargetCandidate
from calib.initial_guess.pose_voting import PoseTolerance

MIN_MATCH_SCATTER = PoseTolerance(0.005, np.radians(0.3))  # σ of centre and direction


class CandidateMatch(NamedTuple):
    """A candidate as a certain target; a row of CandidateMatches."""

    centre: np.ndarray
    direction: np.ndarray
    target_centre: np.ndarray
    target_direction: np.ndarray
    placement: int
    has_direction: bool
    has_sign: bool


@dataclass(frozen=True)
class CandidateMatches:
    """Candidates, each as the target of its placement.

    centre, direction: (n, 3), sensor frame. target_centre, target_direction: (n, 3), robot frame.
    placement: (n,). has_direction, has_sign: (n,) whether the direction counts, and its sign.
    """

    centre: np.ndarray
    direction: np.ndarray
    target_centre: np.ndarray
    target_direction: np.ndarray
    placement: np.ndarray
    has_direction: np.ndarray
    has_sign: np.ndarray

    @classmethod
    def from_rows(cls, rows: list[CandidateMatch]) -> "CandidateMatches":
        """Stack rows that make_match returns."""
        if rows:
            return cls(*(np.array(column) for column in zip(*rows, strict=True)))
        vectors, flags = np.zeros((0, 3)), np.zeros(0, bool)
        return cls(vectors, vectors, vectors, vectors, np.zeros(0, int), flags, flags)


class MatchFit(NamedTuple):
    """T_robot_sensor (4, 4), its σ (6,), and the scatter of centres, m, and directions, rad."""

    T_robot_sensor: np.ndarray
    sigma: np.ndarray
    scatter: np.ndarray


def make_match(
    candidate: TargetCandidate,
    signature: ShapeSignature,
    T_robot_target: np.ndarray,
    placement: int,
) -> CandidateMatch:
    """Match a candidate with the target of a placement at T_robot_target (4, 4)."""
    return CandidateMatch(
        centre=candidate.centre,
        direction=candidate.direction,
        target_centre=transform_points(T_robot_target, signature.centre),
        target_direction=T_robot_target[:3, :3] @ signature.direction,
        placement=placement,
        has_direction=signature.has_direction,
        has_sign=signature.has_sign,
    )


def fit_match_pose(
    matches: CandidateMatches, T: np.ndarray, rows: np.ndarray, scatter: np.ndarray
) -> MatchFit:
    """Fit the pose to the candidates in some rows by robust least squares, from a pose near it.

    scatter: (2,) σ of centres, m, and directions, rad.
    """
    target_direction = matches.target_direction[rows]
    cosine = np.sum((matches.direction[rows] @ T[:3, :3].T) * target_direction, 1)
    direction = np.where(cosine < 0, -1, 1)[:, None] * matches.direction[rows]

    def errors(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T_moved = T @ se3_exp(xi)
        shift = transform_points(T_moved, matches.centre[rows]) - matches.target_centre[rows]
        turn = np.cross(direction @ T_moved[:3, :3].T, target_direction)
        return shift, turn * matches.has_direction[rows, None]

    def residual(xi: np.ndarray) -> np.ndarray:
        shift, turn = errors(xi)
        return np.concatenate([shift / scatter[0], turn / scatter[1]]).reshape(-1)

    fit = least_squares(residual, np.zeros(6), loss="soft_l1", x_scale="jac")
    # Degrees of freedom that the six unknowns take, shared by both kinds of error.
    free_share = max(1 - 6 / (5 * len(rows)), 0.2)
    rms = [
        np.sqrt(np.mean(np.sum(error * error, 1)) / n / free_share)
        for error, n in zip(errors(fit.x), (3, 2), strict=True)
    ]
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    return MatchFit(
        T_robot_sensor=T @ se3_exp(fit.x),
        sigma=np.sqrt(np.diag(covariance)),
        scatter=np.maximum(rms, MIN_MATCH_SCATTER),
    )
