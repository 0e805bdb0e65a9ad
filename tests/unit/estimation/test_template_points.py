"""The paper's own method: templates, their files, ICP, pairs of nearest points, the estimate."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree

from calib.estimation.estimate_state import initial_state
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.measurement_assignment import count_reassignments
from calib.estimation.noise.noise_estimation import estimate_mocap_factor
from calib.estimation.problem_assembly import iteration_limits
from calib.estimation.residuals import template_silhouette
from calib.estimation.residuals.assignment import Noise
from calib.estimation.residuals.nearest_point import template_point_residual
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS, uses_template_points
from calib.estimation.residuals.template_silhouette import find_rim_points
from calib.estimation.solver import estimate_poses
from calib.extraction.camera_keypoints import extract_color_contour
from calib.extraction.extraction_inputs import ExtractionContext
from calib.extraction.lidar_keypoints import extract_template_keypoints
from calib.geometry.icp import register_template_icp
from calib.geometry.polygon import polygon_contains, sample_polygon_outline, signed_polygon_distance
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    se3_exp,
    se3_log,
    so3_exp,
    transform_points,
)
from calib.io.config import load_config, validate_and_complete
from calib.io.status import InputError
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.board import Board
from calib.targets.color import Color
from calib.targets.cylinder import Cylinder
from calib.targets.point_template import (
    PointTemplate,
    point_template_from_config,
    read_template_file,
)
from calib.targets.target_shapes import target_from_config
from calib.targets.template_cloud import TemplateCloud

SPACING = 0.005  # m
LIDAR = LidarModel(np.radians(0.2), np.radians(2.0), None, None, (0.3, 100.0), 0.01)
PINHOLE = CameraModel("radtan", (800.0, 800.0, 449.5, 349.5, 0, 0, 0, 0), (900, 700))
GATE = {"gate_sigma": 6.0}
SQUARE = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
DIAMOND = np.array([[0.7, 0], [0, 0.7], [-0.7, 0], [0, -0.7]])
CONCAVE = np.array([[0.0, 0], [0.4, 0], [0.4, 0.3], [0.2, 0.1], [0, 0.3]])  # a notch from above
OUTLINES = {"square": SQUARE, "diamond": DIAMOND, "concave": CONCAVE}
every_outline = pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES.keys())
every_spacing = pytest.mark.parametrize("spacing", [0.005, 0.03])


def by_points(shape, spacing=SPACING, keypoints="all"):
    """A shape that is compared by a template made from it."""
    block = {"spacing_m": spacing, "keypoints": keypoints}
    return replace(shape, point_template=point_template_from_config(block, shape))


BOARD = by_points(Board(SQUARE, 0.0, None))
CYLINDER = by_points(Cylinder(0.8, 0.1))
# A board 2 m ahead that faces the sensor, which looks along x, but for a turn.
FACING = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
T_BOARD = make_pose(so3_exp([0.1, -0.2, 0.3]) @ FACING, [2, 0.1, 0.5])


def off(T, T_true):
    """Translation (3,), mm, and rotation (3,), deg, of T seen from the true pose."""
    xi = se3_log(invert_pose(T_true) @ T)
    return xi[:3] * 1e3, np.degrees(xi[3:])


# --- templates made from a shape


@every_outline
@every_spacing
def test_the_template_of_a_board_covers_it_and_ends_where_it_ends(outline, spacing):
    template = Board(outline, 0.01, None).sample_surface(spacing)
    assert (template[:, 2] == 0).all()
    assert signed_polygon_distance(outline, template[:, :2]).max() < 1e-12
    assert cKDTree(template[:, :2]).query(outline)[0].max() < 1e-12
    inside = np.random.default_rng(0).uniform(outline.min(0), outline.max(0), (2000, 2))
    inside = inside[polygon_contains(outline, inside)]
    assert cKDTree(template[:, :2]).query(inside)[0].max() <= spacing
    assert cKDTree(template).query(template, k=2)[0].max() <= spacing + 1e-12


@every_outline
@pytest.mark.parametrize("spacing", [0.005, 0.03, 2.0])
def test_points_along_an_outline_are_at_most_the_spacing_apart_and_hold_its_corners(
    outline, spacing
):
    found = sample_polygon_outline(outline, spacing)
    steps = np.linalg.norm(np.roll(found, -1, 0) - found, axis=1)
    assert steps.max() <= spacing + 1e-12
    assert cKDTree(found).query(outline)[0].max() < 1e-12


@every_spacing
def test_the_template_of_a_cylinder_lies_on_its_side_and_caps_and_covers_both(spacing):
    half, radius = 0.4, 0.1
    template = Cylinder(2 * half, radius).sample_surface(spacing)
    away, along = np.hypot(*template[:, 1:].T), np.abs(template[:, 0])
    on_side = (np.abs(away - radius) < 1e-12) & (along <= half)
    on_cap = (np.abs(along - half) < 1e-12) & (away <= radius)
    assert (on_side | on_cap).all()
    rng = np.random.default_rng(0)
    x, around = rng.uniform(-half, half, 2000), rng.uniform(-np.pi, np.pi, 2000)
    r = np.where(np.arange(2000) % 2, radius, radius * np.sqrt(rng.uniform(0, 1, 2000)))
    x[r < radius] = np.copysign(half, x[r < radius])
    surface = np.column_stack([x, r * np.cos(around), r * np.sin(around)])
    assert cKDTree(template).query(surface)[0].max() <= spacing
    assert cKDTree(template).query(template, k=2)[0].max() <= spacing + 1e-12


def test_the_shape_that_config_describes_gets_its_template_only_where_it_asks_for_points():
    block = {"shape": "cylinder", "length_m": 0.8, "radius_m": 0.1}
    assert target_from_config(block).point_template is None
    asked = block | {"method": "points", "points": {"keypoints": "all", "spacing_m": 0.02}}
    found = target_from_config(asked).point_template
    assert np.array_equal(found.xyz, Cylinder(0.8, 0.1).sample_surface(0.02))
    assert (found.spacing, found.keypoint_mode) == (0.02, "all")
    assert target_from_config(asked | {"method": "surface"}).point_template is None


# --- templates from files


def written(path, template):
    """The path of a cloud (n, 3) that Open3D wrote."""
    import open3d as o3d

    assert o3d.io.write_point_cloud(
        str(path), o3d.geometry.PointCloud(o3d.utility.Vector3dVector(template))
    )
    return path


@pytest.mark.parametrize("ending, digits", [("ply", 1e-15), ("pcd", 1e-7)])
def test_a_template_is_read_back_as_it_was_written(tmp_path, ending, digits):
    """PLY holds doubles, PCD floats."""
    template = CYLINDER.sample_surface(0.05)
    path = written(tmp_path / f"rod.{ending}", template)
    found = read_template_file(path)
    assert len(found) == len(template)
    assert cKDTree(found).query(template)[0].max() < digits
    block = {"template_file": str(path), "spacing_m": 9.0, "keypoints": "all"}
    found = point_template_from_config(block, None)
    between = np.median(cKDTree(template).query(template, k=2)[0][:, 1])
    assert found.spacing == pytest.approx(between, abs=1e-6)  # the file's, not the stated


def test_a_template_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(
        InputError, match=r"none\.ply: template file not found\. Set points\.template_file"
    ):
        read_template_file(tmp_path / "none.ply")


@pytest.mark.parametrize("name", ["empty.ply", "empty.pcd", "empty.stl"])
def test_an_empty_file_is_no_template(tmp_path, name):
    (tmp_path / name).write_text("")
    with pytest.raises(InputError, match=rf"{name}: no header of a \.pcd or \.ply file"):
        read_template_file(tmp_path / name)


def test_three_points_are_no_template(tmp_path):
    with pytest.raises(InputError, match="few.ply: 3 points"):
        read_template_file(written(tmp_path / "few.ply", np.eye(3)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_template_with_a_point_that_is_nowhere_is_refused(tmp_path, bad):
    template = CYLINDER.sample_surface(0.1)
    template[3, 1] = bad
    with pytest.raises(InputError, match="bad.ply: .* points, or some not finite; expected"):
        read_template_file(written(tmp_path / "bad.ply", template))


# --- config

ROD = {"body": "b", "shape": "cylinder", "length_m": 0.8, "radius_m": 0.1, "method": "points"}
PLATE = {"body": "b", "shape": "board", "outline_m": SQUARE.tolist(), "method": "points"}
CLOUD = {"body": "b", "shape": "cloud", "method": "points"}
RIG = """
body: robot
mocap: {topics: [/tf], map: map, pose_sigma: {xyz_m: 0.0002, rpy_deg: 0.02}}
sensors: {lidar: {kind: lidar, topic: /points}}
"""


def complete(target):
    return validate_and_complete("target", copy.deepcopy(target), "t.yaml")


def refusal(target):
    with pytest.raises(InputError) as caught:
        complete(target)
    return str(caught.value)


def test_a_target_is_compared_with_its_surface_unless_it_says_otherwise():
    without = {k: v for k, v in PLATE.items() if k != "method"}
    assert complete(without)["method"] == "surface"
    assert complete(PLATE)["points"] == {"keypoints": "all", "spacing_m": 0.005}
    assert complete(PLATE | {"points": {"keypoints": "corners"}})["points"]["spacing_m"] == 0.005
    assert complete(CLOUD | {"points": {"template_file": "a.ply"}})["points"]["keypoints"] == "all"


@pytest.mark.parametrize(
    "target, words",
    [
        (ROD | {"points": {"keypoints": "corners"}}, "points.keypoints: 'all' was expected"),
        (ROD | {"points": {"spacing": 1}}, "points: unknown key spacing. Did you mean spacing_m?"),
        (ROD | {"points": {"spacing_m": 0}}, "points.spacing_m: 0 is less than or equal to"),
        (PLATE | {"points": {"sha256": "0"}}, "points: unknown key sha256. Known: keypoints, "),
        (PLATE | {"points": {"keypoints": "edges"}}, "points.keypoints: 'edges' is not one of"),
        (PLATE | {"method": "icp"}, "method: 'icp' is not one of ['surface', 'points']"),
        (CLOUD, "t.yaml: top level: missing key points"),
        (CLOUD | {"points": {}}, "t.yaml: points: missing key template_file"),
        (
            CLOUD | {"points": {"template_file": "a.ply", "keypoints": "corners"}},
            "points.keypoints: 'all' was expected",
        ),
        (
            CLOUD | {"points": {"template_file": "a.ply"}, "method": "surface"},
            "method: 'points' was expected",
        ),
        (
            CLOUD | {"points": {"template_file": "a.ply"}, "radius_m": 1},
            "top level: unknown key radius_m. Known: ",
        ),
    ],
)
def test_a_block_that_makes_no_sense_is_refused_with_its_path(target, words):
    assert words in refusal(target)


@pytest.fixture
def folder(tmp_path):
    """A config folder of one cloud, whose template lies beside it."""
    for name in ("rigs", "targets"):
        (tmp_path / "config" / name).mkdir(parents=True)
    (tmp_path / "config/rigs/r.yaml").write_text(RIG)
    block = CLOUD | {"points": {"template_file": str(tmp_path / "chair.ply")}}
    (tmp_path / "config/targets/chair.yaml").write_text(yaml.safe_dump(block))
    return tmp_path


def loaded(folder):
    """The `points` block of the folder's target."""
    content = {"sessions": {"s": {"rig": "r", "log": "x.mcap"}}}
    return load_config(content, str(folder / "config"))[2]["chair"]["points"]


def test_a_template_that_is_not_there_is_refused_on_loading_with_its_path(folder):
    message = r"targets/chair\.yaml: points\.template_file: no file .*chair\.ply in "
    with pytest.raises(InputError, match=message):
        loaded(folder)


def test_a_template_is_known_by_its_content_whatever_its_age(folder):
    path = folder / "chair.ply"
    path.write_text("one")
    first = loaded(folder)
    path.touch()
    assert loaded(folder) == first
    path.write_text("two")
    assert loaded(folder)["sha256"] != first["sha256"]
    path.write_text("one")
    assert loaded(folder) == first


def test_what_was_loaded_makes_the_target_of_its_template(folder):
    template = CYLINDER.sample_surface(0.05)
    written(folder / "chair.ply", template)
    block = CLOUD | {"points": loaded(folder)}
    found = target_from_config(block)
    assert isinstance(found, TemplateCloud)
    assert cKDTree(found.point_template.xyz).query(template)[0].max() < 1e-15


def test_points_that_a_template_file_holds_twice_count_once(tmp_path):
    template = CYLINDER.sample_surface(0.05)
    path = written(tmp_path / "twice.ply", np.concatenate([template, template]))
    assert len(read_template_file(path)) == len(template)


# --- ICP


def face(n, half=0.5, seed=0):
    """Points (n, 3) at random on the face of the board, no farther from its middle than half, m."""
    flat = np.random.default_rng(seed).uniform(-half, half, (n, 2))
    return np.column_stack([flat, np.zeros(n)])


def side(n, spread, seed=0):
    """Points (n, 3) at random on the side of the cylinder, up to spread, rad, around from +y."""
    x, a = np.random.default_rng(seed).uniform(-1, 1, (2, n)) * [[0.4], [spread]]
    return np.column_stack([x, 0.1 * np.cos(a), 0.1 * np.sin(a)])


def laid(target, q, error):
    """off() of the template that ICP lays on returns at q (n, 3) from a start that is off."""
    start = T_BOARD @ se3_exp(error)
    return off(
        register_template_icp(target.point_template, transform_points(T_BOARD, q), start), T_BOARD
    )


@pytest.mark.parametrize(
    "error",
    [
        (0, 0, 0.03, 0, 0, 0),
        (0, 0, 0.03, np.radians(3), 0, 0),
        (0, 0, -0.02, np.radians(2), np.radians(-2.2), 0),
    ],
    ids=["3 cm before it", "3 cm before it and leaning 3°", "2 cm behind it and leaning 3°"],
)
def test_icp_finds_the_plane_of_a_board_to_0_1_mm(error):
    mm, deg = laid(BOARD, face(400), error)
    assert abs(mm[2]) < 0.1 and np.abs(deg[:2]).max() < 0.01
    assert np.abs(mm).max() < 3 and np.abs(deg).max() < 0.5  # in the plane it is no better


def test_icp_finds_a_cylinder_that_is_seen_from_one_side_to_0_1_mm():
    mm, deg = laid(CYLINDER, side(600, 1.2), (0, 0.02, 0, 0, 0, 0))
    assert np.abs(mm).max() < 0.1 and np.abs(deg[1:]).max() < 0.1


def test_icp_does_not_bring_back_what_slid_inside_a_board():
    """The paper's weakness: returns that end 10 cm inside the outline pull nowhere along it."""
    mm, _ = laid(BOARD, face(400, 0.4), (0.03, 0, 0, 0, 0, 0))
    assert mm[0] == pytest.approx(30, abs=1.5)
    _, deg = laid(BOARD, face(400, 0.3), (0, 0, 0, 0, 0, np.radians(3)))
    assert deg[2] == pytest.approx(3, abs=0.2)


def test_icp_with_nothing_near_leaves_the_pose_alone():
    far = (0, 0, 1.0, 0, 0, 0)
    mm, _ = laid(BOARD, face(50, 0.1), far)
    assert mm == pytest.approx([0, 0, 1000], abs=1e-9)


# --- what extraction makes of it


def extracted(q, keypoints, error=(0,) * 6, min_points=20):
    """(keypoint columns, status) of returns at q (n, 3) on the board, one view."""
    p, n = transform_points(T_BOARD, q), len(q)
    views = {"view": [0], "stamp_ns": [0], "target": ["board"], "placement": [0]}
    views |= {"point_time_ns": [np.zeros(n, int)], "ring": [np.zeros(n, int)]}
    views |= {"intensity": [np.full(n, np.nan)]}
    views |= {"xyz": [p.reshape(-1)]}
    target = replace(BOARD, point_template=replace(BOARD.point_template, keypoint_mode=keypoints))
    place = Placement("s", "board", T_BOARD, np.eye(4), np.zeros(6))
    options = {"min_points": min_points}
    T_guess = T_BOARD @ invert_pose(T_BOARD @ se3_exp(error))
    parts = ("lidar", LIDAR, {"board": target}, {0: place}, T_guess, None, None, options, {}, {})
    return extract_template_keypoints(ExtractionContext(*parts), views, 0, np.arange(n))


def test_all_returns_near_the_template_are_keypoints_with_the_noise_of_both():
    q = np.concatenate([face(100), [[0, 0, 0.5], [0, 0, -0.3]]])
    columns, status, _ = extracted(q, "all")
    assert status.ok and set(columns["kind"]) == {"template_point"}
    assert np.abs(columns["xyz"] - transform_points(T_BOARD, q[:100])).max() < 1e-12
    assert columns["sigma"] == pytest.approx(np.full(100, np.hypot(0.01, SPACING)))


def test_fewer_returns_near_the_template_than_are_asked_for_are_too_few():
    columns, status, _ = extracted(face(30), "all", min_points=31)
    assert columns is None and str(status).startswith("too few returns near the template; found 30")


def test_the_corners_that_icp_laid_on_a_whole_board_are_near_its_own():
    columns, status, _ = extracted(face(900), "corners", (0.003, 0.003, 0.02, 0.02, 0.02, 0))
    assert status.ok and set(columns["kind"]) == {"template_vertex"}
    found = transform_points(invert_pose(T_BOARD), columns["xyz"])
    away = np.abs(found - BOARD.outline_points()).max(0)
    assert away[2] < 1e-4 and away[:2].max() < 0.005  # in the plane about as it started
    assert columns["sigma"] == pytest.approx(np.full(4, np.hypot(0.01, SPACING)))


def test_a_return_off_the_template_spoils_the_corners():
    _, status, _ = extracted(np.concatenate([face(100), [[0, 0, 0.05]]]), "corners")
    assert str(status).startswith("returns do not fit the template; found a return 0.0")


def test_all_of_a_contour_is_measured_where_a_target_is_compared_by_points():
    """Not its straight sides alone: the caps tell how far along its axis a cylinder lies."""
    T = make_pose(so3_exp([0, 0.3, 0.4]), [0, 0, 2])
    uv, _ = PINHOLE.project(transform_points(T, CYLINDER.point_template.xyz))
    image = np.full((700, 900, 3), 120, np.uint8)
    hull = cv2.convexHull((16 * uv).round().astype(np.int32))
    cv2.fillConvexPoly(image, hull, (40, 180, 40), cv2.LINE_AA, 4)
    color = {"hue_deg": [90, 150], "saturation": [0.3, 1], "value": [0.15, 1]}
    found = {}
    for target in (CYLINDER, replace(CYLINDER, point_template=None)):
        target = replace(target, color=Color.from_config(color))
        place = Placement("s", "rod", T, np.eye(4), np.zeros(6))
        parts = ("camera", PINHOLE, {"rod": target}, {0: place}, np.eye(4), None, None, {}, {}, {})
        views = {
            "view": [0],
            "stamp_ns": [0],
            "target": ["rod"],
            "placement": [0],
            "u0": [0],
            "v0": [0],
        }
        columns, status, _ = extract_color_contour(ExtractionContext(*parts), views, 0, image)
        assert status.ok
        found[columns["kind"][0]] = columns["uv"]
    ends, _ = PINHOLE.project(transform_points(T, np.array([[0.4, 0, 0], [-0.4, 0, 0]])))
    reached = {k: cKDTree(v).query(ends)[0].max() for k, v in found.items()}
    assert set(found) == {"template_silhouette", "cylinder_limb"}
    assert len(found["template_silhouette"]) > len(found["cylinder_limb"])
    assert (
        reached["template_silhouette"] < 20 < reached["cylinder_limb"]
    )  # px, from the middle of a cap


# --- pairs of nearest points


def test_three_kinds_are_measured_against_the_nearest_point():
    assert {k for k in RESIDUAL_KINDS if uses_template_points(k)} == {
        "template_point",
        "template_vertex",
        "template_silhouette",
    }
    for name, kind in RESIDUAL_KINDS.items():
        assert (kind.assign_first is kind.assign) == (not uses_template_points(name))


CORNERS = replace(BOARD, point_template=replace(BOARD.point_template, keypoint_mode="corners"))
COARSE = by_points(Board(CONCAVE, 0.0, None), 0.04)
PAIRED = {
    "template_point": (COARSE, COARSE.point_template.xyz),
    "template_vertex": (CORNERS, CORNERS.outline_points()),
}
paired = pytest.mark.parametrize("kind", PAIRED)


def pairs(kind, q, T_guess, first=False, sigma=0.01):
    """The Assignment of points at q (n, 3) on the target at T_BOARD."""
    keypoints = {"xyz": transform_points(T_BOARD, q), "sigma": np.full(len(q), sigma)}
    function = RESIDUAL_KINDS[kind].assign_first if first else RESIDUAL_KINDS[kind].assign
    return function(LIDAR, PAIRED[kind][0], T_guess, keypoints, options=GATE, noise=Noise(1.0, 0.0))


@paired
def test_points_assigned_before_keep_their_template_points_at_another_pose(kind):
    own = PAIRED[kind][1]
    features = np.arange(len(own))[::-1].copy()
    features[0] = -1
    keypoints = {"xyz": transform_points(T_BOARD, own), "sigma": np.full(len(own), 0.01)}
    found = RESIDUAL_KINDS[kind].assign(
        LIDAR,
        PAIRED[kind][0],
        T_BOARD,
        keypoints,
        options=GATE,
        noise=Noise(1e4, 0.0),
        features=features,
    )
    np.testing.assert_array_equal(found.feature, features)
    np.testing.assert_array_equal(found.data[1:, 3:6], own[features[1:]])


def same(kind, found):
    """Share of the target's points, all measured in order, that are paired with themselves."""
    own = PAIRED[kind][1]
    return np.mean(np.linalg.norm(found.data[:, 3:6] - own, axis=1) < 1e-12)


@paired
@pytest.mark.parametrize("first", [False, True])
def test_the_points_of_a_target_where_they_are_belong_to_themselves_without_residual(kind, first):
    found = pairs(kind, PAIRED[kind][1], T_BOARD, first)
    assert same(kind, found) == 1
    assert np.abs(found.residual).max() < 1e-12 and (found.feature >= 0).all()


@paired
def test_the_first_pass_lays_the_centroids_on_each_other(kind):
    """A guess 0.9 m aside pairs every point with another; the residual stays that of the guess."""
    shift = np.array([0.9, 0, 0, 0, 0, 0])
    guess = T_BOARD @ se3_exp(shift)
    q = PAIRED[kind][1]
    assert same(kind, pairs(kind, q, guess, sigma=1.0)) < 0.7
    found = pairs(kind, q, guess, first=True, sigma=1.0)
    assert same(kind, found) == 1
    assert found.residual == pytest.approx(np.tile(-shift[:3], (len(q), 1)), abs=1e-12)


@paired
def test_a_point_beyond_the_gate_belongs_to_nothing(kind):
    q = PAIRED[kind][1].copy()
    q[:, 2] = 0.059
    q[0, 2] = 0.061
    found = pairs(kind, q, T_BOARD, sigma=0.01)
    assert found.feature[0] == -1 and (found.feature[1:] >= 0).all()
    assert found.weighted_data[-1, 0] == 0 and (found.weighted_data[-1, 1:] == 100).all()


def test_the_residual_is_the_measured_point_minus_that_of_the_target_over_sigma():
    """Equation 2: R (1, 2, 3) is (-2, 1, 3) for a quarter turn about z."""
    R, t = so3_exp([0, 0, np.pi / 2]), np.array([10, 20, 30])
    found = template_point_residual(R, t, np.array([8.5, 21, 32.9, 1, 2, 3, 10]))
    assert np.asarray(found).reshape(-1) == pytest.approx([5, 0, -1], abs=1e-12)


# --- silhouettes


def border(size):
    """A rectangle (n, 2), px, of points 1 px apart, turned; and the depth of points inside it."""
    R = so3_exp([0, 0, 0.4])[:2, :2]
    u, v = (np.arange(-s / 2, s / 2 + 0.1) for s in size)
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    return uv @ R.T, lambda p: -signed_polygon_distance(corners @ R.T, p)


def disc(radius):
    """A disc (n, 2), px, of points 1 px apart, and the depth of points inside it."""
    uv = border((2 * radius, 2 * radius))[0]
    return uv[np.linalg.norm(uv, axis=1) < radius], lambda p: radius - np.linalg.norm(p, axis=1)


DENSE = {"rectangle": border((80, 50)), "disc": disc(30.0), "small disc": disc(5.0)}


@pytest.mark.parametrize("name", DENSE)
@pytest.mark.parametrize("scale", [1.0, 0.02, 7.0])
def test_the_rim_of_points_that_lie_densely_is_their_border(name, scale):
    uv, depth = DENSE[name]
    rim = uv[find_rim_points(scale * uv + [300, 200], scale)]
    assert depth(rim).max() < 1.5
    around = rim[np.argsort(np.arctan2(*rim.T))]
    assert np.linalg.norm(np.roll(around, -1, 0) - around, axis=1).max() < 4


def test_a_hole_inside_is_no_rim():
    uv, depth = DENSE["disc"]
    ring = uv[np.linalg.norm(uv, axis=1) > 15]
    assert depth(ring[find_rim_points(ring, 1.0)]).max() < 1.5


VIEWS = {
    "across, 2 m": ((0, 0, 2), (0, 0, 0)),
    "leaning, 2 m": ((0.1, 0.05, 2), (10, 20, 80)),
    "leaning, 3 m": ((0, 0, 3), (0, -30, 130)),
    "across, 8 m": ((0, 0, 8), (0, 0, 0)),
}


def seen(view, target):
    """Template points (n, 3) on the silhouette of a cylinder, and how far off its limbs, m."""
    at, turn = VIEWS[view]
    T = make_pose(so3_exp(np.radians(turn)), at)
    uv, valid = PINHOLE.project(transform_points(T, target.point_template.xyz))
    assert valid.all() and PINHOLE.is_in_image(uv).all()
    keypoints = {"view": np.zeros(len(uv), int), "uv": uv, "sigma": np.full(len(uv), 1e3)}
    found = template_silhouette.assign(
        PINHOLE, target, T, keypoints, options=GATE, noise=Noise(1.0, 0.0)
    )
    q = target.point_template.xyz[np.unique(found.feature)]
    # The planes through the camera that touch the side have the normals (0, cos, sin) of these.
    _, y, z = invert_pose(T)[:3, 3]
    touching = np.arctan2(z, y) + np.outer([1, -1], np.arccos(0.1 / np.hypot(y, z)))
    normals = np.column_stack([np.cos(touching), np.sin(touching)])
    return q, np.abs(q[:, 1:] @ normals.T - 0.1).min(1)


@pytest.mark.parametrize("view", VIEWS)
def test_the_silhouette_of_a_cylinder_is_its_limbs_to_0_05_mm_on_average_and_its_caps(view):
    """Of lines 5 mm apart on its side, the outermost is at most 0.03 mm inside the limb."""
    q, away = seen(view, CYLINDER)
    on_side = np.abs(q[:, 0]) < 0.4 - 1e-9
    assert on_side.sum() > 200 and (~on_side).sum() > 4
    assert away[on_side].mean() < 5e-5 and away[on_side].max() < 1.5e-4


@pytest.mark.parametrize("view", VIEWS)
def test_the_silhouette_of_a_coarse_template_goes_all_the_way_round(view):
    """Of lines 2 cm apart, the outermost is at most 0.5 mm inside the limb."""
    q, away = seen(view, by_points(Cylinder(0.8, 0.1), 0.02))
    on_side = np.abs(q[:, 0]) < 0.4 - 1e-9
    assert away[on_side].max() < 1e-3
    assert np.diff(np.unique(q[:, 0])).max() < 0.1  # m, along the axis, from cap to cap
    assert np.ptp(q[:, 0]) == pytest.approx(0.8)


def contour_of(T):
    """Pixels (n, 2) of the silhouette of the cylinder, as keypoints, and its template points."""
    rows, uv = template_silhouette._project_silhouette(PINHOLE, CYLINDER, T)
    return {"view": np.zeros(len(uv), int), "uv": uv, "sigma": np.full(len(uv), 0.1)}, rows


def test_the_silhouette_where_it_is_belongs_to_itself_without_residual():
    T = make_pose(so3_exp([0.2, 0.3, 1.4]), [0.1, 0.05, 2])
    keypoints, rows = contour_of(T)
    for function in (template_silhouette.assign, template_silhouette.assign_first):
        found = function(PINHOLE, CYLINDER, T, keypoints, options=GATE, noise=Noise(1.0, 0.0))
        assert np.array_equal(found.feature, rows)
        assert np.abs(found.residual).max() < 1e-9 and not found.cos_incidence.any()
        assert found.data[:, 2:5] == pytest.approx(CYLINDER.point_template.xyz[rows])


def test_the_first_pass_lays_the_centroids_of_the_contours_on_each_other():
    """A guess 6 cm aside along the axis is 24 px off; nearest pairs alone would be 6 cm off too."""
    T = make_pose(so3_exp([0.2, 0.3, 1.4]), [0.1, 0.05, 2])
    keypoints, rows = contour_of(T)
    guess = make_pose(t=[0, 0.06, 0]) @ T
    wrong = []
    for function in (template_silhouette.assign_first, template_silhouette.assign):
        found = function(PINHOLE, CYLINDER, guess, keypoints, options=GATE, noise=Noise(100.0, 0.0))
        off_own = found.data[:, 2:5] - CYLINDER.point_template.xyz[rows]
        wrong.append(np.median(np.linalg.norm(off_own, axis=1)))
        assert (found.feature >= 0).all()
    assert wrong[0] < 0.01 and wrong[1] > 0.05
    value = template_silhouette.assign_first(
        PINHOLE, CYLINDER, guess, keypoints, options=GATE, noise=Noise(100.0, 0.0)
    ).residual
    assert value.mean(0) == pytest.approx([0, -24], abs=2)  # px: 6 cm · 800 px / 2 m


def test_a_target_behind_the_camera_has_no_silhouette():
    T = make_pose(t=[0, 0, 2.0])
    keypoints, _ = contour_of(T)
    behind = make_pose(t=[0, 0, -2.0])
    for function in (template_silhouette.assign, template_silhouette.assign_first):
        found = function(PINHOLE, CYLINDER, behind, keypoints, options=GATE, noise=Noise(1.0, 0.0))
        assert (found.feature == -1).all()


# --- the estimate

TARGETS = {"board": BOARD, "cylinder": CYLINDER}
TRUE = pose_from_rpy([0.1, -0.05, 0.7], [0.02, -0.03, 0.05])  # T_robot_lidar
OFF = se3_exp(np.array([0.02] * 3 + [np.radians(3)] * 3) / np.sqrt(3))  # 2 cm, 3°
TURNS = ((0, 0.7, 0), (0, -0.7, 0), (0, 0, 0.7), (0, 0, -0.7))  # of boards, rad
AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 1), (0, 1, -1))  # of cylinders
PLACES = ((2, -0.3, 0.4), (1.8, 0.3, 0.8), (2.2, 0, 0.6), (1.6, 0.2, 0.5))
MCS_SIGMA = np.repeat([1e-4, np.radians(0.01)], 3)


def keypoint_columns(kind, k, xyz):
    n = len(xyz)
    sigma = np.full(n, np.hypot(LIDAR.range_sigma, SPACING))
    columns = {"view": np.full(n, k), "placement": np.full(n, k), "kind": np.full(n, kind)}
    return columns | {"feature_index": np.zeros(n, int), "xyz": xyz, "sigma": sigma}


def setup(kind, layout, shapes, sigma, mcs=0.0):
    """A Setup without range noise of placements [(target, T_robot_target)]; mcs: errors in σ."""
    rng = np.random.default_rng(0)
    places, groups = [], []
    for k, (name, T) in enumerate(layout):
        robot, body = se3_exp(mcs * MCS_SIGMA * rng.normal(size=(2, 6)))
        said = robot @ T @ invert_pose(body)
        places.append(Placement("s", name, said, np.eye(4), sigma))
        T_lidar_target = invert_pose(TRUE) @ T
        if kind == "template_vertex":
            q = shapes[name].outline_points()
        elif name == "board":
            q = face(200, seed=k)
        else:
            towards = invert_pose(T_lidar_target)[:3, 3]
            turn = so3_exp([np.arctan2(towards[2], towards[1]), 0, 0])
            q = side(200, 1.2, seed=k) @ turn.T
        columns = keypoint_columns(kind, k, transform_points(T_lidar_target, q))
        groups.append(MeasurementGroup("lidar", k, kind, columns))
    return Setup({"lidar": LIDAR}, shapes, places, groups, GATE, {})


def boards():
    turns = [so3_exp(w) @ FACING for w in TURNS]
    return [("board", make_pose(R, at)) for R, at in zip(turns, PLACES, strict=True)]


def cylinders():
    axes = np.array(AXES) / np.linalg.norm(AXES, axis=1, keepdims=True)
    turns = [np.column_stack([x, np.cross(x, -np.eye(3)[0]), -np.eye(3)[0]]) for x in axes]
    return [("cylinder", make_pose(R, at)) for R, at in zip(turns, PLACES[::-1], strict=True)]


SOLVE = {"max_rounds": 100, "tolerance_m": 1e-8, "tolerance_rad": 1e-8}
SOLVE |= {"points_tolerance_m": 1e-5, "points_tolerance_rad": 1e-5}


def estimated(problem):
    """The Result by the options of the solve stage from a start that is off by 2 cm and 3°."""
    start = {"lidar": TRUE @ OFF}
    return estimate_poses(problem, start, **iteration_limits(problem, SOLVE))


def test_the_estimate_by_nearest_points_comes_within_1_mm_and_0_1_deg():
    """Of MCS poses that are all but exact: softer ones give way to each placement's own pairs."""
    layout = boards()[:3] + cylinders()[1:]
    result = estimated(setup("template_point", layout, TARGETS, 1e-2 * MCS_SIGMA))
    mm, deg = off(result.state.T_robot_sensor["lidar"], TRUE)
    assert result.has_converged and len(result.rounds) < 100
    assert np.linalg.norm(mm) < 1 and np.linalg.norm(deg) < 0.1
    assert result.state.mocap_noise_factor == 1
    assert result.rounds[-1]["n_inliers"] == 6 * 200


def test_the_estimate_by_exact_corners_is_exact():
    result = estimated(setup("template_vertex", boards(), TARGETS, MCS_SIGMA))
    mm, deg = off(result.state.T_robot_sensor["lidar"], TRUE)
    assert result.has_converged
    assert np.linalg.norm(mm) < 1e-3 and np.linalg.norm(np.radians(deg)) < 1e-6


def test_targets_compared_by_points_say_nothing_of_the_noise_of_the_mcs():
    """Errors of 5 σ, each known to 0.3 σ; the same against boards that are not show them."""
    found = []
    for board in (BOARD, replace(BOARD, point_template=None)):
        problem = setup("template_vertex", boards(), {"board": board}, MCS_SIGMA)
        state = initial_state(problem, {"lidar": TRUE}, 1.0)
        state.mocap_errors[:] = 5.0
        found.append(estimate_mocap_factor(problem, state, 0.09 * np.eye(problem.n_unknowns)))
    assert found[0] == 1 and 3 < found[1] < 6


def assigned(feature):
    return SimpleNamespace(feature=np.array(feature))


@pytest.mark.parametrize(
    "kind, changed", [("template_point", 2), ("template_silhouette", 2), ("pattern_corner", 3)]
)
def test_a_new_nearest_point_is_no_change_but_coming_and_going_is(kind, changed):
    groups = [MeasurementGroup("s", 0, kind, {})]
    one = Setup({}, {}, [], groups, {}, {})
    before, after = [assigned([4, 5, -1, 7])], [assigned([4, 6, 3, -1])]
    assert count_reassignments(one, before, after) == changed


@pytest.mark.parametrize(
    "names, expected",
    [(["target_surface"], 1e-8), (["target_surface", "template_point"], 1e-5)],
)
def test_the_estimate_settles_sooner_where_anything_is_compared_by_nearest_points(names, expected):
    groups = [MeasurementGroup("s", 0, kind, {}) for kind in names]
    found = iteration_limits(Setup({}, {}, [], groups, {}, {}), SOLVE)
    steps = {"tolerance_m": expected, "tolerance_rad": expected}
    assert found == {"max_rounds": 100, "initial_noise_factor": 10.0, **steps}


# --- a shape that is nothing but its template


def corner_of_a_box():
    """Template (n, 3), 1 cm apart, of three faces 0.4 x 0.3 x 0.2 m that meet in the origin."""
    x, y, z = (np.arange(0, n) / 100 for n in (41, 31, 21))
    faces = (x, y, z[:1]), (x, y[:1], z), (x[:1], y, z)
    grids = [np.stack(np.meshgrid(*f), -1).reshape(-1, 3) for f in faces]
    return np.unique(np.concatenate(grids), axis=0)


BOX = TemplateCloud(PointTemplate(corner_of_a_box(), 0.01, "all"))
FLAT = TemplateCloud(PointTemplate(COARSE.point_template.xyz, 0.04, "all"))
every_cloud = pytest.mark.parametrize("target", [BOX, FLAT], ids=["box", "flat"])


@every_cloud
def test_all_of_a_cloud_lies_within_its_reach_of_its_centre(target):
    template = target.point_template.xyz
    assert np.linalg.norm(template - target.centre, axis=1).max() == pytest.approx(
        target.bounding_radius
    )
    outline = target.outline_points()
    assert cKDTree(template).query(outline)[0].max() == 0
    assert np.ptp(outline, axis=0) == pytest.approx(np.ptp(template, axis=0))


def test_a_cloud_has_the_extents_of_its_points():
    assert BOX.centre == pytest.approx([0.2, 0.15, 0.1])
    assert BOX.bounding_radius == pytest.approx(np.linalg.norm([0.2, 0.15, 0.1]))
    grid = np.stack(np.meshgrid(np.arange(41) / 50, np.arange(21) / 50, [0]), -1).reshape(-1, 3)
    plate = TemplateCloud(PointTemplate(grid @ so3_exp([1, 2, 3]).T, 0.02, "all"))
    assert plate.extents == pytest.approx([0.8, 0.4, 0], abs=1e-12)
    assert plate.area == pytest.approx(0.32)
    assert (np.diff(BOX.extents) <= 0).all()


@every_cloud
def test_a_cloud_is_its_own_template_and_is_seen_from_all_sides_by_no_camera(target):
    assert target.sample_surface(0.5) is target.point_template.xyz
    assert target.check_facing(target.centre + [0, 0, -1.1 * target.bounding_radius]) == (True, 1.0)
    assert not target.check_facing(target.centre + [0, 0.9 * target.bounding_radius, 0])[0]
    assert target.outline_edges().shape == (0, 2, 3) and target.required_image_points().shape == (
        0,
        3,
    )
    assert target.pattern is None and target.color is None
    for name in ("distance", "depth"):
        assert not hasattr(target, name)


T_BOX = make_pose(so3_exp([0.4, -0.5, 0.3]), [2, 0.1, 0.5])
MARGIN = np.repeat([0.05, np.radians(5)], 3)


def scan():
    """Returns (700, 3): 400 on the box without noise, then 300 on a wall 0.6 m behind it."""
    rng = np.random.default_rng(0)
    q = rng.uniform(0, 1, (400, 3)) * [0.4, 0.3, 0.2]
    q[np.arange(400), rng.integers(0, 3, 400)] = 0
    wall = rng.uniform([2.9, -1, 0], [2.9, 1, 1.2], (300, 3))
    return np.concatenate([transform_points(T_BOX, q), wall])


SEARCH = {"range_sigma": LIDAR.range_sigma, "seed": 0}


def test_the_returns_on_a_cloud_are_found_and_a_wall_behind_is_left_out():
    guess = T_BOX @ se3_exp([0.02, -0.01, 0.015, 0.03, 0, -0.02])
    assert np.array_equal(BOX.fit_inliers(scan(), guess, MARGIN, **SEARCH), np.arange(400))


def test_a_wall_alone_is_no_cloud():
    assert len(BOX.fit_inliers(scan()[400:], T_BOX, MARGIN, **SEARCH)) == 0


def test_a_cloud_that_is_turned_farther_than_the_guess_may_be_wrong_is_not_found():
    guess = T_BOX @ se3_exp([0, 0, 0, 0, 0, 0.3])
    assert len(BOX.fit_inliers(scan(), guess, MARGIN, **SEARCH)) == 0
    assert len(BOX.fit_inliers(scan(), guess, 4 * MARGIN, **SEARCH)) > 350
