"""Every camera model against its inverse, its CasADi expression, OpenCV, and cameras of others."""

import json
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from calib.estimation.nlp.symbolic_chain import ca
from calib.geometry.se3 import so3_exp
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel
from helpers.real_data import find_shared_data

F = (400, 410, 319.5, 239.5)
FAR_PX = 6400
# By model: lenses from mild to extreme, params after fx fy cx cy.
LENSES = {
    "radtan": {
        "pinhole": (0, 0, 0, 0),
        "barrel": (-0.28, 0.09, 0.0006, -0.0004),
        "euroc": (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
        "turning": (-0.35, 0.02, 0.001, -0.002),
        "turning k3": (-0.1, -0.05, 0.001, 0.0005, -0.02),
        "pincushion": (0.12, 0.03, -0.001, 0.001, 0.004),
        "webcam": (0.05, -0.12, 0.001, -0.001, 0.04),
    },
    "kannala_brandt": {
        "equidistant": (0, 0, 0, 0),
        "tumvi": (0.003482, 0.000715, -0.002053, 0.000203),
        "turning": (0.02, -0.03, 0.004, -0.001),
        "turning early": (-0.15, -0.02, 0, 0),
        "t265": (-0.00623, 0.0409, -0.0381, 0.0064),
    },
    "double_sphere": {
        "pinhole": (0, 0),
        "tumvi": (-0.172, 0.593),
        "narrow": (0.3, 0.3),
        "negative": (-0.25, 0.5),
        "wide": (0.1, 0.8),
        "unified": (0, 0.6),
    },
}
CAMERAS = {
    f"{model} {name}": CameraModel(model, F + lens, (640, 480))
    for model, lenses in LENSES.items()
    for name, lens in lenses.items()
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())

angles = st.floats(0, np.pi)
turns = st.floats(-np.pi, np.pi)
distances = st.floats(-3, 3).map(lambda e: 10.0**e)


def point(theta, phi, distance):
    """(1, 3), m: theta, rad, off the optical axis, phi about it."""
    s = np.sin(theta)
    return distance * np.array([[s * np.cos(phi), s * np.sin(phi), np.cos(theta)]])


@cache
def symbolic(camera):
    """CasADi function of (x, y, z): pixel (2), derivative (2, 3)."""
    p = ca.SX.sym("p", 3)
    uv = ca.vertcat(*CAMERA_MODELS[camera.model].project(camera.params, p[0], p[1], p[2]))
    return ca.Function("project", [p], [uv, ca.jacobian(uv, p)])


def slope(camera, p, h=1e-6):
    """Least of how far the pixels (n,) move, px, per rad that the rays to p (n, 3) turn."""
    ray = p / np.linalg.norm(p, axis=1)[:, None]
    first = np.cross(ray, np.where(np.abs(ray[:, :1]) < 0.7, [1, 0, 0], [0, 1, 0]))
    first /= np.linalg.norm(first, axis=1)[:, None]
    aside = first, np.cross(ray, first)
    moves = [camera.project(ray + h * a)[0] - camera.project(ray - h * a)[0] for a in aside]
    return np.linalg.svd(np.stack(moves, -1) / (2 * h), compute_uv=False)[:, -1]


# --- the registry


def test_every_model_has_lenses_to_be_tested_with():
    assert set(LENSES) == set(CAMERA_MODELS)


# --- there and back


@every_camera
@given(angles, turns, distances)
@settings(max_examples=50, deadline=None)
def test_every_ray_of_the_domain_comes_back_from_its_pixel(camera, theta, phi, distance):
    """But for the rim, where the pixel stands still, and pixels 10 images away."""
    p = point(theta, phi, distance)
    uv, valid = camera.project(p)
    if not valid[0] or np.abs(uv).max() > FAR_PX or slope(camera, p) < 0.05 * F[0]:
        return
    ray, ok = camera.unproject(uv)
    assert ok[0]
    assert np.linalg.norm(ray) == pytest.approx(1, abs=1e-12)
    off = np.linalg.norm(np.cross(ray[0], p[0] / distance))
    assert off < 1e-9 and ray[0] @ p[0] > 0


@every_camera
@given(st.floats(-0.5, 639.5), st.floats(-0.5, 479.5))
@settings(max_examples=40, deadline=None)
def test_every_pixel_that_has_a_ray_comes_back_from_it(camera, u, v):
    ray, ok = camera.unproject([[u, v]])
    assert np.isfinite(ray).all()
    if ok[0]:
        uv, valid = camera.project(3.7 * ray)
        assert valid[0] or slope(camera, ray) < 0.05 * F[0]
        assert uv[0] == pytest.approx([u, v], abs=1e-6)


@every_camera
def test_all_rays_of_the_domain_come_back_in_one_call(camera):
    theta, phi = np.meshgrid(np.linspace(0, np.pi, 200), np.linspace(0, 6.2, 20))
    ray = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    p = 2 * np.stack(ray, -1).reshape(-1, 3)
    uv, valid = camera.project(p)
    steep = slope(camera, p) > 0.05 * F[0]
    use = valid & steep & (np.abs(uv).max(1) < FAR_PX)
    ray, ok = camera.unproject(uv[use])
    assert ok.all()
    assert np.abs(ray - p[use] / 2).max() < 1e-9


@every_camera
def test_the_centre_of_the_image_looks_along_z(camera):
    ray, ok = camera.unproject([[319.5, 239.5]])
    assert ok[0] and ray[0] == pytest.approx([0, 0, 1], abs=1e-12)


@every_camera
def test_x_is_right_and_y_is_down(camera):
    uv, valid = camera.project([[0, 0, 2], [0.1, 0, 2], [0, 0.1, 2]])
    assert valid.all()
    assert uv[0] == pytest.approx([319.5, 239.5])
    assert uv[1, 0] > 330 and uv[2, 1] > 250


# --- one source for arrays and expressions


@every_camera
@given(angles, turns, distances)
@settings(max_examples=25, deadline=None)
def test_the_casadi_expression_equals_numpy(camera, theta, phi, distance):
    p = point(theta, phi, distance)
    uv, valid = camera.project(p)
    found = np.array(symbolic(camera)(p[0])[0]).reshape(-1)
    assert np.isfinite(found).all()
    if valid[0]:
        assert found == pytest.approx(uv[0], abs=1e-9, rel=1e-12)


@every_camera
@pytest.mark.parametrize("aside", [0, 1e-300, 1e-160, 1e-12, 1e-9, 1e-8, 1e-6, 1e-3])
def test_the_derivative_on_and_near_the_axis_is_that_of_a_pinhole(camera, aside):
    fx, fy = np.diff(camera.project([[0, 0, 1], [1e-6, 1e-6, 1]])[0], axis=0)[0] * 1e6
    p = np.array([aside, -aside, 2.0])
    found = np.array(symbolic(camera)(p)[1])
    assert found == pytest.approx(np.array([[fx, 0, 0], [0, fy, 0]]) / 2, abs=1e-3 + 2e3 * aside)


@every_camera
@given(angles, turns)
@settings(max_examples=25, deadline=None)
def test_the_derivative_is_that_of_finite_differences(camera, theta, phi):
    p = point(theta, phi, 2.0)
    if not camera.project(p)[1][0] or not 0.05 * F[0] < slope(camera, p) < 1e4:
        return
    found, h = np.array(symbolic(camera)(p[0])[1]), 1e-6
    near = [camera.project(np.vstack([p + h * e, p - h * e]))[0] for e in np.eye(3)]
    expected = np.column_stack([(a - b) / (2 * h) for a, b in near])
    assert found == pytest.approx(expected, abs=1e-3, rel=1e-4)


# --- nothing is ever not a number, and nothing is seen that is not


HARD = {
    "the centre": (0, 0, 0),
    "on the axis": (0, 0, 1),
    "on the axis, near": (0, 0, 1e-12),
    "behind, on the axis": (0, 0, -1),
    "behind": (0.3, -0.2, -1),
    "beside": (1, 0, 0),
    "beside and above": (0.2, -5, 0),
    "just behind": (1, 1, -1e-9),
    "far": (1e6, -1e6, 1e6),
    "far behind": (1e6, -1e6, -1e6),
    "grazing": (1e3, 0, 1e-9),
}


@every_camera
@pytest.mark.parametrize("p", HARD.values(), ids=HARD.keys())
def test_no_point_gives_a_pixel_or_a_derivative_that_is_not_a_number(camera, p):
    uv, _ = camera.project([p])
    assert np.isfinite(uv).all()
    value, derivative = symbolic(camera)(p)
    assert np.isfinite(np.array(value)).all() and np.isfinite(np.array(derivative)).all()


@every_camera
def test_the_centre_of_the_camera_is_not_seen(camera):
    assert not camera.project([[0, 0, 0]])[1][0]


@every_camera
def test_no_pixel_gives_a_ray_that_is_not_a_number(camera):
    grid = np.array([-1e6, -1e3, -0.5, 319.5, 320, 639.5, 1e3, 1e6])
    uv = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    assert np.isfinite(camera.unproject(uv)[0]).all()


@every_camera
@pytest.mark.parametrize("phi", [0, 0.8, 2.5, -1.9])
def test_the_image_never_folds_over_in_the_domain(camera, phi):
    """Neighbouring rays keep their order from the axis to where the domain ends, once."""
    theta = np.linspace(1e-3, np.pi - 1e-3, 4000)
    ray = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    out = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)], -1)
    around = np.cross(ray, out)
    valid = camera.project(ray)[1]
    assert valid[0] and (np.diff(valid.astype(int)) <= 0).all()
    h = 1e-6
    moves = [camera.project(ray + h * d)[0] - camera.project(ray - h * d)[0] for d in (out, around)]
    along, across = (m[valid] for m in moves)
    order = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    assert (order > -1e-12).all()


@pytest.mark.parametrize("name", LENSES["radtan"])
def test_radtan_sees_nothing_beside_or_behind_itself(name):
    camera = CAMERAS[f"radtan {name}"]
    p = [[0, 0, -1], [0.1, 0, -1], [1, 0, 0], [1, 0, 1e-10], [1e-3, 1e-3, -5]]
    assert not camera.project(p)[1].any()


def test_radtan_sees_nothing_beyond_the_radius_at_which_it_turns_back():
    """1 - 3·0.35 s + 5·0.02 s² = 0 at s = tan² θ = 1.0592."""
    turn = np.sqrt((1.05 - np.sqrt(1.05**2 - 0.4)) / 0.2)
    camera = CameraModel("radtan", F + (-0.35, 0.02, 0, 0), (640, 480))
    p = [[turn - 1e-6, 0, 1], [turn + 1e-6, 0, 1], [0, -(turn + 1e-6), 1], [3, 4, 1]]
    assert camera.project(p)[1].tolist() == [True, False, False, False]


def test_a_fisheye_sees_nothing_beyond_the_angle_at_which_its_polynomial_turns_back():
    """1 - 0.45 s - 0.1 s² = 0 at s = θ² = 1.6312."""
    turn = np.sqrt((-0.45 + np.sqrt(0.45**2 + 0.4)) / 0.2)
    camera = CAMERAS["kannala_brandt turning early"]
    p = np.concatenate([point(turn + d, 0.3, 2.0) for d in (-1e-6, 1e-6, 0.5)])
    assert camera.project(p)[1].tolist() == [True, False, False]


def test_a_fisheye_sees_behind_itself_but_not_straight_behind():
    camera = CAMERAS["kannala_brandt equidistant"]
    p = np.concatenate([point(t, 1.0, 2.0) for t in (1.7, 3.0, np.pi)])
    assert camera.project(p)[1].tolist() == [True, True, False]
    assert np.linalg.norm((camera.project(p[:1])[0] - F[2:]) / F[:2]) == pytest.approx(1.7)


@pytest.mark.parametrize("xi, alpha", [(-0.172, 0.593), (0.1, 0.8), (0, 0.6), (0.3, 0.3)])
def test_double_sphere_sees_as_far_as_its_authors_say(xi, alpha):
    """Equation 43 of Usenko et al.: z > -w2 d1."""
    w1 = (1 - alpha) / alpha if alpha > 0.5 else alpha / (1 - alpha)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi**2 + 1)
    limit = np.arccos(-w2)
    camera = CameraModel("double_sphere", (*F, xi, alpha), (640, 480))
    p = np.concatenate([point(limit + d, 0.3, 2.0) for d in (-1e-6, 1e-6)])
    assert camera.project(p)[1].tolist() == [True, False]


@pytest.mark.parametrize("name", ["kannala_brandt turning early", "radtan turning"])
def test_pixels_beyond_what_the_lens_sees_have_no_ray(name):
    assert not CAMERAS[name].unproject([[5000, 240], [320, -5000]])[1].any()


def test_double_sphere_pixels_beyond_what_the_lens_sees_have_no_ray():
    """Radius² above 1 / (2α - 1)."""
    camera = CAMERAS["double_sphere wide"]
    limit = np.sqrt(1 / 0.6)
    uv = [[319.5 + 400 * (limit + d), 239.5] for d in (-1e-6, 1e-6)]
    assert camera.unproject(uv)[1].tolist() == [True, False]


# --- against OpenCV


def cone(limit, n=500):
    """Points (n, 3) up to limit, rad, off the axis."""
    rng = np.random.default_rng(0)
    theta, phi = rng.uniform(0, limit, n), rng.uniform(-np.pi, np.pi, n)
    d = rng.uniform(0.5, 9, n)
    return d[:, None] * np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


K = np.array([[F[0], 0, F[2]], [0, F[1], F[3]], [0, 0, 1]])


@pytest.mark.parametrize("name", LENSES["radtan"])
def test_radtan_is_that_of_opencv_to_1e_9_px(name):
    camera = CAMERAS[f"radtan {name}"]
    p = cone(0.9)
    p = p[camera.project(p)[1]]
    expected = cv2.projectPoints(p, np.zeros(3), np.zeros(3), K, np.array(camera.params[4:]))[0]
    assert len(p) > 300
    assert np.abs(camera.project(p)[0] - expected[:, 0]).max() < 1e-9


@pytest.mark.parametrize("name", LENSES["kannala_brandt"])
def test_kannala_brandt_is_that_of_opencv_to_1e_9_px(name):
    """OpenCV takes x / z, so that it cannot see beyond 90°."""
    camera = CAMERAS[f"kannala_brandt {name}"]
    p = cone(1.5)
    p = p[camera.project(p)[1]]
    distortion = np.array(camera.params[4:])
    zero = np.zeros((1, 1, 3))
    expected = cv2.fisheye.projectPoints(p[:, None], zero, zero, K, distortion)[0]
    assert len(p) > 300
    assert np.abs(camera.project(p)[0] - expected[:, 0]).max() < 1e-9


# --- parameters


@pytest.mark.parametrize(
    "model, n, words",
    [
        ("radtan", 3, "found 3 numbers; radtan takes fx fy cx cy k1 k2 p1 p2 k3 (k3 optional)"),
        ("radtan", 7, "7 numbers"),
        ("radtan", 10, "10 numbers"),
        ("kannala_brandt", 7, "found 7 numbers; kannala_brandt takes fx fy cx cy k1 k2 k3 k4"),
        ("kannala_brandt", 9, "9 numbers"),
        ("double_sphere", 5, "found 5 numbers; double_sphere takes fx fy cx cy xi alpha"),
    ],
)
def test_a_wrong_number_of_params_is_refused_with_what_the_model_takes(model, n, words):
    with pytest.raises(ValueError) as caught:
        CameraModel(model, (1.0,) * n, (640, 480))
    assert words in str(caught.value)


def test_a_left_out_k3_is_zero():
    short = CameraModel("radtan", F + (-0.28, 0.09, 0.001, 0.002), (640, 480))
    assert short == CameraModel("radtan", F + (-0.28, 0.09, 0.001, 0.002, 0), (640, 480))


# --- pixels


def test_pixel_0_0_is_the_centre_of_the_top_left_pixel():
    """A pinhole in the middle of a 2 × 2 image looks at the corner that all four pixels share."""
    camera = CameraModel("radtan", (1, 1, 0.5, 0.5, 0, 0, 0, 0), (2, 2))
    uv, _ = camera.project([[0, 0, 1], [-0.5, -0.5, 1], [0.5, 0.5, 1]])
    assert uv == pytest.approx(np.array([[0.5, 0.5], [0, 0], [1, 1]]))


def test_the_image_ends_half_a_pixel_beyond_the_centres_of_its_outer_pixels():
    camera = CAMERAS["radtan pinhole"]
    inside = [[-0.5, -0.5], [639.5, 479.5], [0, 0], [639, 479]]
    outside = [[-0.51, 5], [5, -0.51], [639.51, 5], [5, 479.51], [640, 480]]
    assert camera.is_in_image(inside).all()
    assert not camera.is_in_image(outside).any()


def test_a_margin_moves_the_border_inwards_and_a_negative_one_outwards():
    camera = CAMERAS["radtan pinhole"]
    assert camera.is_in_image([[9.5, 9.5], [629.5, 469.5]], 10).all()
    assert not camera.is_in_image([[9.4, 20], [629.6, 20], [20, 9.4], [20, 469.6]], 10).any()
    assert (
        camera.is_in_image([[-10.5, 0]], -10).all()
        and not camera.is_in_image([[-10.6, 0]], -10).any()
    )


# --- against a lens that two others calibrated


def tumvi(name):
    """Parameters of TUM-VI's camera 0 by basalt."""
    with find_shared_data(f"cameras/tumvi_512_{name}_calib.json").open() as stream:
        return json.load(stream)["value0"]["intrinsics"][0]["intrinsics"]


def field_of_view():
    """Rays and pixels of TUM-VI's camera 0 up to 80° off its axis, by TUM's own parameters."""
    params = (190.978, 190.973, 254.932, 256.897, 0.003482, 0.000715, -0.002053, 0.000203)
    pixels = 8.0 * np.stack(np.meshgrid(np.arange(64), np.arange(64)), -1).reshape(-1, 2)
    rays, ok = CameraModel("kannala_brandt", params, (512, 512)).unproject(pixels)
    use = ok & (rays[:, 2] > np.cos(np.radians(80)))
    return rays[use], pixels[use]


def basalt_double_sphere():
    k = tumvi("ds")
    params = [k[name] for name in CAMERA_MODELS["double_sphere"].PARAMETER_NAMES]
    return CameraModel("double_sphere", params, (512, 512))


def test_double_sphere_and_kannala_brandt_of_one_lens_agree_to_0_3_px_rms_per_axis():
    """Two calibrations, by others, of TUM-VI's camera 0, after a small rotation."""
    camera = basalt_double_sphere()
    rays, pixels = field_of_view()

    def off(w):
        uv, valid = camera.project(rays @ so3_exp(w).T)
        assert valid.all()
        return (uv - pixels).reshape(-1)

    fit = least_squares(off, np.zeros(3))
    assert len(pixels) > 3000
    assert np.degrees(np.linalg.norm(fit.x)) < 1
    assert np.sqrt(np.mean(fit.fun**2)) < 0.3


def test_double_sphere_and_the_extended_unified_model_of_one_lens_agree_to_0_011_px_rms():
    """Khomutenko et al. 2016: d = √(β r² + z²), u = fx x / (α d + (1 - α) z) + cx."""
    k = tumvi("eucm")
    rays, _ = field_of_view()
    x, y, z = rays.T
    depth = k["alpha"] * np.sqrt(k["beta"] * (x * x + y * y) + z * z) + (1 - k["alpha"]) * z
    expected = np.stack([k["fx"] * x / depth + k["cx"], k["fy"] * y / depth + k["cy"]], -1)
    off = basalt_double_sphere().project(rays)[0] - expected
    assert np.sqrt(np.mean(np.sum(off**2, 1))) < 0.011
