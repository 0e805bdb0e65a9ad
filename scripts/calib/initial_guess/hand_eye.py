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

from calib.geometry.se3 import invert_pose, make_pose, mean_pose, se3_exp, se3_log, so3_log
from calib.initial_guess.camera_from_patterns import read_pattern_poses
from calib.initial_guess.frame_sampling import read_samples
from calib.initial_guess.pose_voting import agreement_tolerance, vote_for_pose
from calib.io.status import OK, Status, failure_status

MIN_MOUNT_PLACEMENTS = 3  # placements: two motions
MAX_START_PLACEMENTS = 6  # placements of which every three give a pose to start from
INITIAL_IMAGE_POSE_SIGMA = np.repeat(
    [0.005, np.radians(0.3)], 3
)  # σ of a pose from one image, at first
MIN_MOUNT_SIGMA = np.repeat([0.001, np.radians(0.05)], 3)  # σ of a mount, at least


@dataclass(frozen=True)
class MountGuess:
    """T_body_target (4, 4), its σ (6,), in words what agrees on it; or why there is none."""

    T_body_target: np.ndarray | None = None
    sigma: np.ndarray | None = None
    basis: str = ""
    status: Status = OK


def find_mount(camera, target, samples, read_frame, camera_prior, options):
    """The Mount of a target by one camera; camera_prior: (T_robot_camera (4, 4), σ (6,)) or None.

    samples: at that target, with T_robot_body for T_robot_target.
    """
    seen = []
    for look, image in read_samples(samples, read_frame):
        readings = read_pattern_poses(camera, target, image)
        seen += [(look.T_robot_target, readings)] if readings else []
        if len(seen) >= options["max_pattern_images"]:
            break
    if len(seen) < MIN_MOUNT_PLACEMENTS:
        return MountGuess(status=_too_few_views_status(target, len(seen), len(samples)))
    return solve_mount(seen, camera_prior, agreement_tolerance(options))


def solve_mount(pattern_readings, camera_prior, tolerance):
    """The Mount of what was pattern_readings: [(T_robot_body (4, 4), [T_camera_target (4, 4)] as it may be
    read)]."""
    B = np.array([body for body, readings in pattern_readings for _ in readings])
    C = np.array([reading for _, readings in pattern_readings for reading in readings])
    group = np.repeat(
        np.arange(len(pattern_readings)), [len(readings) for _, readings in pattern_readings]
    )
    starts = ([] if camera_prior is None else [camera_prior[0]]) + solve_camera_triples(
        pattern_readings
    )
    best, rows = None, np.zeros(0, int)
    for Z in starts:
        agree, _ = vote_for_pose(invert_pose(B) @ Z @ C, group, tolerance)
        if len(agree) > len(rows):
            best, rows = Z, agree
    if len(rows) < MIN_MOUNT_PLACEMENTS:
        return MountGuess(status=_disagreement_status(len(rows), len(pattern_readings)))
    T, sigma = fit_mount(best, B[rows], C[rows], camera_prior)
    if (sigma > np.repeat(tolerance, 3)).any():
        return MountGuess(status=_single_axis_status(len(rows), sigma))
    basis = f"the pattern in {len(rows)} of {len(pattern_readings)} images that show one"
    return MountGuess(T, np.maximum(sigma, MIN_MOUNT_SIGMA), basis)


def solve_camera_triples(pattern_readings):
    """[T_robot_camera (4, 4)] of every three of the first placements, in every reading."""
    out = []
    for triple in combinations(pattern_readings[:MAX_START_PLACEMENTS], 3):
        B = np.array([body for body, _ in triple])
        for readings in product(*(r for _, r in triple)):
            Z = solve_hand_eye(B, np.array(readings))
            out += [] if Z is None else [Z]
    return out


def solve_hand_eye(T_robot_body, T_camera_target):
    """T_robot_camera Z (4, 4) with (B_j B_i⁻¹) Z = Z (C_j C_i⁻¹) for T_robot_body B and
    T_camera_target T_camera_target (n, 4, 4); None where the rotations share one axis."""
    i, j = np.triu_indices(len(T_robot_body), 1)
    A, D = (P[j] @ invert_pose(P[i]) for P in (T_robot_body, T_camera_target))
    there, here = (so3_log(P[:, :3, :3]) for P in (A, D))
    u, s, vt = np.linalg.svd(there.T @ here)
    if s[1] < 0.03 * s[0]:
        return None
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (D[:, :3, 3] @ R.T - A[:, :3, 3]).reshape(-1)
    return make_pose(R, np.linalg.lstsq(left, right, rcond=None)[0])


def fit_mount(T_robot_camera, T_robot_body, T_camera_target, camera_prior):
    """(T_body_target (4, 4), σ (6,)) that fits all placements best, robustly, with T_robot_camera
    free, from T_robot_camera (4, 4), and held by what is known of it."""
    X = mean_pose(invert_pose(T_robot_body) @ T_robot_camera @ T_camera_target)[0]

    def residual(x):
        moved, mount = T_robot_camera @ se3_exp(x[:6]), X @ se3_exp(x[6:])
        off = (
            se3_log(invert_pose(moved @ T_camera_target) @ T_robot_body @ mount)
            / INITIAL_IMAGE_POSE_SIGMA
        )
        held = (
            se3_log(invert_pose(camera_prior[0]) @ moved) / camera_prior[1] if camera_prior else []
        )
        return np.concatenate([off.reshape(-1), held])

    found = least_squares(residual, np.zeros(12), loss="soft_l1", x_scale="jac")
    scale = np.sqrt(max(2 * found.cost / max(len(found.fun) - 12, 1), 1e-6))
    information = found.jac.T @ found.jac + 1e-9 * np.eye(12)
    sigma = np.sqrt(np.diag(np.linalg.inv(information))[6:])
    return X @ se3_exp(found.x[6:]), sigma * max(scale, 1.0 if camera_prior else scale)


def _too_few_views_status(target, n_seen, n_samples):
    return failure_status(
        "the mount of the target is unknown and not found",
        f"its {target.pattern.name} seen at {n_seen} of {n_samples} placements",
        f"{MIN_MOUNT_PLACEMENTS} or more",
        "Hold it still before a camera at more poses, or measure T_body_target.",
    )


def _disagreement_status(n_agreeing, n_seen):
    return failure_status(
        "the mount of the target is unknown and not found",
        f"{n_agreeing} of {n_seen} images agree on one",
        f"{MIN_MOUNT_PLACEMENTS} or more",
        "Turn the target about two axes between placements; check its size and the camera.",
    )


def _single_axis_status(n_agreeing, sigma):
    return failure_status(
        "the mount of the target stays open: its rotations share one axis",
        f"{n_agreeing} images agree to {1000 * sigma[:3].max():.0f} mm and "
        f"{np.degrees(sigma[3:].max()):.0f} deg",
        "rotations about two axes",
        "Record placements tilted about another axis too, or measure T_body_target.",
    )
