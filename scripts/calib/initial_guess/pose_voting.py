"""The pose that most placements agree on, and how far it can be trusted."""

import numpy as np

from calib.geometry import se3
from calib.io import pose_block
from calib.io.status import failed

DECISIVE = 0.75  # of the votes of the best pose: what another pose may have at most


def near(A, B, tolerance):
    """Whether poses A and B (..., 4, 4) differ by less than tolerance (m, rad), broadcast."""
    shift = np.linalg.norm(A[..., :3, 3] - B[..., :3, 3], axis=-1)
    cosine = (np.einsum("...ij,...ij", A[..., :3, :3], B[..., :3, :3]) - 1) / 2
    return (shift < tolerance[0]) & (cosine > np.cos(min(tolerance[1], np.pi)))


def votes(close, group):
    """Number (m,) of groups that have a member among the close (m, n); group (n,)."""
    return sum(close[:, group == g].any(1) for g in np.unique(group)).astype(int)


def agreeing(T, group, tolerance):
    """(index of one pose per agreeing group (k,), votes of the best other pose).

    T (n, 4, 4): hypotheses of the same pose, group (n,): the placement that each comes from, of
    whose several readings one can be right. The pose that most groups come near to wins; of each
    group its nearest reading. Ties go to the earlier.
    """
    close = near(T[:, None], T[None], tolerance)
    count = votes(close, group)
    best = int(count.argmax())
    apart = ~near(T, T[best], (2 * tolerance[0], 2 * tolerance[1]))
    rival = int(count[apart].max()) if apart.any() else 0
    centre, chosen = T[best], np.zeros(0, int)
    for _ in range(5):
        chosen = nearest(T, group, centre, tolerance)
        if len(chosen) == 0:
            break
        centre = se3.mean(T[chosen])[0]
    return chosen, rival


def nearest(T, group, centre, tolerance):
    """Index (k,) of the hypothesis of every group that is nearest to a pose, within tolerance."""
    xi = se3.se3_log(se3.inverse(centre) @ T)
    away = np.hypot(
        np.linalg.norm(xi[:, :3], axis=1) / tolerance[0],
        np.linalg.norm(xi[:, 3:], axis=1) / tolerance[1],
    )
    close = near(T, centre, tolerance)
    rows = [np.flatnonzero((group == g) & close) for g in np.unique(group)]
    return np.array([r[away[r].argmin()] for r in rows if len(r)], int)


def decided(count, rival):
    """Whether so many votes leave no doubt when another pose has `rival`."""
    return rival <= DECISIVE * count


def tolerance(options):
    """(m, rad) within which two placements agree, of the options of guess."""
    return options["tolerance"]["xyz_m"], np.radians(options["tolerance"]["rpy_deg"])


def floor(options):
    """(6,) least σ, m and rad, of a pose found in the data."""
    return pose_block.pose_sigma(options["found_sigma"])


def scatter(xi):
    """The median deviation of poses, from their twists xi (n, 6), in words."""
    shift, turn = (np.median(np.linalg.norm(xi[:, at], axis=1)) for at in (slice(3), slice(3, 6)))
    return f"{1000 * shift:.0f} mm and {np.degrees(turn):.1f} deg"


def refused(what, agree, rival, seen, looked, least):
    """Status of a search whose placements do not agree well enough on one pose."""
    counts = f"{what} found at {seen} of {looked} placements, {agree} agree on a pose"
    if agree >= least:
        return failed(
            "the data leave more than one pose",
            f"{counts}, {rival} on another",
            f"at most {DECISIVE:.0%} as many on another",
            "Record placements that differ more, tilted and at several distances, or write "
            "T_robot_sensor.",
        )
    return failed(
        "no pose found in the data",
        counts,
        f"{least} or more that agree",
        f"Hold the target still at {least} or more different places in view of this sensor, or "
        "write T_robot_sensor; check the target's size and body.",
    )


def open_direction(what, agree, sigma):
    """Status of a pose that its placements leave too uncertain; sigma (6,)."""
    return failed(
        "the placements leave a direction of the pose open",
        f"{what} at {agree} placements that agree to {1000 * sigma[:3].max():.0f} mm and "
        f"{np.degrees(sigma[3:].max()):.0f} deg",
        "placements that differ in all directions",
        "Record the target at more places, to all sides and tilted, or write T_robot_sensor.",
    )
