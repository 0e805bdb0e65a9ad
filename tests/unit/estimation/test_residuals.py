"""The paper's equations as residuals, their derivatives, and problems whose optimum is known."""

import casadi as ca
import cv2
import numpy as np
import pytest
from scipy.io import loadmat

from calib.estimation.nlp.casadi_vectorized import vectorize_casadi_function
from calib.estimation.nlp.joint_nlp import (
    FactorLayout,
    JointNlp,
    LinearizationPoses,
    Prior,
    ViewErrorPrior,
)
from calib.estimation.nlp.measurement_factor import Factor, joint_information
from calib.estimation.nlp.symbolic_chain import (
    make_chain_function,
    make_condensed_cost,
    make_residual_function,
)
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.residuals.robust_loss import tukey_cost, tukey_weight
from calib.geometry.se3 import invert_pose, make_pose, se3_exp, se3_log, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import target_from_config
from helpers.real_data import find_shared_data

CAMERA = CameraModel("radtan", (800, 810, 640, 480, -0.2, 0.05, 0.001, -0.002), (1280, 960))
PINHOLE = CameraModel("radtan", (800, 810, 640, 480, 0, 0, 0, 0), (1280, 960))
BOARD = target_from_config(
    {"shape": "board", "outline_m": [[0, 0], [1, 0], [1, 1], [0, 1]], "thickness_m": 0.01}
)
CYLINDER = target_from_config({"shape": "cylinder", "length_m": 0.8, "radius_m": 0.1})
LIDAR = LidarModel(np.radians(0.2), np.radians(2.0), None, None, (0.3, 100.0), 0.01)
EDGE_RESIDUAL = RESIDUAL_KINDS["board_outline"].residual(LIDAR, BOARD)

# A target that faces the sensor 2 m ahead: x right, y up, z towards a camera that looks along z.
T_CAMERA_TARGET = make_pose(np.diag([1.0, -1, -1]), [0.2, -0.1, 2.0])
T_LIDAR_TARGET = make_pose(so3_exp([0, -np.pi / 2, 0]), [2.0, 0.3, -0.1])
SKEWED = se3_exp(np.array([0.2, -0.3, 2.5, 0.3, -0.5, 0.8]))


def value(residual, T, *numbers):
    """The residual of a measurement's numbers at T_sensor_target."""
    T = ca.DM(T)
    return np.array(ca.DM(residual(T[:3, :3], T[:3, 3], ca.DM(numbers)))).reshape(-1)


# --- equation 3: the measured pixel minus the projected corner

ALIKE = (1.0, 0.0, 1.0)  # σ of u and v are


def test_a_corner_where_it_projects_has_no_residual():
    corner = np.array([0.12, -0.08, 0.0])
    (u, v), _ = CAMERA.project(transform_points(SKEWED, corner))[0].reshape(2), None
    residual = RESIDUAL_KINDS["pattern_corner"].residual(CAMERA, BOARD)
    assert value(residual, SKEWED, u, v, *corner, *ALIKE, 5.0) == pytest.approx([0, 0], abs=1e-10)


def test_a_corner_seen_right_of_and_below_its_place_has_a_positive_residual_in_sigmas():
    """The corner is at (0.3, -0.3, 2) m, camera: u = 640 + 800 · 0.15, v = 480 - 810 · 0.15."""
    residual = RESIDUAL_KINDS["pattern_corner"].residual(PINHOLE, BOARD)
    numbers = (760 + 3, 358.5 - 4, 0.1, 0.2, 0.0, *ALIKE)
    assert value(residual, T_CAMERA_TARGET, *numbers, 1.0) == pytest.approx([3, -4], abs=1e-10)
    assert value(residual, T_CAMERA_TARGET, *numbers, 1 / 0.02) == pytest.approx(
        [150, -200], abs=1e-8
    )


def test_a_target_moved_to_the_right_pulls_the_corner_residual_to_the_left():
    """1 cm at 2 m is 4 px."""
    residual = RESIDUAL_KINDS["pattern_corner"].residual(PINHOLE, BOARD)
    moved = make_pose(t=[0.01, 0, 0]) @ T_CAMERA_TARGET
    assert value(residual, moved, 760, 358.5, 0.1, 0.2, 0, *ALIKE, 1.0) == pytest.approx(
        [-4, 0], abs=1e-10
    )


def test_a_corner_known_better_across_than_along_is_off_by_its_own_sigmas():
    """σ 0.01 px along (0.6, 0.8) and 0.03 px across it."""
    axes = np.array([[0.6, -0.8], [0.8, 0.6]])
    covariance = axes @ np.diag([0.01**2, 0.03**2]) @ axes.T
    sigma = np.sqrt(np.trace(covariance) / 2)
    upper = sigma * np.linalg.cholesky(np.linalg.inv(covariance)).T
    residual = RESIDUAL_KINDS["pattern_corner"].residual(PINHOLE, BOARD)
    whiten = (upper[0, 0], upper[0, 1], upper[1, 1])
    for axis, sigmas in ((axes[:, 0], 1 / 0.01), (axes[:, 1], 1 / 0.03)):
        u, v = 760 + 0.05 * axis[0], 358.5 + 0.05 * axis[1]
        found = value(residual, T_CAMERA_TARGET, u, v, 0.1, 0.2, 0, *whiten, 1 / sigma)
        assert np.linalg.norm(found) == pytest.approx(0.05 * sigmas, rel=1e-6)


# --- equation 2: the measured point against the target's surface


def test_a_return_on_the_face_of_a_board_has_no_residual():
    p = transform_points(T_LIDAR_TARGET, [0.3, 0.4, 0.0])
    residual = RESIDUAL_KINDS["target_surface"].residual(LIDAR, BOARD)
    assert value(residual, T_LIDAR_TARGET, *p, 100.0) == pytest.approx([0], abs=1e-12)


def test_a_return_before_the_face_of_a_board_has_a_positive_residual_in_sigmas():
    """The board faces the lidar; a return 3 cm short of it lies on its positive side."""
    p = transform_points(T_LIDAR_TARGET, [0.3, 0.4, 0.0])
    residual = RESIDUAL_KINDS["target_surface"].residual(LIDAR, BOARD)
    assert p[0] == pytest.approx(2.0) and T_LIDAR_TARGET[:3, 2] == pytest.approx([-1, 0, 0])
    short, long = (p * (1 + d / np.linalg.norm(p)) for d in (-0.03, 0.03))
    assert value(residual, T_LIDAR_TARGET, *short, 1.0) == pytest.approx([0.03], rel=1e-7)
    assert value(residual, T_LIDAR_TARGET, *long, 100.0) == pytest.approx([-3], rel=1e-7)


def test_a_board_moved_away_leaves_its_returns_on_its_positive_side():
    p = transform_points(T_LIDAR_TARGET, [0.3, 0.4, 0.0])
    away = make_pose(t=[0.05, 0, 0]) @ T_LIDAR_TARGET
    residual = RESIDUAL_KINDS["target_surface"].residual(LIDAR, BOARD)
    cosine = p[0] / np.linalg.norm(p)
    assert value(residual, away, *p, 1.0) == pytest.approx([0.05 / cosine], rel=1e-7)


@pytest.mark.parametrize("late", [0, 0.02, -0.02])
def test_a_return_late_by_some_centimetres_is_off_by_them_whatever_the_incidence(late):
    q = np.array([0.3, 0.06, -0.08])  # on the side that SKEWED turns towards the lidar or away
    q *= np.where(invert_pose(SKEWED)[:3, 3] @ (q * [0, 1, 1]) > 0, 1, [1, -1, -1])
    p = transform_points(SKEWED, q)
    beam = p / np.linalg.norm(p)
    cosine = -(SKEWED[:3, :3] @ (q * [0, 10, 10])) @ beam
    residual = RESIDUAL_KINDS["target_surface"].residual(LIDAR, CYLINDER)
    found = value(residual, SKEWED, *(p + late * beam), 50.0)
    assert cosine > 0.3
    assert found == pytest.approx([-50 * late], rel=0.01, abs=1e-9)


# --- the ends of a cylinder


@pytest.mark.parametrize("late", [0, 0.02, -0.02])
def test_a_return_on_an_end_late_by_some_centimetres_is_off_by_them(late):
    """The end at -x faces a lidar 2 m before it, 0.3 m beside the axis."""
    T = make_pose(t=[2.4, 0.3, 0.0])
    beam = transform_points(T, [-0.4, 0.02, 0.05])
    beam /= np.linalg.norm(beam)
    p = transform_points(T, [-0.4, 0.02, 0.05]) + late * beam
    residual = RESIDUAL_KINDS["cylinder_cap"].residual(LIDAR, CYLINDER)
    assert value(residual, T, *p, -1, 50.0) == pytest.approx([-50 * late], rel=1e-6, abs=1e-7)
    keypoints = {"xyz": p[None], "sigma": np.full(1, 0.02), "feature_index": [0]}
    options = {"gate_sigma": 6.0, "edge_margin_m": 0.02, "min_cosine": 0.3}
    found = RESIDUAL_KINDS["cylinder_cap"].assign(
        LIDAR, CYLINDER, T, keypoints, options=options, noise=Noise(1.0, 0.0)
    )
    assert found.feature[0] == 0 and found.residual[0] == pytest.approx([-late], abs=1e-8)
    assert found.cos_incidence[0] == pytest.approx(beam[0])


@pytest.mark.parametrize(
    "q", [[-0.4, 0.09, 0.0], [-0.4, 0.2, 0.0], [-0.1, 0.0, 0.1], [0.4, 0.0, 0.05]]
)
def test_a_return_at_the_rim_on_the_side_or_behind_is_on_no_end(q):
    T = make_pose(t=[2.4, 0.3, 0.0])
    keypoints = {"xyz": transform_points(T, q)[None], "sigma": np.full(1, 0.01)}
    keypoints["feature_index"] = [0]
    options = {"gate_sigma": 6.0, "edge_margin_m": 0.02, "min_cosine": 0.3}
    found = RESIDUAL_KINDS["cylinder_cap"].assign(
        LIDAR, CYLINDER, T, keypoints, options=options, noise=Noise(1.0, 0.0)
    )
    assert found.feature[0] == -1


# --- edges: the direction of a crossing against the plane through the lidar and the edge

EDGE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)  # from a to b, target frame: along x


def test_a_ray_through_an_edge_has_no_residual():
    ray = transform_points(SKEWED, [0.7, 0, 0])
    ray /= np.linalg.norm(ray)
    assert value(EDGE_RESIDUAL, SKEWED, *ray, *EDGE, 0.0, 9.0) == pytest.approx([0], abs=1e-14)


def test_a_ray_past_an_edge_is_off_by_its_angle_signed_by_the_side_in_sigmas():
    """The edge from (0, 0, 2) to (1, 0, 2): the normal of its plane with the lidar is (0, 2, 0)."""
    T = make_pose(t=[0, 0, 2.0])
    angle = 0.01
    ray = np.array([0, np.sin(angle), np.cos(angle)])
    sine = np.sin(angle)
    residual = EDGE_RESIDUAL
    assert value(residual, T, *ray, *EDGE, 0.0, 1.0) == pytest.approx([sine], abs=1e-12)
    assert value(residual, T, *(ray * [1, -1, 1]), *EDGE, 0.0, 200.0) == pytest.approx(
        [-200 * sine]
    )
    turned = EDGE[3:] + EDGE[:3]
    assert value(residual, T, *ray, *turned, 0.0, 1.0) == pytest.approx([-sine], abs=1e-12)
    assert value(residual, T, *ray, *EDGE, sine, 1.0) == pytest.approx([0], abs=1e-12)


def test_the_residual_of_an_edge_does_not_depend_on_how_far_along_it_or_away_it_is():
    for scale, shift in ((1, 0.0), (3, 0.0), (1, 0.4)):
        T = make_pose(t=[shift, 0, 2.0 * scale])
        ray = np.array([0, np.sin(0.01), np.cos(0.01)])
        assert value(EDGE_RESIDUAL, T, *ray, *EDGE, 0.0, 1.0) == pytest.approx([np.sin(0.01)])


# --- the limb of a cylinder


def limb_ray(T, along, side):
    """A ray that touches CYLINDER at T on one side, `along` m from its middle."""
    axis, centre = T[:3, 0], T[:3, 3] + along * T[:3, 0]
    across = np.cross(axis, centre)
    distance = np.linalg.norm(across)
    across /= distance
    toward = np.cross(across, axis)
    sine = CYLINDER.radius / (centre @ toward)
    touch = centre - CYLINDER.radius * (sine * toward + side * np.sqrt(1 - sine**2) * -across)
    return touch / np.linalg.norm(touch)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("along", [-0.3, 0.0, 0.2])
def test_a_ray_that_touches_the_cylinder_has_no_residual_on_its_own_side_only(side, along):
    residual = RESIDUAL_KINDS["cylinder_limb"].residual(CAMERA, CYLINDER)
    ray = limb_ray(SKEWED, along, side)
    found = {s: value(residual, SKEWED, *ray, s, 1.0, 1.0)[0] for s in (-1, 1)}
    assert min(np.abs(list(found.values()))) == pytest.approx(0, abs=1e-12)
    assert max(np.abs(list(found.values()))) == pytest.approx(2 * CYLINDER.radius, abs=1e-12)


def test_a_limb_seen_a_pixel_outside_its_place_has_a_residual_of_a_pixel():
    """Axis along y, 2 m ahead: the limb is where the tangent is, and a pixel 1/800 there."""
    T = make_pose(np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]]), [0, 0, 2.0])
    uv = np.array([[640 + 800 * np.tan(np.arcsin(0.05)), 480.0]])
    columns = {"uv": uv + [1, 0], "sigma": np.ones(1)}
    for side in (-1, 1):
        keypoints = columns | {"feature_index": np.array([side])}
        options = {"gate_sigma": 6.0, "edge_margin_m": 0.02}
        found = RESIDUAL_KINDS["cylinder_limb"].assign(
            PINHOLE, CYLINDER, T, keypoints, options=options, noise=Noise(1.0, 0.0)
        )
        if found.feature[0] >= 0:
            residual = RESIDUAL_KINDS["cylinder_limb"].residual(PINHOLE, CYLINDER)
            assert found.residual[0, 0] == pytest.approx(1.0, abs=0.01)
            assert value(residual, T, *found.weighted_data[:, 0]) == pytest.approx(
                found.residual[0]
            )
            break
    else:
        raise AssertionError("on neither side")


# --- all kinds

KINDS = {
    "pattern_corner": (
        RESIDUAL_KINDS["pattern_corner"].residual(CAMERA, BOARD),
        (700, 400, 0.1, 0.2, 0.0, 0.9, 0.1, 1.1, 2.0),
    ),
    "target_surface of a board": (
        RESIDUAL_KINDS["target_surface"].residual(LIDAR, BOARD),
        (0.3, -0.2, 2.4, 30.0),
    ),
    "target_surface of a cylinder": (
        RESIDUAL_KINDS["target_surface"].residual(LIDAR, CYLINDER),
        (0.3, -0.2, 2.4, 30.0),
    ),
    "cylinder_cap": (
        RESIDUAL_KINDS["cylinder_cap"].residual(LIDAR, CYLINDER),
        (0.3, -0.2, 2.4, 1, 30.0),
    ),
    "board_outline": (EDGE_RESIDUAL, (0.0, 0.1, 0.99, 0, 0, 0, 1, 0, 0, 0.002, 40.0)),
    "cylinder_limb": (
        RESIDUAL_KINDS["cylinder_limb"].residual(CAMERA, CYLINDER),
        (0.1, 0.2, 0.97, -1, 300.0, 5.0),
    ),
    "template_point": (
        RESIDUAL_KINDS["template_point"].residual(LIDAR, BOARD),
        (0.3, -0.2, 2.4, 0.1, 0.2, 0, 30.0),
    ),
    "template_vertex": (
        RESIDUAL_KINDS["template_vertex"].residual(LIDAR, BOARD),
        (0.3, -0.2, 2.4, 0.1, 0.2, 0, 30.0),
    ),
    "template_silhouette": (
        RESIDUAL_KINDS["template_silhouette"].residual(CAMERA, CYLINDER),
        (700, 400, 0.1, 0.2, 0.0, 1, 0, 1, 2.0),
    ),
}
every_kind = pytest.mark.parametrize("residual, numbers", KINDS.values(), ids=KINDS.keys())


def test_every_kind_has_its_numbers_named():
    assert set(RESIDUAL_KINDS) == {name.split()[0] for name in KINDS}
    for name, (made, numbers) in KINDS.items():
        names = RESIDUAL_KINDS[name.split()[0]].DATA_COLUMNS
        assert len(names) == len(numbers)
        assert names[-1] == "weight"
        assert np.isfinite(value(made, SKEWED, *numbers)).all()


@every_kind
def test_no_weight_takes_a_measurement_out(residual, numbers):
    assert (value(residual, SKEWED, *numbers[:-1], 0.0) == 0).all()
    found = kernel_values(residual, [*numbers[:-1], 0.0], 3.0, SKEWED)
    assert all((np.asarray(v) == 0).all() for v in found.values())


def kernel_values(residual, numbers, gate, T):
    """Cost, gradient and information with the loss ending at gate, σ."""
    kernel = make_residual_function(residual, len(numbers))
    r, J = (np.array(out) for out in kernel(ca.DM(T[:3]), ca.DM(numbers)))
    size = np.linalg.norm(r, axis=0)
    cost = tukey_cost(size, np.ones(1), gate)
    weight, none = tukey_weight(size, gate), np.zeros((0, *r.shape))
    part = Factor(T, r, J[:, :, None], none, weight, cost, np.arange(6), np.eye(6))
    return {"cost": cost, "gradient": part.pose_gradient, "information": part.pose_information}


def jacobian(residual, numbers, T, h=1e-6):
    """Derivative of a residual by the right perturbation of T, by central differences."""
    steps = h * np.eye(6)
    moves = [
        value(residual, T @ se3_exp(d), *numbers) - value(residual, T @ se3_exp(-d), *numbers)
        for d in steps
    ]
    return np.column_stack(moves) / (2 * h)


@every_kind
@pytest.mark.parametrize("gate", [100.0, 2.0, 1.1, 0.5], ids=lambda g: f"{g} times the residual")
def test_the_gradient_is_that_of_finite_differences_of_the_cost(residual, numbers, gate):
    gate *= np.linalg.norm(value(residual, SKEWED, *numbers))
    found = kernel_values(residual, numbers, gate, SKEWED)

    def at(xi):
        return kernel_values(residual, numbers, gate, SKEWED @ se3_exp(xi))["cost"]

    h = 1e-5
    slopes = [(at(h * e) - at(-h * e)) / (2 * h) for e in np.eye(6)]
    r, J = value(residual, SKEWED, *numbers), jacobian(residual, numbers, SKEWED)
    assert found["gradient"] == pytest.approx(slopes, abs=1e-5 * np.abs(J.T @ r).max())


@every_kind
def test_far_below_the_gate_the_cost_is_half_the_square(residual, numbers):
    r, J = value(residual, SKEWED, *numbers), jacobian(residual, numbers, SKEWED)
    found = kernel_values(residual, numbers, 1e4 * np.linalg.norm(r), SKEWED)
    assert found["cost"] == pytest.approx(r @ r / 2, rel=1e-6)
    small = 1e-6 * np.abs(J.T @ J).max()
    assert found["gradient"] == pytest.approx(J.T @ r, abs=1e-6 * np.abs(J.T @ r).max())
    assert found["information"] == pytest.approx(J.T @ J, abs=small)


@every_kind
@pytest.mark.parametrize("gate", [3.0, 1.5, 1.05, 0.5], ids=lambda g: f"{g} times the residual")
def test_one_weight_of_the_loss_is_in_gradient_and_information(residual, numbers, gate):
    r, J = value(residual, SKEWED, *numbers), jacobian(residual, numbers, SKEWED)
    found = kernel_values(residual, numbers, gate * np.linalg.norm(r), SKEWED)
    gradient, information = J.T @ r, J.T @ J
    weight = found["gradient"] @ gradient / (gradient @ gradient)
    assert 0 <= weight < 1
    assert found["gradient"] == pytest.approx(weight * gradient, abs=1e-6 * np.abs(gradient).max())
    small = 1e-6 * np.abs(information).max()
    assert found["information"] == pytest.approx(weight * information, abs=small)


# --- CasADi functions over arrays


@every_kind
def test_a_kernel_over_arrays_is_the_kernel_of_each(residual, numbers):
    kernel = make_residual_function(residual, len(numbers))
    many = np.array(numbers)[:, None] * np.array([1.0, 1.01, 0.97])
    r, J = vectorize_casadi_function(kernel)(SKEWED[:3].T.reshape(-1), many)
    for i in range(3):
        one = [np.array(o).T.reshape(-1) for o in kernel(ca.DM(SKEWED[:3]), ca.DM(many[:, i]))]
        for found, expected in zip((r, J), one, strict=True):
            found = [np.broadcast_to(v, 3)[i] for v in found]
            assert found == pytest.approx(expected, rel=1e-13, abs=1e-12)


def test_an_instruction_without_a_numpy_function_is_refused_by_its_number():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="has no NumPy function"):
        vectorize_casadi_function(ca.Function("f", [x], [ca.erf(x)]))


# --- equation 1: the chain of poses

POSES = se3_exp(
    np.array(
        [[0.3, 0.1, 0.6, 0.2, -0.4, 1.5], [2, 1, -0.5, -1, 0.3, 2], [0.01, -0.02, 0, 0.1, 0, -0.2]]
    )
)
SIGMA = np.concatenate([np.ones(12), 1e-4 * np.arange(2, 14)])
X = np.random.default_rng(0).normal(size=24) * np.array([0.1] * 12 + [2.0] * 12)


def chained(x):
    """T_sensor_target with the sensor, the mount, the robot's pose and the body's moved by x."""
    T_robot_sensor, T_robot_body, T_body_target = POSES
    sensor, mount, robot, body = se3_exp((SIGMA * x).reshape(4, 6))
    robot_target = invert_pose(robot) @ T_robot_body @ body @ T_body_target @ mount
    return invert_pose(T_robot_sensor @ sensor) @ robot_target


@pytest.mark.parametrize(
    "x", [np.zeros(24), *np.diag(X), X], ids=lambda x: f"{np.count_nonzero(x)}"
)
def test_the_chain_is_that_of_the_poses_with_all_four_corrected(x):
    found = np.array(make_chain_function()(x, SIGMA, *POSES))
    assert found == pytest.approx(chained(x)[:3], abs=1e-14)


@pytest.mark.parametrize("x", [np.zeros(24), X], ids=["at zero", "elsewhere"])
def test_the_chains_derivative_is_that_of_finite_differences_by_the_right_perturbation(x):
    T, h = chained(x), 1e-5
    _, slopes = make_condensed_cost()
    found = np.array(slopes(x, SIGMA, *POSES, T[:3], np.zeros(6), np.zeros((6, 6)))[2])
    moves = [
        se3_log(invert_pose(T) @ chained(x + s)) - se3_log(invert_pose(T) @ chained(x - s))
        for s in h * np.eye(24)
    ]
    expected = np.column_stack(moves) / (2 * h)
    assert found.shape == (6, 24)
    assert found / SIGMA == pytest.approx(expected / SIGMA, abs=1e-6)


def test_the_condensed_cost_has_its_own_slope_and_the_gauss_newton_hessian():
    rng, h = np.random.default_rng(1), 1e-6
    g, H = rng.normal(size=6), np.diag(rng.uniform(1, 2, 6))
    cost, slopes = make_condensed_cost()
    given = SIGMA, *POSES, chained(np.zeros(24))[:3], g, H
    gradient, hessian, B, eta = (np.array(o) for o in slopes(X, *given))
    found = [float(cost(X + s, *given) - cost(X - s, *given)) / (2 * h) for s in h * np.eye(24)]
    assert gradient[:, 0] == pytest.approx(found, abs=1e-8)
    assert hessian == pytest.approx(B.T @ H @ B, abs=1e-12)
    assert gradient[:, 0] == pytest.approx(B.T @ (g + H @ eta[:, 0]), abs=1e-12)
    assert float(cost(np.zeros(24), *given)) == pytest.approx(0, abs=1e-15)


# --- the whole problem, on recorded vertices of a lidar and their pixels (ROB 101 of Michigan)


GATE = 1e4  # σ: a thousand times the largest residual


def rob101():
    """Vertices (13, 3), m, and pixels (13, 2) of pairs 36 to 48, and the camera."""
    X = loadmat(find_shared_data("umich_rob101/X_train.mat"))["X_train"][:3].T.copy()
    Y = loadmat(find_shared_data("umich_rob101/Y_train.mat"))["Y_train"][:2].T.copy()
    camera = CameraModel("radtan", (616.368, 616.745, 319.935, 243.639, 0, 0, 0, 0), (640, 480))
    return X[35:48], Y[35:48], camera


EXACT = 1e-12  # σ of a motion capture without error


def corners_of(points, pixels, T_sensor_target, camera):
    """The Assignment of pixels (n, 2), σ 1 px, to points (n, 3) of a target."""
    n = len(points)
    return Assignment(
        candidate_feature=np.arange(n),
        geometric_weight=np.ones(n),
        repeat_group=np.arange(n),
        keypoint_sigma=np.ones(n),
        residual=pixels - camera.project(transform_points(T_sensor_target, points))[0],
        range=np.ones(n),
        cos_incidence=np.ones(n),
        data=np.column_stack([pixels, points, np.tile(ALIKE, (n, 1))]),
        noise=Noise(1.0, 0.0),
        gate_sigma=GATE,
    )


NONE = np.zeros(0, int)  # numbers of θ


def solved(points, views, camera, T_robot_sensor, sigma=EXACT, prior=None):
    """(T_robot_sensor, MCS errors x (m,), cost, information, success) of one camera with pixels
    (n, 2) of a target at the robot's origin in each view; prior: mean and weight (6,) of the start.
    """
    n, eye = 6 + 12 * len(views), np.eye(4)
    blocks = [
        FactorLayout(
            "camera", "pattern_corner", "none", np.r_[0:6, [n] * 6, 6 + 12 * k : 18 + 12 * k], NONE
        )
        for k in range(len(views))
    ]
    programme = JointNlp(
        models={"camera": camera},
        targets={"none": None},
        layouts=blocks,
        n_chain_unknowns=n,
        n_correction_values=0,
    )
    T, x, shift = T_robot_sensor, np.zeros(n), np.zeros(6)
    scale = np.concatenate([np.ones(6), np.tile(np.broadcast_to(sigma, 6), 2 * len(views))])
    mean, weight = np.zeros(n), np.concatenate([np.zeros(6), np.ones(n - 6)])
    for _ in range(12):
        same = np.repeat(eye[None], len(views), 0)
        poses = LinearizationPoses(np.repeat(T[None], len(views), 0), same, same)
        errors = (scale * x)[6:].reshape(-1, 2, 6)
        T_camera_target = [invert_pose(T) @ invert_pose(se3_exp(a)) @ se3_exp(b) for a, b in errors]
        pairs = zip(views, T_camera_target, strict=True)
        assigned = [corners_of(points, pixels, where, camera) for pixels, where in pairs]
        if prior:
            mean[:6], weight[:6] = prior[0] + shift, prior[1]
        fixed = [np.zeros((0, 2, len(points)))] * len(views)
        parts = programme.linearize(
            x=x,
            scale=scale,
            poses=poses,
            assignments=assigned,
            correction_derivatives=fixed,
            view_error_priors=[ViewErrorPrior(None, None)] * len(views),
        )
        found = programme.solve(
            factors=parts, x=x, scale=scale, poses=poses, prior=Prior(mean, weight)
        )
        T, shift, x = T @ se3_exp(found.x[:6]), shift + found.x[:6], found.x.copy()
        x[:6] = 0
    cost = sum(p.cost for p in parts)
    return T, scale * x, cost, joint_information(parts, weight), found.has_converged


def seen_from(points, pixels, camera):
    """T_camera_target by OpenCV, as a start."""
    fx, fy, cx, cy = camera.params[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    _, w, t = cv2.solvePnP(points, pixels, K, None, flags=cv2.SOLVEPNP_SQPNP)
    return make_pose(cv2.Rodrigues(w)[0], t[:, 0])


@pytest.mark.parametrize("off", [np.zeros(6), np.array([0.1, -0.1, 0.2, 0.1, -0.15, 0.1])])
def test_the_optimum_of_rob101_is_12_11_square_pixels(off):
    points, pixels, camera = rob101()
    start = invert_pose(seen_from(points, pixels, camera) @ se3_exp(off))
    T, _, cost, _, success = solved(points, [pixels], camera, start)
    assert success
    assert 2 * cost == pytest.approx(12.11, abs=0.01)
    uv, valid = camera.project(transform_points(invert_pose(T), points))
    assert valid.all()
    assert np.sum((uv - pixels) ** 2) == pytest.approx(2 * cost, rel=1e-6)


def test_the_information_of_rob101_is_that_of_finite_differences():
    points, pixels, camera = rob101()
    start = invert_pose(seen_from(points, pixels, camera))
    T, _, _, information, _ = solved(points, [pixels], camera, start)
    h = 1e-6

    def uv(xi):
        return camera.project(transform_points(invert_pose(T @ se3_exp(xi)), points))[0].reshape(-1)

    J = np.column_stack([(uv(h * e) - uv(-h * e)) / (2 * h) for e in np.eye(6)])
    assert information[:6, :6] == pytest.approx(J.T @ J, abs=1e-5 * np.abs(J.T @ J).max())


# --- the whole problem, made


def made(seed=0, noise=0.0):
    """Corners and pixels of PINHOLE at SKEWED, T_sensor_target; noise in px."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(5)), -1).reshape(-1, 2) * 0.08
    points = np.column_stack([grid, np.zeros(30)])
    pixels = PINHOLE.project(transform_points(SKEWED, points))[0]
    return points, pixels + noise * rng.normal(size=(30, 2))


def test_the_truth_is_the_optimum_of_data_without_noise():
    points, pixels = made()
    start = invert_pose(SKEWED) @ se3_exp(np.array([0.03, -0.03, 0.03, 0.08, -0.08, 0.08]))
    T, _, cost, _, success = solved(points, [pixels], PINHOLE, start)
    assert success
    assert np.abs(se3_log(SKEWED @ T)).max() < 1e-6  # 0.001 mm
    assert cost < 1e-6


def test_a_prior_draws_the_sensor_towards_it_in_proportion_to_what_it_knows():
    """A prior as sure as the data, for the optimum to lie halfway in the metric of both."""
    points, pixels = made()
    T, _, _, plain, _ = solved(points, [pixels], PINHOLE, invert_pose(SKEWED))
    sigma = np.full(6, 1e-4)
    mean = np.array([1e-4, 0, 0, 0, 0, 0])  # how far the start lies beyond the prior
    found, _, _, both, _ = solved(points, [pixels], PINHOLE, T, prior=(mean, 1 / sigma))
    weight = np.diag(sigma**-2)
    expected = -np.linalg.solve(plain[:6, :6] + weight, weight @ mean)
    assert se3_log(invert_pose(T) @ found) == pytest.approx(expected, abs=1e-8)
    assert both[:6, :6] == pytest.approx(plain[:6, :6] + weight, abs=1e-5 * both.max())


def test_an_error_of_the_motion_capture_takes_its_share_of_the_residuals_by_its_sigma():
    """Two placements 1 cm apart by their pixels and not by the MCS: the MCS errors absorb it."""
    points, pixels = made()
    moved = SKEWED @ make_pose(t=[0.01, 0, 0])
    other = PINHOLE.project(transform_points(moved, points))[0]
    sigma = np.array([0.5] * 3 + [1e-9] * 3)
    _, errors, _, _, success = solved(points, [pixels, other], PINHOLE, invert_pose(SKEWED), sigma)
    assert success
    (robot, body), (robot_2, body_2) = errors[6:].reshape(2, 2, 6)[:, :, :3]
    assert (body_2 - robot_2) - (body - robot) == pytest.approx([0.01, 0, 0], abs=2e-5)
    found = [v[0] for v in (robot, body, robot_2, body_2)]
    assert found == pytest.approx([0.0025, -0.0025, -0.0025, 0.0025], abs=2e-5)
