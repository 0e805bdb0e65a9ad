"""SO(3) and SE(3) on arrays, batched over leading axes.

A pose is a (..., 4, 4) matrix T_a_b that maps points of frame b into frame a. A twist is
xi = (v, w), m and rad, in the order of every covariance of this project: (tx ty tz rx ry rz).
Perturbations act from the right, T Exp(xi), hence along the axes of frame b.
Closed forms: Barfoot, State Estimation for Robotics, section 8.1. SciPy's RigidTransform (1.17)
loses two digits of the translation at angles of 1e-3 rad, and is not faster.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.geometry.numpy_or_casadi import ArrayOrExpression, elementwise_if_else

# Below this θ², rad², the series is used: with six terms both branches agree there to 1e-16.
MAX_SERIES_ANGLE_RAD2 = 0.04
MAX_MEAN_ITERATIONS, MEAN_STEP_TOLERANCE = 20, 1e-14  # of the intrinsic mean; m, rad
MIN_AXIS_SINE = 1e-9  # below this sine two directions count as parallel
SIN_SERIES = (1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800)
COS_SERIES = (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800, -1 / 479001600)
THETA_MINUS_SIN_SERIES = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800)
INVERSE_JACOBIAN_SERIES = (
    1 / 12,
    1 / 720,
    1 / 30240,
    1 / 1209600,
    1 / 47900160,
    691 / 1307674368000,
)


def _evaluate_polynomial(
    series: tuple[float, ...], theta_squared: ArrayOrExpression
) -> ArrayOrExpression:
    total: ArrayOrExpression = series[-1]
    for c in reversed(series[:-1]):
        total = total * theta_squared + c
    return total


def so3_exp_coefficients(
    theta_squared: ArrayOrExpression,
) -> tuple[ArrayOrExpression, ArrayOrExpression, ArrayOrExpression]:
    """Return (sin θ)/θ, (1 - cos θ)/θ² and (θ - sin θ)/θ³ of θ², rad²; smooth at 0."""
    small = theta_squared < MAX_SERIES_ANGLE_RAD2
    safe = elementwise_if_else(small, 1.0, theta_squared)
    theta = np.sqrt(safe)
    sine, cosine = np.sin(theta), np.cos(theta)
    return (
        elementwise_if_else(small, _evaluate_polynomial(SIN_SERIES, theta_squared), sine / theta),
        elementwise_if_else(
            small, _evaluate_polynomial(COS_SERIES, theta_squared), (1 - cosine) / safe
        ),
        elementwise_if_else(
            small,
            _evaluate_polynomial(THETA_MINUS_SIN_SERIES, theta_squared),
            (theta - sine) / (safe * theta),
        ),
    )


def so3_hat(w: ArrayLike) -> np.ndarray:
    """Return the skew matrices (..., 3, 3) of w (..., 3): hat(w) p = w × p."""
    w = np.asarray(w, float)
    out = np.zeros(w.shape + (3,))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return out - np.swapaxes(out, -1, -2)


def so3_exp(w: ArrayLike) -> np.ndarray:
    """Return the rotations (..., 3, 3) of rotation vectors w (..., 3), rad."""
    w = np.asarray(w, float)
    return Rotation.from_rotvec(w.reshape(-1, 3)).as_matrix().reshape(w.shape + (3,))


def so3_log(R: ArrayLike) -> np.ndarray:
    """Return the rotation vectors (..., 3), rad, of norm at most π, of R (..., 3, 3)."""
    R = np.asarray(R, float)
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])


def so3_left_jacobian(w: ArrayLike) -> np.ndarray:
    """Return J (..., 3, 3) with Exp(w + dw) = Exp(J dw) Exp(w) to first order."""
    w = np.asarray(w, float)
    K = so3_hat(w)
    _, b, c = so3_exp_coefficients(np.sum(w * w, -1)[..., None, None])
    return np.eye(3) + b * K + c * (K @ K)


def so3_left_jacobian_inverse(w: ArrayLike) -> np.ndarray:
    """Return the inverse (..., 3, 3) of so3_left_jacobian, for |w| < 2π."""
    w = np.asarray(w, float)
    s = np.sum(w * w, -1)[..., None, None]
    small = s < MAX_SERIES_ANGLE_RAD2
    safe = np.where(small, 1.0, s)
    half = np.sqrt(safe) / 2
    d = np.where(
        small, _evaluate_polynomial(INVERSE_JACOBIAN_SERIES, s), (1 - half / np.tan(half)) / safe
    )
    K = so3_hat(w)
    return np.eye(3) - K / 2 + d * (K @ K)


def make_pose(R: ArrayLike | None = None, t: ArrayLike | None = None) -> np.ndarray:
    """Return the pose (..., 4, 4) of R (..., 3, 3) and t (..., 3), m; None means identity."""
    R = np.eye(3) if R is None else np.asarray(R, float)
    t = np.zeros(3) if t is None else np.asarray(t, float)
    T = np.zeros(np.broadcast_shapes(R.shape[:-2], t.shape[:-1]) + (4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1
    return T


def pose_from_xyz_quat(xyz: ArrayLike, quat_xyzw: ArrayLike) -> np.ndarray:
    """Return the poses (..., 4, 4) of positions (..., 3), m, and quaternions xyzw (..., 4)."""
    q = np.array(quat_xyzw, float)  # a copy, because SciPy normalizes in place
    R = Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(q.shape[:-1] + (3, 3))
    return make_pose(R, xyz)


def pose_to_quat(T: np.ndarray) -> np.ndarray:
    """Return the quaternions xyzw (..., 4), w ≥ 0, of T (..., 4, 4)."""
    T = np.asarray(T, float)
    q = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat(canonical=True)
    return q.reshape(T.shape[:-2] + (4,))


def pose_from_rpy(xyz: ArrayLike, rpy: ArrayLike) -> np.ndarray:
    """Return the pose (4, 4) of xyz, m, and roll, pitch, yaw, rad.

    R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    return make_pose(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def pose_to_rpy(T: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw (3,), rad, of T (4, 4): R = Rz(yaw) Ry(pitch) Rx(roll).

    At a pitch of ±90° only the sum or the difference of yaw and roll is defined. The result still
    reproduces R to rounding: roll and pitch are computed from R without the yaw found first.
    """
    R = np.asarray(T, float)[:3, :3]
    yaw = np.arctan2(R[1, 0], R[0, 0])
    rest = so3_exp([0, 0, -yaw]) @ R
    return np.array([np.arctan2(-rest[1, 2], rest[1, 1]), np.arctan2(-rest[2, 0], rest[0, 0]), yaw])


def se3_exp(xi: ArrayLike) -> np.ndarray:
    """Return the poses (..., 4, 4) of twists xi (..., 6)."""
    xi = np.asarray(xi, float)
    v, w = xi[..., :3], xi[..., 3:]
    return make_pose(so3_exp(w), (so3_left_jacobian(w) @ v[..., None])[..., 0])


def se3_log(T: np.ndarray) -> np.ndarray:
    """Return the twists (..., 6) of poses T (..., 4, 4)."""
    T = np.asarray(T, float)
    w = so3_log(T[..., :3, :3])
    v = (so3_left_jacobian_inverse(w) @ T[..., :3, 3:])[..., 0]
    return np.concatenate([v, w], -1)


def invert_pose(T: np.ndarray) -> np.ndarray:
    """Return T_b_a (..., 4, 4) of T_a_b."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_pose(R_t, -(R_t @ T[..., :3, 3:])[..., 0])


def transform_points(T: np.ndarray, p: ArrayLike) -> np.ndarray:
    """Transform points p (..., 3), m, from frame b to frame a.

    T: T_a_b, (4, 4) or one pose per point (..., 4, 4).
    """
    return (T[..., :3, :3] @ np.asarray(p, float)[..., None])[..., 0] + T[..., :3, 3]


def adjoint(T: np.ndarray) -> np.ndarray:
    """Return Ad(T) (..., 6, 6): T Exp(xi) T⁻¹ = Exp(Ad(T) xi)."""
    R = T[..., :3, :3]
    out = np.zeros(T.shape[:-2] + (6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = so3_hat(T[..., :3, 3]) @ R
    return out


def rotation_angle(T: np.ndarray) -> np.ndarray:
    """Return the geodesic rotation angles (...), rad, of T (..., 4, 4)."""
    return np.linalg.norm(so3_log(T[..., :3, :3]), axis=-1)


def interpolate_poses(T0: np.ndarray, T1: np.ndarray, fraction: ArrayLike) -> np.ndarray:
    """Return the poses (..., 4, 4) at fractions (...) of the geodesics from T0 to T1."""
    return T0 @ se3_exp(np.asarray(fraction)[..., None] * se3_log(invert_pose(T0) @ T1))


def mean_pose(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the intrinsic mean (4, 4) of poses (n, 4, 4), and their deviations from it.

    Deviations are twists xi (n, 6) with poses = mean Exp(xi).
    """
    centre = poses[len(poses) // 2]
    for _ in range(MAX_MEAN_ITERATIONS):
        xi = se3_log(invert_pose(centre) @ poses)
        step = xi.mean(0)
        centre = centre @ se3_exp(step)
        if np.abs(step).max() < MEAN_STEP_TOLERANCE:
            break
    return centre, se3_log(invert_pose(centre) @ poses)


def inverse_pose_covariance(T_a_b: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (6, 6) of T_b_a from that of T_a_b, both right perturbations."""
    A = adjoint(T_a_b)
    return A @ covariance @ A.T


def relative_pose_covariance(
    T_r_a: np.ndarray, T_r_b: np.ndarray, joint_covariance: np.ndarray
) -> np.ndarray:
    """Return the covariance (6, 6) of T_a_b = T_r_a⁻¹ T_r_b.

    joint_covariance: (12, 12) of (T_r_a, T_r_b).
    """
    J = np.hstack([-adjoint(invert_pose(T_r_b) @ T_r_a), np.eye(6)])
    return J @ joint_covariance @ J.T


def rotation_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) that turns a (3,) into the direction of b (3,)."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), a @ b
    sine = np.linalg.norm(axis)
    if sine < MIN_AXIS_SINE:
        normal = np.linalg.svd(a[None])[2][1]
        return np.eye(3) if cosine > 0 else so3_exp(np.pi * normal)
    return so3_exp(axis / sine * np.arctan2(sine, cosine))
