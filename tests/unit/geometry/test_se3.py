"""The group laws of SO(3) and SE(3), with every angle at which a formula changes or breaks down."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from calib.estimation.nlp.symbolic_chain import symbolic_inverse, symbolic_se3_exp
from calib.geometry.frame_graph import lookup_transform
from calib.geometry.se3 import (
    MAX_SERIES_ANGLE_RAD2,
    adjoint,
    interpolate_poses,
    inverse_pose_covariance,
    invert_pose,
    make_pose,
    mean_pose,
    pose_from_rpy,
    pose_from_xyz_quat,
    pose_to_quat,
    pose_to_rpy,
    relative_pose_covariance,
    rotation_angle,
    se3_exp,
    se3_log,
    so3_exp,
    so3_exp_coefficients,
    so3_hat,
    so3_left_jacobian,
    so3_left_jacobian_inverse,
    so3_log,
    transform_points,
)

SWITCH = np.sqrt(MAX_SERIES_ANGLE_RAD2)
SMALL = [0.0, 1e-12, 1e-8, 1e-4, SWITCH - 1e-9, SWITCH, SWITCH + 1e-9, 1.0]
ANGLES = [*SMALL, 3.0, np.pi - 1e-8, np.pi]
AXES = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0, 0.8], [2 / 7, -3 / 7, 6 / 7]])
EPS = 1e-14
at_angles = pytest.mark.parametrize("angle", ANGLES)

reals = st.floats(-2, 2).map(lambda x: 0.0 if abs(x) < 1e-150 else x)
twists = st.lists(reals, min_size=6, max_size=6).map(np.array)


def twists_of(angle):
    """(5, 6): turns by angle, rad, about several axes, with translations of about 1 m."""
    v = np.array([[0.3, -1.1, 0.7], [1, 0, 0], [0, 2, 0], [0.1, 0.2, -0.3], [0, 0, 0]])
    return np.column_stack([v, angle * AXES])


def hat4(xi):
    """The matrix (4, 4) whose exponential is Exp(xi)."""
    out = np.zeros((4, 4))
    out[:3, :3] = [[0, -xi[5], xi[4]], [xi[5], 0, -xi[3]], [-xi[4], xi[3], 0]]
    out[:3, 3] = xi[:3]
    return out


def differences(function, n=6, h=1e-6):
    """Central differences (m, n) of function at zero."""
    steps = h * np.eye(n)
    return np.column_stack([(function(s) - function(-s)) / (2 * h) for s in steps])


def error(T, T_hat):
    """Twist that T_hat is off by, along its own axes."""
    return se3_log(invert_pose(T) @ T_hat)


def spd(n, seed, scale):
    """A full covariance (n, n) whose parts are all different."""
    A = np.random.default_rng(seed).normal(size=(n, n)) * scale
    return A @ A.T


# --- exponential and logarithm


@at_angles
def test_exp_is_the_matrix_exponential(angle):
    for xi in twists_of(angle):
        assert np.abs(se3_exp(xi) - expm(hat4(xi))).max() < EPS


@at_angles
def test_exp_is_a_rigid_motion(angle):
    T = se3_exp(twists_of(angle))
    R = T[:, :3, :3]
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() < EPS
    assert np.linalg.det(R) == pytest.approx(1, abs=EPS)
    assert (T[:, 3] == [0, 0, 0, 1]).all()


@pytest.mark.parametrize("angle", [*SMALL, 3.0, np.pi - 1e-6])
def test_log_undoes_exp(angle):
    xi = twists_of(angle)
    assert np.abs(se3_log(se3_exp(xi)) - xi).max() < 1e-13 + 1e-15 / (np.pi - angle)


@at_angles
def test_exp_undoes_log_also_where_the_turn_has_two_names(angle):
    T = se3_exp(twists_of(angle))
    assert np.abs(se3_exp(se3_log(T)) - T).max() < EPS
    assert (np.linalg.norm(so3_log(T[:, :3, :3]), axis=1) <= np.pi + EPS).all()


def test_log_of_a_half_turn_has_angle_pi_about_its_axis():
    w = so3_log(np.diag([-1.0, -1.0, 1.0]))
    assert np.abs(w) == pytest.approx([0, 0, np.pi], abs=EPS)


def test_a_positive_turn_about_z_takes_x_to_y():
    assert so3_exp([0, 0, np.pi / 2]) @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=EPS)
    assert so3_hat([1, 2, 3]) @ [4, 5, 6] == pytest.approx(np.cross([1, 2, 3], [4, 5, 6]))


def test_a_twist_is_translation_first():
    assert se3_exp([1, 2, 3, 0, 0, 0]) == pytest.approx(make_pose(t=[1, 2, 3]))
    assert se3_exp([0, 0, 0, 0.1, 0.2, 0.3]) == pytest.approx(make_pose(so3_exp([0.1, 0.2, 0.3])))


def test_batches_of_any_shape_also_of_none_pass_through():
    xi = np.random.default_rng(0).normal(size=(2, 3, 6))
    assert se3_exp(xi)[1, 2] == pytest.approx(se3_exp(xi[1, 2]))
    assert se3_log(se3_exp(xi)) == pytest.approx(xi)
    assert se3_exp(np.zeros((0, 6))).shape == (0, 4, 4)
    assert se3_log(np.zeros((0, 4, 4))).shape == (0, 6)


def test_both_branches_of_the_coefficients_agree_where_they_meet():
    below, above = MAX_SERIES_ANGLE_RAD2 * (1 - 1e-15), MAX_SERIES_ANGLE_RAD2 * (1 + 1e-15)
    for a, b in zip(
        so3_exp_coefficients(np.array(below)),
        so3_exp_coefficients(np.array(above)),
        strict=True,
    ):
        assert a == pytest.approx(b, abs=EPS)


# --- group axioms


@given(twists, twists, twists)
@settings(max_examples=50, deadline=None)
def test_poses_form_a_group(a, b, c):
    A, B, C = se3_exp(np.stack([a, b, c]))
    assert np.abs((A @ B) @ C - A @ (B @ C)).max() < 1e-13
    assert invert_pose(A) @ A == pytest.approx(np.eye(4), abs=1e-13)
    assert A @ invert_pose(A) == pytest.approx(np.eye(4), abs=1e-13)
    assert invert_pose(A @ B) == pytest.approx(invert_pose(B) @ invert_pose(A), abs=1e-13)


@at_angles
def test_the_inverse_of_exp_is_exp_of_the_opposite_twist(angle):
    xi = twists_of(angle)
    assert np.abs(invert_pose(se3_exp(xi)) - se3_exp(-xi)).max() < EPS


def test_transform_maps_points_of_frame_b_into_frame_a():
    T_a_b = pose_from_rpy([1, 2, 3], [0, 0, np.pi / 2])
    p_b = np.array([[1, 0, 0], [0, 1, 0]])
    assert transform_points(T_a_b, p_b) == pytest.approx(np.array([[1, 3, 3], [0, 2, 3]]))
    assert transform_points(invert_pose(T_a_b), transform_points(T_a_b, p_b)) == pytest.approx(p_b)


def test_angle_is_the_geodesic_angle():
    assert rotation_angle(se3_exp(twists_of(0.7))) == pytest.approx(np.full(5, 0.7))
    assert rotation_angle(se3_exp(twists_of(1e-9))) == pytest.approx(np.full(5, 1e-9), rel=1e-9)


# --- adjoint and Jacobians


@at_angles
def test_the_adjoint_carries_a_twist_through_a_pose(angle):
    for T in se3_exp(twists_of(angle)):
        for xi in twists_of(0.4):
            there = se3_exp(adjoint(T) @ xi)
            assert T @ se3_exp(xi) @ invert_pose(T) == pytest.approx(there, abs=1e-13)


def test_the_adjoint_of_a_product_is_the_product_of_the_adjoints():
    A, B = se3_exp(np.stack([twists_of(1.0)[0], twists_of(2.0)[4]]))
    assert adjoint(A @ B) == pytest.approx(adjoint(A) @ adjoint(B), abs=EPS)


@at_angles
def test_the_left_jacobian_is_the_derivative_of_exp(angle):
    for w in angle * AXES:
        R = so3_exp(w)
        found = differences(lambda d, w=w, R=R: so3_log(so3_exp(w + d) @ R.T), 3)
        assert so3_left_jacobian(w) == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("angle", [*ANGLES, 4.0, 5.0])
def test_the_inverse_of_the_left_jacobian_is_its_inverse(angle):
    w = angle * AXES
    both = so3_left_jacobian_inverse(w) @ so3_left_jacobian(w)
    assert np.abs(both - np.eye(3)).max() < 1e-14


# --- interpolation and mean


@at_angles
def test_interpolation_ends_at_both_poses(angle):
    T0 = se3_exp(np.array([0.4, -0.2, 1, 0.3, 0.2, -2]))
    for T1 in T0 @ se3_exp(twists_of(angle)):
        ends = interpolate_poses(T0, T1, np.array([0.0, 1.0]))
        assert (ends[0] == T0).all()
        assert ends[1] == pytest.approx(T1, abs=EPS)


@pytest.mark.parametrize("angle", [*SMALL, 3.0, np.pi - 1e-6])
def test_halfway_is_equally_far_from_both_poses(angle):
    T0 = se3_exp(np.array([0.4, -0.2, 1, 0.3, 0.2, -2]))
    for T1 in T0 @ se3_exp(twists_of(angle)):
        half = interpolate_poses(T0, T1, 0.5)
        assert error(T0, half) == pytest.approx(error(half, T1), abs=1e-9)
        assert rotation_angle(invert_pose(T0) @ half) == pytest.approx(angle / 2, abs=1e-9)


@given(twists, st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=50, deadline=None)
def test_interpolation_moves_with_a_constant_twist(xi, a, b):
    xi[3:] *= min(1, 3 / max(np.linalg.norm(xi[3:]), 1e-9))
    T0 = se3_exp(np.array([0.4, -0.2, 1, 0.3, 0.2, -2]))
    Ta, Tb = interpolate_poses(T0, T0 @ se3_exp(xi), np.array([a, b]))
    assert error(Ta, Tb) == pytest.approx((b - a) * xi, abs=1e-12)


def test_mean_is_where_the_deviations_cancel():
    rng = np.random.default_rng(1)
    T = se3_exp(np.array([1, 2, 3, 0.5, -1, 2.0])) @ se3_exp(rng.normal(size=(40, 6)) * 0.1)
    mean, xi = mean_pose(T)
    assert xi.mean(0) == pytest.approx(np.zeros(6), abs=1e-13)
    assert mean @ se3_exp(xi) == pytest.approx(T, abs=1e-13)


def test_mean_of_two_poses_is_halfway_between_them():
    T = se3_exp(np.stack([twists_of(0.2)[0], twists_of(1.1)[3]]))
    assert mean_pose(T)[0] == pytest.approx(interpolate_poses(*T, 0.5), abs=1e-12)


def test_mean_of_one_pose_is_that_pose():
    T = se3_exp(twists_of(2.0)[:1])
    assert mean_pose(T)[0] == pytest.approx(T[0], abs=EPS)


def test_mean_moves_with_the_frame():
    rng = np.random.default_rng(2)
    T = se3_exp(rng.normal(size=(9, 6)) * 0.3)
    A, B = se3_exp(np.stack([twists_of(1.0)[0], twists_of(2.0)[4]]))
    assert mean_pose(A @ T @ B)[0] == pytest.approx(A @ mean_pose(T)[0] @ B, abs=1e-12)


# --- what users write


def test_rpy_means_yaw_after_pitch_after_roll_about_fixed_axes():
    roll, pitch, yaw = 0.3, -0.7, 2.1
    c, s = np.cos, np.sin
    Rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    Ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    Rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    T = pose_from_rpy([1, 2, 3], [roll, pitch, yaw])
    assert T[:3, :3] == pytest.approx(Rz @ Ry @ Rx, abs=EPS)
    assert T[:3, 3] == pytest.approx([1, 2, 3])
    assert pose_to_rpy(T) == pytest.approx([roll, pitch, yaw], abs=EPS)


@pytest.mark.parametrize("off", [0, 1e-15, 1e-12, 1e-9, 3e-8, 1e-7, 1e-5, 0.1])
@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_rpy_gives_the_rotation_back_where_yaw_and_roll_turn_about_one_axis(pitch, off):
    for roll, yaw in ((0.3, 2.1), (0, 0), (-1.2, 3.1), (np.pi, -np.pi / 2)):
        T = pose_from_rpy([0, 0, 0], [roll, pitch + off, yaw])
        assert pose_from_rpy([0, 0, 0], pose_to_rpy(T)) == pytest.approx(T, abs=EPS)


def test_quaternions_have_their_real_part_last():
    quarter = np.sqrt(0.5)
    T = pose_from_xyz_quat([1, 2, 3], [0, 0, quarter, quarter])
    assert np.abs(T - pose_from_rpy([1, 2, 3], [0, 0, np.pi / 2])).max() < EPS
    x, y, z, w = 0.1, -0.5, 0.3, 0.8
    norm = np.linalg.norm([x, y, z, w])
    T = pose_from_xyz_quat([0, 0, 0], np.array([x, y, z, w]) / norm)
    K = so3_hat(np.array([x, y, z]) / norm)
    assert T[:3, :3] == pytest.approx(np.eye(3) + 2 * w / norm * K + 2 * K @ K, abs=EPS)
    assert pose_to_quat(T) == pytest.approx(np.array([x, y, z, w]) / norm, abs=EPS)


@at_angles
def test_quaternions_come_back_with_a_real_part_that_is_not_negative(angle):
    T = se3_exp(twists_of(angle))
    q = pose_to_quat(T)
    assert (q[:, 3] >= 0).all()
    assert pose_from_xyz_quat(T[:, :3, 3], q) == pytest.approx(T, abs=EPS)
    assert pose_from_xyz_quat(T[:, :3, 3], -q) == pytest.approx(T, abs=EPS)


# --- covariances: order (tx ty tz rx ry rz), perturbation on the right


def test_covariance_of_the_inverse_is_that_of_the_inverted_draws():
    T = se3_exp(np.array([2.0, -1, 0.5, 0.4, -1.2, 0.9]))
    J = differences(lambda d: error(invert_pose(T), invert_pose(T @ se3_exp(d))))
    C = spd(6, 1, 0.01)
    assert inverse_pose_covariance(T, C) == pytest.approx(J @ C @ J.T, abs=1e-10)


def test_covariance_of_the_inverse_holds_in_a_monte_carlo():
    """20 000 draws; an entry scatters by √2 / √20000 = 1 % of the σ that it belongs to."""
    T = se3_exp(np.array([2.0, -1, 0.5, 0.4, -1.2, 0.9]))
    sigma = np.array([1, 2, 3, 4, 5, 6]) * 1e-4
    draws = sigma * np.random.default_rng(3).normal(size=(20_000, 6))
    found = np.cov(error(invert_pose(T), invert_pose(T @ se3_exp(draws))).T)
    expected = inverse_pose_covariance(T, np.diag(sigma**2))
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 0.05


def test_covariance_of_a_translation_error_seen_from_the_other_frame_is_turned_not_levered():
    T = pose_from_rpy([5, 0, 0], [0, 0, np.pi / 2])
    along_x = np.diag([1.0, 0, 0, 0, 0, 0])
    expected = np.diag([0, 1.0, 0, 0, 0, 0])
    assert inverse_pose_covariance(T, along_x) == pytest.approx(expected, abs=EPS)


def test_covariance_of_a_turn_seen_from_the_other_frame_moves_its_origin_by_the_lever_arm():
    T = make_pose(t=[5, 0, 0])
    about_z = np.diag([0, 0, 0, 0, 0, 0.01**2])
    C = inverse_pose_covariance(T, about_z)
    assert np.sqrt(np.diag(C)) == pytest.approx([0, 0.05, 0, 0, 0, 0.01], abs=EPS)


def test_covariance_of_a_relative_pose_counts_what_both_errors_share():
    T_r_a = se3_exp(np.array([2.0, -1, 0.5, 0.4, -1.2, 0.9]))
    T_r_b = se3_exp(np.array([-0.3, 1, 1.5, -2.0, 0.2, 0.1]))
    T_a_b = invert_pose(T_r_a) @ T_r_b

    def off(d):
        return error(T_a_b, invert_pose(T_r_a @ se3_exp(d[:6])) @ T_r_b @ se3_exp(d[6:]))

    J, joint = differences(off, 12), spd(12, 2, 0.01)
    found = relative_pose_covariance(T_r_a, T_r_b, joint)
    assert found == pytest.approx(J @ joint @ J.T, abs=1e-10)


def test_covariance_of_a_relative_pose_vanishes_where_both_move_as_one():
    T_r_a, T_r_b = se3_exp(np.stack([twists_of(1.0)[0], twists_of(2.0)[4]]))
    J = np.vstack([adjoint(invert_pose(T_r_a)), adjoint(invert_pose(T_r_b))])
    joint = J @ spd(6, 4, 0.1) @ J.T
    assert np.abs(relative_pose_covariance(T_r_a, T_r_b, joint)).max() < 1e-14


# --- the CasADi twin


@at_angles
def test_casadi_exp_equals_numpy_exp(angle):
    for xi in twists_of(angle):
        assert np.array(ca.DM(symbolic_se3_exp(ca.DM(xi)))) == pytest.approx(se3_exp(xi), abs=EPS)


@at_angles
def test_casadi_inverse_equals_numpy_inverse(angle):
    for T in se3_exp(twists_of(angle)):
        assert np.array(symbolic_inverse(ca.DM(T))) == pytest.approx(invert_pose(T), abs=EPS)


@at_angles
def test_the_derivative_of_casadi_exp_is_finite_and_right_at_every_angle(angle):
    x = ca.SX.sym("x", 6)
    derivative = ca.Function("d", [x], [ca.jacobian(ca.vec(symbolic_se3_exp(x)), x)])
    for xi in twists_of(angle):
        found = differences(lambda d, xi=xi: se3_exp(xi + d).T.reshape(-1))
        assert np.array(derivative(xi)) == pytest.approx(found, abs=2e-9)


def test_the_derivative_of_casadi_exp_at_zero_is_the_generators():
    x = ca.SX.sym("x", 6)
    derivative = ca.Function("d", [x], [ca.jacobian(ca.vec(symbolic_se3_exp(x)), x)])
    generators = np.column_stack([hat4(e).T.reshape(-1) for e in np.eye(6)])
    assert (np.array(derivative(np.zeros(6))) == generators).all()


def test_the_second_derivative_of_casadi_exp_at_zero_is_finite():
    x = ca.SX.sym("x", 6)
    total = ca.sum1(ca.vec(symbolic_se3_exp(x)))
    hessian = ca.Function("h", [x], [ca.hessian(total, x)[0]])
    assert np.isfinite(np.array(hessian(np.zeros(6)))).all()


# --- static transforms


def test_frames_are_joined_the_shortest_way_and_against_the_arrows():
    ab, bc, dc = se3_exp(np.stack([twists_of(0.5)[0], twists_of(1.0)[1], twists_of(2.0)[2]]))
    edges = {("a", "b"): ab, ("b", "c"): bc, ("d", "c"): dc}
    assert lookup_transform(edges, "a", "d") == pytest.approx(ab @ bc @ invert_pose(dc), abs=EPS)
    assert lookup_transform(edges, "d", "a") == pytest.approx(
        dc @ invert_pose(bc) @ invert_pose(ab), abs=EPS
    )
    shortcut = make_pose(t=[9, 9, 9])
    assert lookup_transform(edges | {("a", "d"): shortcut}, "a", "d") == pytest.approx(shortcut)


def test_frames_without_a_way_between_them_have_no_pose():
    edges = {("a", "b"): np.eye(4), ("c", "d"): np.eye(4)}
    assert lookup_transform(edges, "a", "d") is None
    assert lookup_transform({}, "a", "a") == pytest.approx(np.eye(4))


def test_no_pose_is_made_of_no_rows_of_a_table_that_may_only_be_read():
    xyz, quat = np.zeros((0, 3)), np.zeros((0, 4))
    quat.flags.writeable = False
    assert pose_from_xyz_quat(xyz, quat).shape == (0, 4, 4)
