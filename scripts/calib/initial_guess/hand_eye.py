"""Where a target sits in its MCS body, from a camera that saw its pattern at several placements.

In every placement k:  T_robot_camera T_camera_target,k = T_robot_body,k T_body_target
with both constant poses unknown. Two placements give T_robot_camera an equation A Z = Z B, whose
rotations tell it when they turn about two axes (Tsai and Lenz 1989; rotations here by Kabsch, from
their vectors); what is known of the camera beforehand helps where they do not.
"""

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.optimize import least_squares

from calib.geometry import se3
from calib.initial_guess import camera_from_patterns, pose_voting
from calib.initial_guess.frame_sampling import readable
from calib.io.status import OK, Status, failed

FEWEST = 3  # placements: two motions
STARTS = 6  # placements of which every three give a pose to start from
UNIT = np.repeat([0.005, np.radians(0.3)], 3)  # σ of a pose from one image, at first
FLOOR = np.repeat([0.001, np.radians(0.05)], 3)  # σ of a mount, at least


@dataclass(frozen=True)
class Mount:
    """T_body_target (4, 4), its σ (6,), in words what agrees on it; or why there is none."""

    T_body_target: np.ndarray | None = None
    sigma: np.ndarray | None = None
    basis: str = ""
    status: Status = OK


def find(camera, target, looks, content_of, prior, options):
    """The Mount of a target by one camera; prior: (T_robot_camera (4, 4), σ (6,)) or None.

    looks: at that target, with T_robot_body for T_robot_target.
    """
    seen = []
    for look, image in readable(looks, content_of):
        readings = camera_from_patterns.read(camera, target, image)
        seen += [(look.T_robot_target, readings)] if readings else []
        if len(seen) >= options["enough_images"]:
            break
    if len(seen) < FEWEST:
        return Mount(status=_unseen(target, len(seen), len(looks)))
    return solved(seen, prior, pose_voting.tolerance(options))


def solved(seen, prior, tolerance):
    """The Mount of what was seen: [(T_robot_body (4, 4), [T_camera_target (4, 4)] as it may be
    read)]."""
    B = np.array([body for body, readings in seen for _ in readings])
    C = np.array([reading for _, readings in seen for reading in readings])
    group = np.repeat(np.arange(len(seen)), [len(readings) for _, readings in seen])
    starts = ([] if prior is None else [prior[0]]) + by_three(seen)
    best, rows = None, np.zeros(0, int)
    for Z in starts:
        agree, _ = pose_voting.agreeing(se3.inverse(B) @ Z @ C, group, tolerance)
        if len(agree) > len(rows):
            best, rows = Z, agree
    if len(rows) < FEWEST:
        return Mount(status=_disagreeing(len(rows), len(seen)))
    T, sigma = fitted(best, B[rows], C[rows], prior)
    if (sigma > np.repeat(tolerance, 3)).any():
        return Mount(status=_one_axis(len(rows), sigma))
    basis = f"the pattern in {len(rows)} of {len(seen)} images that show one"
    return Mount(T, np.maximum(sigma, FLOOR), basis)


def by_three(seen):
    """[T_robot_camera (4, 4)] of every three of the first placements, in every reading."""
    out = []
    for triple in combinations(seen[:STARTS], 3):
        B = np.array([body for body, _ in triple])
        for readings in product(*(r for _, r in triple)):
            Z = closed(B, np.array(readings))
            out += [] if Z is None else [Z]
    return out


def closed(B, C):
    """T_robot_camera Z (4, 4) with (B_j B_i⁻¹) Z = Z (C_j C_i⁻¹) for T_robot_body B and
    T_camera_target C (n, 4, 4); None where the rotations share one axis."""
    i, j = np.triu_indices(len(B), 1)
    A, D = (P[j] @ se3.inverse(P[i]) for P in (B, C))
    there, here = (se3.so3_log(P[:, :3, :3]) for P in (A, D))
    u, s, vt = np.linalg.svd(there.T @ here)
    if s[1] < 0.03 * s[0]:
        return None
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (D[:, :3, 3] @ R.T - A[:, :3, 3]).reshape(-1)
    return se3.pose(R, np.linalg.lstsq(left, right, rcond=None)[0])


def fitted(Z, B, C, prior):
    """(T_body_target (4, 4), σ (6,)) that fits all placements best, robustly, with T_robot_camera
    free, from Z (4, 4), and held by what is known of it."""
    X = se3.mean(se3.inverse(B) @ Z @ C)[0]

    def residual(x):
        moved, mount = Z @ se3.se3_exp(x[:6]), X @ se3.se3_exp(x[6:])
        off = se3.se3_log(se3.inverse(moved @ C) @ B @ mount) / UNIT
        held = se3.se3_log(se3.inverse(prior[0]) @ moved) / prior[1] if prior else []
        return np.concatenate([off.reshape(-1), held])

    found = least_squares(residual, np.zeros(12), loss="soft_l1", x_scale="jac")
    scale = np.sqrt(max(2 * found.cost / max(len(found.fun) - 12, 1), 1e-6))
    information = found.jac.T @ found.jac + 1e-9 * np.eye(12)
    sigma = np.sqrt(np.diag(np.linalg.inv(information))[6:])
    return X @ se3.se3_exp(found.x[6:]), sigma * max(scale, 1.0 if prior else scale)


def _unseen(target, seen, looked):
    return failed(
        "the mount of the target is unknown and not found",
        f"its {target.pattern.name} seen at {seen} of {looked} placements",
        f"{FEWEST} or more",
        "Hold it still before a camera at more poses, or measure T_body_target.",
    )


def _disagreeing(agree, seen):
    return failed(
        "the mount of the target is unknown and not found",
        f"{agree} of {seen} images agree on one",
        f"{FEWEST} or more",
        "Turn the target about two axes between placements; check its size and the camera.",
    )


def _one_axis(agree, sigma):
    return failed(
        "the mount of the target stays open: its rotations share one axis",
        f"{agree} images agree to {1000 * sigma[:3].max():.0f} mm and "
        f"{np.degrees(sigma[3:].max()):.0f} deg",
        "rotations about two axes",
        "Record placements tilted about another axis too, or measure T_body_target.",
    )
