"""The pose that most placements agree on, and how far it can be trusted."""

import numpy as np

from calib.geometry.se3 import invert_pose, mean_pose, se3_log
from calib.io.pose_block import pose_sigma_from_config
from calib.io.status import failure_status

MAX_RIVAL_SHARE = 0.75  # of the votes of the best pose: what another pose may have at most


def is_near_pose(A, B, tolerance):
    """Whether poses A and B (..., 4, 4) differ by less than tolerance (m, rad), broadcast."""
    shift = np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1)
    cosine = (np.einsum("...ij,...ij", A[..., :3, :3], B[..., :3, :3]) - 1) / 2
    return (shift < tolerance[0]) & (cosine > np.cos(min(tolerance[1], np.pi)))


def count_votes(close, group):
    """Number (m,) of groups that have a member among the close (m, n); group (n,)."""
    return sum(close[:, group == g].any(1) for g in np.unique(group)).astype(int)


def vote_for_pose(T, group, tolerance):
    """(index of one pose per agreeing group (k,), votes of the best other pose).

    T (n, 4, 4): hypotheses of the same pose, group (n,): the placement that each comes from, of
    whose several readings one can be right. The pose that most groups come near to wins; of each
    group its nearest reading. Ties go to the earlier.
    """
    close = is_near_pose(T[:, None], T[None], tolerance)
    count = count_votes(close, group)
    best = int(count.argmax())
    apart = ~is_near_pose(T, T[best], (2 * tolerance[0], 2 * tolerance[1]))
    rival = int(count[apart].max()) if apart.any() else 0
    centre, chosen = T[best], np.zeros(0, int)
    for _ in range(5):
        chosen = select_nearest_per_group(T, group, centre, tolerance)
        if len(chosen) == 0:
            break
        centre = mean_pose(T[chosen])[0]
    return chosen, rival


def select_nearest_per_group(T, group, centre, tolerance):
    """Index (k,) of the hypothesis of every group that is nearest to a pose, within tolerance."""
    xi = se3_log(invert_pose(centre) @ T)
    away = np.hypot(
        np.linalg.norm(xi[:, :3], axis=1) / tolerance[0],
        np.linalg.norm(xi[:, 3:], axis=1) / tolerance[1],
    )
    close = is_near_pose(T, centre, tolerance)
    rows = [np.flatnonzero((group == g) & close) for g in np.unique(group)]
    return np.array([r[away[r].argmin()] for r in rows if len(r)], int)


def is_decisive(n_votes, n_rival_votes):
    """Whether so many votes leave no doubt when another pose has `rival`."""
    return n_rival_votes <= MAX_RIVAL_SHARE * n_votes


def agreement_tolerance(options):
    """(m, rad) within which two placements agree, of the options of guess."""
    return options["tolerance"]["xyz_m"], np.radians(options["tolerance"]["rpy_deg"])


def min_pose_sigma(options):
    """(6,) least σ, m and rad, of a pose found in the data."""
    return pose_sigma_from_config(options["min_sigma_from_data"])


def describe_scatter(xi):
    """The median deviation of poses, from their twists xi (n, 6), in words."""
    shift, turn = (np.median(np.linalg.norm(xi[:, at], axis=1)) for at in (slice(3), slice(3, 6)))
    return f"{1000 * shift:.0f} mm and {np.degrees(turn):.1f} deg"


def no_consensus_status(description, n_agreeing, n_rival_votes, n_seen, n_samples, n_required):
    """Status of a search whose placements do not agree well enough on one pose."""
    counts = (
        f"{description} found at {n_seen} of {n_samples} placements, {n_agreeing} agree on a pose"
    )
    if n_agreeing >= n_required:
        return failure_status(
            "the data leave more than one pose",
            f"{counts}, {n_rival_votes} on another",
            f"at most {MAX_RIVAL_SHARE:.0%} as many on another",
            "Record placements that differ more, tilted and at several distances, or write "
            "T_robot_sensor.",
        )
    return failure_status(
        "no pose found in the data",
        counts,
        f"{n_required} or more that agree",
        f"Hold the target still at {n_required} or more different places in view of this sensor, or "
        "write T_robot_sensor; check the target's size and body.",
    )


def undetermined_pose_status(description, n_agreeing, sigma):
    """Status of a pose that its placements leave too uncertain; sigma (6,)."""
    return failure_status(
        "the placements leave a direction of the pose open",
        f"{description} at {n_agreeing} placements that agree to {1000 * sigma[:3].max():.0f} mm and "
        f"{np.degrees(sigma[3:].max()):.0f} deg",
        "placements that differ in all directions",
        "Record the target at more places, to all sides and tilted, or write T_robot_sensor.",
    )
