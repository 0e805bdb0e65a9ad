"""Find the pose that most placements agree on, and whether it can be trusted."""

from typing import Any, NamedTuple

import numpy as np

from calib.geometry.se3 import invert_pose, mean_pose, se3_log
from calib.io.pose_block import pose_sigma_from_config
from calib.io.status import Status, failure_status

MAX_RIVAL_SHARE = 0.75  # of another pose's votes in those of the best pose
N_VOTE_ROUNDS = 5


class PoseTolerance(NamedTuple):
    """Within which two placements agree on a pose, m and rad."""

    shift_m: float
    turn_rad: float

    @classmethod
    def from_options(cls, options: dict[str, Any]) -> "PoseTolerance":
        """Make it from the block `guess`."""
        tolerance = options["tolerance"]
        return cls(tolerance["xyz_m"], np.radians(tolerance["rpy_deg"]))

    def scaled(self, factor: float) -> "PoseTolerance":
        return PoseTolerance(factor * self.shift_m, factor * self.turn_rad)


class PoseVote(NamedTuple):
    """One hypothesis (row) per group that agrees (k,), and the votes of the best other pose."""

    rows: np.ndarray
    n_rival_votes: int


class SearchCounts(NamedTuple):
    """Placements of a search.

    n_agreeing: that agree on the best pose; n_rival_votes: on the best other pose; n_found: where
    something was found; n_searched: all; n_required: that must agree.
    """

    n_agreeing: int
    n_rival_votes: int
    n_found: int
    n_searched: int
    n_required: int


def is_near_pose(A: np.ndarray, B: np.ndarray, tolerance: PoseTolerance) -> np.ndarray:
    """Return whether poses A and B (..., 4, 4) differ by less than the tolerance, broadcast."""
    shift = np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1)
    cosine = (np.einsum("...ij,...ij", A[..., :3, :3], B[..., :3, :3]) - 1) / 2
    return (shift < tolerance.shift_m) & (cosine > np.cos(min(tolerance.turn_rad, np.pi)))


def count_votes(is_close: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the number (m,) of groups with at least one close hypothesis.

    is_close: (m, n). group: (n,) of each hypothesis.
    """
    return np.sum([is_close[:, group == g].any(1) for g in np.unique(group)], axis=0, dtype=int)


def vote_for_pose(T: np.ndarray, group: np.ndarray, tolerance: PoseTolerance) -> PoseVote:
    """Return the hypotheses that agree on the pose with the most votes.

    T: (n, 4, 4) hypotheses of one pose. group: (n,) placement that each comes from; at most one of
    its hypotheses is right. The pose near which most groups have a hypothesis wins; the nearest of
    each group is taken. Ties go to the earlier one.
    """
    n_votes = count_votes(is_near_pose(T[:, None], T[None], tolerance), group)
    best = int(n_votes.argmax())
    is_rival = ~is_near_pose(T, T[best], tolerance.scaled(2))
    n_rival_votes = int(n_votes[is_rival].max()) if is_rival.any() else 0
    centre, rows = T[best], np.zeros(0, int)
    for _ in range(N_VOTE_ROUNDS):
        rows = select_nearest_per_group(T, group, centre, tolerance)
        if len(rows) == 0:
            break
        centre = mean_pose(T[rows])[0]
    return PoseVote(rows, n_rival_votes)


def select_nearest_per_group(
    T: np.ndarray, group: np.ndarray, centre: np.ndarray, tolerance: PoseTolerance
) -> np.ndarray:
    """Return the row (k,) of each group's hypothesis nearest to a pose, within the tolerance."""
    xi = se3_log(invert_pose(centre) @ T)
    distance = np.hypot(
        np.linalg.norm(xi[:, :3], axis=1) / tolerance.shift_m,
        np.linalg.norm(xi[:, 3:], axis=1) / tolerance.turn_rad,
    )
    is_close = is_near_pose(T, centre, tolerance)
    rows = [np.flatnonzero((group == g) & is_close) for g in np.unique(group)]
    return np.array([r[distance[r].argmin()] for r in rows if len(r)], int)


def is_decisive(n_votes: float, n_rival_votes: float) -> bool:
    """Return whether the best pose has clearly more votes than the best other pose."""
    return bool(n_rival_votes <= MAX_RIVAL_SHARE * n_votes)


def min_pose_sigma(options: dict[str, Any]) -> np.ndarray:
    """Return the smallest σ (6,), m and rad, of a pose found in the data. options: `guess`."""
    return pose_sigma_from_config(options["min_sigma_from_data"])


def describe_scatter(xi: np.ndarray) -> str:
    """Return the median deviation of poses in words. xi: (n, 6) twists from their mean."""
    shift, turn = (np.median(np.linalg.norm(xi[:, i], axis=1)) for i in (slice(3), slice(3, 6)))
    return f"{1000 * shift:.0f} mm and {np.degrees(turn):.1f} deg"


def too_few_samples_status(description: str, n_placements: int, n_required: int) -> Status:
    """Return the status of a search with fewer placements than must agree on a pose."""
    return failure_status(
        "no pose found in the data",
        f"{n_placements} placements of a {description} with a frame of the sensor",
        f"{n_required} or more",
        _more_placements_remedy(n_required),
    )


def _more_placements_remedy(n_required: int) -> str:
    return (
        f"Hold the target still at {n_required} or more different places in view of this sensor, "
        "or set T_robot_sensor in the rig. Check the size and `body` of the target."
    )


def no_consensus_status(description: str, counts: SearchCounts) -> Status:
    """Return the status of a search whose placements do not agree on one pose.

    description: what was searched for, e.g. "pattern".
    """
    found = (
        f"{description} found at {counts.n_found} of {counts.n_searched} placements, "
        f"{counts.n_agreeing} agree on a pose"
    )
    if counts.n_agreeing >= counts.n_required:
        return failure_status(
            "the data fit more than one pose",
            f"{found}, {counts.n_rival_votes} on another",
            f"at most {MAX_RIVAL_SHARE:.0%} as many on another",
            "Record placements that differ more, tilted and at several distances, or set "
            "T_robot_sensor in the rig.",
        )
    return failure_status(
        "no pose found in the data",
        found,
        f"{counts.n_required} or more that agree",
        _more_placements_remedy(counts.n_required),
    )


def undetermined_pose_status(description: str, n_agreeing: int, sigma: np.ndarray) -> Status:
    """Return the status of a pose that its placements leave too uncertain. sigma: (6,)."""
    return failure_status(
        "the placements do not determine all directions of the pose",
        f"{description} at {n_agreeing} placements, sigma {1000 * sigma[:3].max():.0f} mm and "
        f"{np.degrees(sigma[3:].max()):.0f} deg",
        "placements that differ in all directions",
        "Record the target at more places, to all sides and tilted, or set T_robot_sensor in the "
        "rig.",
    )
