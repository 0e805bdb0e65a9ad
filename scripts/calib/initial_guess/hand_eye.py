"""Find how a target is mounted in its MCS body, from a camera that sees its pattern.

In every placement k:  T_robot_camera T_camera_target,k = T_robot_body,k T_body_target
with both constant poses unknown. Two placements give an equation A Z = Z B for T_robot_camera. Its
rotations determine the rotation of Z if they are about two axes (Tsai and Lenz 1989; here by the
Kabsch algorithm on their rotation vectors). A prior of the camera's pose helps if they are not.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.geometry.rotation_spread import rotation_spread_deg
from calib.geometry.se3 import (
    adjoint,
    invert_pose,
    make_pose,
    mean_pose,
    se3_exp,
    se3_log,
    so3_log,
)
from calib.initial_guess.camera_from_patterns import read_pattern_poses
from calib.initial_guess.initial_guess import PoseGuess
from calib.initial_guess.pose_voting import PoseTolerance, vote_for_pose
from calib.io.status import OK, Status, failure_status
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import TargetShape
from calib.views.initial_guess_frames import FrameSample, read_samples
from calib.views.sensor_croppers import FrameReader

MIN_MOUNT_PLACEMENTS = 3  # two relative motions
MAX_START_PLACEMENTS = 6  # of which every three give a pose to start from
INITIAL_IMAGE_POSE_SIGMA = np.repeat([0.005, np.radians(0.3)], 3)  # of a pose from one image
MIN_MOUNT_SIGMA = np.repeat([0.001, np.radians(0.05)], 3)
MAX_MOUNT_SIGMA = np.repeat([0.15, np.radians(12)], 3)  # beyond which a mount is not determined
# Two rotation axes, of which at least one limit holds: the ratio of the squares of their rotations,
# and the rms of the second rotation, rad.
MIN_SECOND_AXIS_RATIO, MIN_SECOND_ROTATION = 0.03, np.radians(1.5)


class PatternView(NamedTuple):
    """T_robot_body (4, 4) of one placement, and T_camera_target (4, 4) by every reading there."""

    T_robot_body: np.ndarray
    readings: list[np.ndarray]


class MountFit(NamedTuple):
    """T_body_target (4, 4) and its σ (6,), m and rad."""

    T_body_target: np.ndarray
    sigma: np.ndarray


def find_mount(
    camera: CameraModel,
    target: TargetShape,
    samples: Sequence[FrameSample],
    read_frame: FrameReader,
    *,
    camera_prior: PoseGuess | None,
    options: dict[str, Any],
) -> PoseGuess:
    """Search T_body_target with one camera.

    samples: of that target, with T_robot_body in place of T_robot_target. camera_prior: what is
    known of T_robot_camera. options: block `guess`.
    """
    views: list[PatternView] = []
    for sample, image in read_samples(samples, read_frame):
        readings = read_pattern_poses(camera, target, image)
        views += [PatternView(sample.T_robot_target, readings)] if readings else []
        if len(views) >= options["max_pattern_images"]:
            break
    if len(views) < MIN_MOUNT_PLACEMENTS:
        return PoseGuess(status=_too_few_views_status(target, len(views), len(samples)))
    return solve_mount(views, camera_prior, PoseTolerance.from_options(options))


def check_mount_placements(T_robot_body: np.ndarray, has_camera_prior: bool) -> Status:
    """Return ok if images at n placements can determine T_body_target, else why they cannot.

    T_robot_body: (n, 4, 4). Stages guess and solve, and preflight, decide by this function.
    """
    n = len(T_robot_body)
    if n < MIN_MOUNT_PLACEMENTS:
        return _too_few_placements_status(n)
    if has_camera_prior:
        return OK
    sigma = predict_mount_sigma(T_robot_body)
    return OK if (sigma <= MAX_MOUNT_SIGMA).all() else _single_axis_status(T_robot_body, sigma)


def name_target_in_status(status: Status, target_name: str) -> Status:
    """Return the status of a mount with the name of the target in its reason."""
    return replace(
        status, reason=status.reason.replace("T_body_target", f"T_body_target of {target_name}", 1)
    )


def predict_mount_sigma(T_robot_body: np.ndarray) -> np.ndarray:
    """Return σ (6,), m and rad, of a target's pose in its body that n images would give.

    T_robot_body: (n, 4, 4). The pose of the camera is unknown, σ of an image is
    INITIAL_IMAGE_POSE_SIGMA. The result does not depend on where the camera is.
    """
    camera = -adjoint(invert_pose(T_robot_body))
    mount = np.broadcast_to(np.eye(6), camera.shape)
    J = np.concatenate([camera, mount], axis=2) / INITIAL_IMAGE_POSE_SIGMA[:, None]
    information = np.einsum("kia,kib->ab", J, J) + 1e-9 * np.eye(12)
    return np.sqrt(np.diag(np.linalg.inv(information))[6:])


def solve_mount(
    views: Sequence[PatternView], camera_prior: PoseGuess | None, tolerance: PoseTolerance
) -> PoseGuess:
    """Solve T_body_target from the readings of a pattern in several placements."""
    placed = np.array([body for body, _ in views])
    status = check_mount_placements(placed, camera_prior is not None)
    if not status.ok:
        return PoseGuess(status=status)
    T_robot_body = np.array([body for body, readings in views for _ in readings])
    T_camera_target = np.array([reading for _, readings in views for reading in readings])
    group = np.repeat(np.arange(len(views)), [len(readings) for _, readings in views])
    prior_starts = [] if camera_prior is None else [camera_prior.value]
    T_start, rows = None, np.zeros(0, int)
    for T_robot_camera in prior_starts + solve_camera_triples(views):
        mounts = invert_pose(T_robot_body) @ T_robot_camera @ T_camera_target
        agreeing = vote_for_pose(mounts, group, tolerance).rows
        if len(agreeing) > len(rows):
            T_start, rows = T_robot_camera, agreeing
    if T_start is None or len(rows) < MIN_MOUNT_PLACEMENTS:
        return PoseGuess(status=_disagreement_status(len(rows), len(views)))
    fit = fit_mount(T_start, T_robot_body[rows], T_camera_target[rows], camera_prior)
    if (fit.sigma > np.repeat(tolerance, 3)).any():
        return PoseGuess(status=_single_axis_status(T_robot_body[rows], fit.sigma))
    basis = f"the pattern in {len(rows)} of {len(views)} images that show one"
    return PoseGuess(fit.T_body_target, np.maximum(fit.sigma, MIN_MOUNT_SIGMA), basis)


def solve_camera_triples(views: Sequence[PatternView]) -> list[np.ndarray]:
    """Return T_robot_camera (4, 4) of every three of the first placements, in every reading."""
    poses = []
    for triple in combinations(views[:MAX_START_PLACEMENTS], 3):
        T_robot_body = np.array([body for body, _ in triple])
        for readings in product(*(r for _, r in triple)):
            Z = solve_hand_eye(T_robot_body, np.array(readings))
            poses += [] if Z is None else [Z]
    return poses


def solve_hand_eye(T_robot_body: np.ndarray, T_camera_target: np.ndarray) -> np.ndarray | None:
    """Solve (B_j B_i⁻¹) Z = Z (C_j C_i⁻¹) for Z = T_robot_camera (4, 4).

    B = T_robot_body and C = T_camera_target are (n, 4, 4). None if all rotations share one axis.
    """
    i, j = np.triu_indices(len(T_robot_body), 1)
    A, D = (P[j] @ invert_pose(P[i]) for P in (T_robot_body, T_camera_target))
    robot_rotations, camera_rotations = (so3_log(P[:, :3, :3]) for P in (A, D))
    u, s, vt = np.linalg.svd(robot_rotations.T @ camera_rotations)
    if s[1] < min(MIN_SECOND_AXIS_RATIO * s[0], len(i) * MIN_SECOND_ROTATION**2):
        return None
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    coefficients = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    values = (D[:, :3, 3] @ R.T - A[:, :3, 3]).reshape(-1)
    return make_pose(R, np.linalg.lstsq(coefficients, values, rcond=None)[0])


def fit_mount(
    T_robot_camera: np.ndarray,
    T_robot_body: np.ndarray,
    T_camera_target: np.ndarray,
    camera_prior: PoseGuess | None,
) -> MountFit:
    """Fit T_body_target to all placements by robust least squares.

    T_robot_camera (4, 4) is estimated too, from its start and with its prior.
    """
    T_start = mean_pose(invert_pose(T_robot_body) @ T_robot_camera @ T_camera_target)[0]

    def residual(x: np.ndarray) -> np.ndarray:
        T_camera, mount = T_robot_camera @ se3_exp(x[:6]), T_start @ se3_exp(x[6:])
        deviation = se3_log(invert_pose(T_camera @ T_camera_target) @ T_robot_body @ mount)
        parts = [(deviation / INITIAL_IMAGE_POSE_SIGMA).reshape(-1)]
        if camera_prior is not None and camera_prior.value is not None:
            parts.append(se3_log(invert_pose(camera_prior.value) @ T_camera) / camera_prior.sigma)
        return np.concatenate(parts)

    fit = least_squares(residual, np.zeros(12), loss="soft_l1", x_scale="jac")
    scale = np.sqrt(max(2 * fit.cost / max(len(fit.fun) - 12, 1), 1e-6))
    information = fit.jac.T @ fit.jac + 1e-9 * np.eye(12)
    sigma = np.sqrt(np.diag(np.linalg.inv(information))[6:])
    # With a prior, σ is not reduced below what the assumed σ of the images give.
    min_scale = scale if camera_prior is None else 1.0
    return MountFit(T_start @ se3_exp(fit.x[6:]), sigma * max(scale, min_scale))


def _too_few_views_status(target: TargetShape, n_found: int, n_searched: int) -> Status:
    pattern = "pattern" if target.pattern is None else target.pattern.name
    return failure_status(
        "T_body_target is unknown and not found in the data",
        f"{pattern} seen at {n_found} of {n_searched} placements",
        f"{MIN_MOUNT_PLACEMENTS} or more",
        "Hold the target still in front of a camera at more poses, or measure T_body_target.",
    )


def _disagreement_status(n_agreeing: int, n_found: int) -> Status:
    return failure_status(
        "T_body_target is unknown and not found in the data",
        f"{n_agreeing} of {n_found} images agree on one pose",
        f"{MIN_MOUNT_PLACEMENTS} or more",
        "Turn the target about two axes between placements. Check its size and the camera's "
        "intrinsics.",
    )


def _too_few_placements_status(n: int) -> Status:
    return failure_status(
        "T_body_target is unknown and not found in the data",
        f"{n} placements",
        f"{MIN_MOUNT_PLACEMENTS} or more",
        "Hold the target still in front of a camera at more poses, or measure T_body_target.",
    )


def _single_axis_status(T_robot_body: np.ndarray, sigma: np.ndarray) -> Status:
    """Return the status of a mount that placements (n, 4, 4) leave as uncertain as sigma (6,)."""
    turns = ", ".join(f"{angle:.0f}°" for angle in rotation_spread_deg(T_robot_body)[0])
    return failure_status(
        "T_body_target is not determined: all rotations are about one axis",
        f"{len(T_robot_body)} placements, rotations about their main axes of {turns} (rms)",
        f"rotations about two axes; they leave σ {min(1000 * sigma[:3].max(), 9999):.0f} mm and "
        f"{min(np.degrees(sigma[3:].max()), 180):.0f}°",
        "Record placements tilted by 30° or more about another axis too, or measure T_body_target.",
    )
