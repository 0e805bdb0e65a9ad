"""The paper's own method: templates, their files, ICP, pairs of nearest points, the estimate."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree

from calib.estimation import estimate_state, estimation_problem, problem_assembly, solver
from calib.estimation.residuals import nearest_point, residual_registry, template_silhouette
from calib.estimation.residuals.assignment import Noise
from calib.extraction import camera_keypoints, extraction_inputs, lidar_keypoints
from calib.geometry import icp, polygon, se3
from calib.io import config
from calib.io.status import InputError
from calib.sensors.camera.camera_model import Camera
from calib.sensors.lidar import lidar_model
from calib.targets import cylinder, point_template, target_shapes, template_cloud
from calib.targets.board import Board
from calib.targets.color import Color

SPACING = 0.005  # m
LIDAR = lidar_model.Lidar(np.radians(0.2), np.radians(2.0), None, None, (0.3, 100.0), 0.01)
PINHOLE = Camera("radtan", (800.0, 800.0, 449.5, 349.5, 0, 0, 0, 0), (900, 700))
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
    return replace(shape, points=point_template.from_config(block, shape))


BOARD = by_points(Board(SQUARE, 0.0, None))
CYLINDER = by_points(cylinder.Cylinder(0.8, 0.1))
# A board 2 m ahead that faces the sensor, which looks along x, but for a turn.
FACING = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
T_BOARD = se3.pose(se3.so3_exp([0.1, -0.2, 0.3]) @ FACING, [2, 0.1, 0.5])


def off(T, T_true):
    """Translation (3,), mm, and rotation (3,), deg, of T seen from the true pose."""
    xi = se3.se3_log(se3.inverse(T_true) @ T)
    return xi[:3] * 1e3, np.degrees(xi[3:])


# --- templates made from a shape


@every_outline
@every_spacing
def test_the_template_of_a_board_covers_it_and_ends_where_it_ends(outline, spacing):
    template = Board(outline, 0.01, None).template(spacing)
    assert (template[:, 2] == 0).all()
    assert polygon.signed_distance(outline, template[:, :2]).max() < 1e-12
    assert cKDTree(template[:, :2]).query(outline)[0].max() < 1e-12
    inside = np.random.default_rng(0).uniform(outline.min(0), outline.max(0), (2000, 2))
    inside = inside[polygon.contains(outline, inside)]
    assert cKDTree(template[:, :2]).query(inside)[0].max() <= spacing
    assert cKDTree(template).query(template, k=2)[0].max() <= spacing + 1e-12


@every_outline
@pytest.mark.parametrize("spacing", [0.005, 0.03, 2.0])
def test_points_along_an_outline_are_at_most_the_spacing_apart_and_hold_its_corners(
    outline, spacing
):
    found = polygon.along(outline, spacing)
    steps = np.linalg.norm(np.roll(found, -1, 0) - found, axis=1)
    assert steps.max() <= spacing + 1e-12
    assert cKDTree(found).query(outline)[0].max() < 1e-12


@every_spacing
def test_the_template_of_a_cylinder_lies_on_its_side_and_caps_and_covers_both(spacing):
    half, radius = 0.4, 0.1
    template = cylinder.Cylinder(2 * half, radius).template(spacing)
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
    assert target_shapes.from_config(block).points is None
    asked = block | {"method": "points", "points": {"keypoints": "all", "spacing_m": 0.02}}
    found = target_shapes.from_config(asked).points
    assert np.array_equal(found.template, cylinder.Cylinder(0.8, 0.1).template(0.02))
    assert (found.spacing, found.keypoints) == (0.02, "all")
    assert target_shapes.from_config(asked | {"method": "surface"}).points is None


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
    template = CYLINDER.template(0.05)
    path = written(tmp_path / f"rod.{ending}", template)
    found = point_template.read(path)
    assert len(found) == len(template)
    assert cKDTree(found).query(template)[0].max() < digits
    block = {"template_file": str(path), "spacing_m": 9.0, "keypoints": "all"}
    found = point_template.from_config(block, None)
    between = np.median(cKDTree(template).query(template, k=2)[0][:, 1])
    assert found.spacing == pytest.approx(between, abs=1e-6)  # the file's, not the stated


def test_a_template_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.ply: no such template; points\.template_file"):
        point_template.read(tmp_path / "none.ply")


@pytest.mark.parametrize("name", ["empty.ply", "empty.pcd", "empty.stl"])
def test_an_empty_file_is_no_template(tmp_path, name):
    (tmp_path / name).write_text("")
    with pytest.raises(InputError, match=rf"{name}: 0 points.*as \.pcd or \.ply"):
        point_template.read(tmp_path / name)


def test_three_points_are_no_template(tmp_path):
    with pytest.raises(InputError, match="few.ply: 3 points"):
        point_template.read(written(tmp_path / "few.ply", np.eye(3)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_template_with_a_point_that_is_nowhere_is_refused(tmp_path, bad):
    template = CYLINDER.template(0.1)
    template[3, 1] = bad
    with pytest.raises(InputError, match="bad.ply: .* points, or some not finite; expected"):
        point_template.read(written(tmp_path / "bad.ply", template))


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
    return config.complete("target", copy.deepcopy(target), "t.yaml")


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
        (ROD | {"points": {"spacing": 1}}, "points: unknown key spacing; did you mean spacing_m?"),
        (ROD | {"points": {"spacing_m": 0}}, "points.spacing_m: 0 is less than or equal to"),
        (PLATE | {"points": {"sha256": "0"}}, "points: unknown key sha256; known: keypoints, "),
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
            "top level: unknown key radius_m; known: ",
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
    return config.load(content, str(folder / "config"))[2]["chair"]["points"]


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
    template = CYLINDER.template(0.05)
    written(folder / "chair.ply", template)
    block = CLOUD | {"points": loaded(folder)}
    found = target_shapes.from_config(block)
    assert isinstance(found, template_cloud.Cloud)
    assert cKDTree(found.points.template).query(template)[0].max() < 1e-15


def test_points_that_a_template_file_holds_twice_count_once(tmp_path):
    template = CYLINDER.template(0.05)
    path = written(tmp_path / "twice.ply", np.concatenate([template, template]))
    assert len(point_template.read(path)) == len(template)


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
    start = T_BOARD @ se3.se3_exp(error)
    return off(icp.icp(target.points, se3.transform(T_BOARD, q), start), T_BOARD)


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
    p, n = se3.transform(T_BOARD, q), len(q)
    views = {"view": [0], "t": [0], "target": ["board"], "placement": [0]}
    views |= {"dt": [np.zeros(n, int)], "ring": [np.zeros(n, int)]}
    target = replace(BOARD, points=replace(BOARD.points, keypoints=keypoints))
    place = estimation_problem.Placement("s", "board", T_BOARD, np.eye(4), np.zeros(6))
    options = {"min_points": min_points}
    T_guess = T_BOARD @ se3.inverse(T_BOARD @ se3.se3_exp(error))
    parts = ("lidar", LIDAR, {"board": target}, {0: place}, T_guess, None, None, options, {}, {})
    return lidar_keypoints.by_template(extraction_inputs.Job(*parts), views, 0, p, np.arange(n))


def test_all_returns_near_the_template_are_keypoints_with_the_noise_of_both():
    q = np.concatenate([face(100), [[0, 0, 0.5], [0, 0, -0.3]]])
    columns, status = extracted(q, "all")
    assert status.ok and set(columns["kind"]) == {"point"}
    assert np.abs(columns["xyz"] - se3.transform(T_BOARD, q[:100])).max() < 1e-12
    assert columns["sigma"] == pytest.approx(np.full(100, np.hypot(0.01, SPACING)))


def test_fewer_returns_near_the_template_than_are_asked_for_are_too_few():
    columns, status = extracted(face(30), "all", min_points=31)
    assert columns is None and str(status).startswith("too few returns near the template; found 30")


def test_the_corners_that_icp_laid_on_a_whole_board_are_near_its_own():
    columns, status = extracted(face(900), "corners", (0.003, 0.003, 0.02, 0.02, 0.02, 0))
    assert status.ok and set(columns["kind"]) == {"vertex"}
    found = se3.transform(se3.inverse(T_BOARD), columns["xyz"])
    away = np.abs(found - BOARD.outline_points()).max(0)
    assert away[2] < 1e-4 and away[:2].max() < 0.005  # in the plane about as it started
    assert columns["sigma"] == pytest.approx(np.full(4, np.hypot(0.01, SPACING)))


def test_a_return_off_the_template_spoils_the_corners():
    _, status = extracted(np.concatenate([face(100), [[0, 0, 0.05]]]), "corners")
    assert str(status).startswith("returns do not fit the template; found a return 0.0")


def test_all_of_a_contour_is_measured_where_a_target_is_compared_by_points():
    """Not its straight sides alone: the caps tell how far along its axis a cylinder lies."""
    T = se3.pose(se3.so3_exp([0, 0.3, 0.4]), [0, 0, 2])
    uv, _ = PINHOLE.project(se3.transform(T, CYLINDER.points.template))
    image = np.full((700, 900, 3), 120, np.uint8)
    hull = cv2.convexHull((16 * uv).round().astype(np.int32))
    cv2.fillConvexPoly(image, hull, (40, 180, 40), cv2.LINE_AA, 4)
    color = {"hue_deg": [90, 150], "saturation": [0.3, 1], "value": [0.15, 1]}
    found = {}
    for target in (CYLINDER, replace(CYLINDER, points=None)):
        target = replace(target, color=Color.from_config(color))
        place = estimation_problem.Placement("s", "rod", T, np.eye(4), np.zeros(6))
        parts = ("camera", PINHOLE, {"rod": target}, {0: place}, np.eye(4), None, None, {}, {}, {})
        views = {"view": [0], "t": [0], "target": ["rod"], "placement": [0], "u0": [0], "v0": [0]}
        columns, status = camera_keypoints.contour(extraction_inputs.Job(*parts), views, 0, image)
        assert status.ok
        found[columns["kind"][0]] = columns["uv"]
    ends, _ = PINHOLE.project(se3.transform(T, np.array([[0.4, 0, 0], [-0.4, 0, 0]])))
    reached = {k: cKDTree(v).query(ends)[0].max() for k, v in found.items()}
    assert set(found) == {"silhouette", "limb"}
    assert len(found["silhouette"]) > len(found["limb"])
    assert reached["silhouette"] < 20 < reached["limb"]  # px, from the middle of a cap


# --- pairs of nearest points


def test_three_kinds_are_measured_against_the_nearest_point():
    assert {k for k in residual_registry.KINDS if residual_registry.by_nearest_point(k)} == {
        "point",
        "vertex",
        "silhouette",
    }
    for name, kind in residual_registry.KINDS.items():
        assert residual_registry.first(name) is (
            kind.first if residual_registry.by_nearest_point(name) else kind.assign
        )


CORNERS = replace(BOARD, points=replace(BOARD.points, keypoints="corners"))
COARSE = by_points(Board(CONCAVE, 0.0, None), 0.04)
PAIRED = {"point": (COARSE, COARSE.points.template), "vertex": (CORNERS, CORNERS.outline_points())}
paired = pytest.mark.parametrize("kind", PAIRED)


def pairs(kind, q, T_guess, first=False, sigma=0.01):
    """The Assignment of points at q (n, 3) on the target at T_BOARD."""
    keypoints = {"xyz": se3.transform(T_BOARD, q), "sigma": np.full(len(q), sigma)}
    function = residual_registry.first(kind) if first else residual_registry.KINDS[kind].assign
    return function(LIDAR, PAIRED[kind][0], T_guess, keypoints, GATE, Noise(1.0, 0.0))


def same(kind, found):
    """Share of the target's points, all measured in order, that are paired with themselves."""
    own = PAIRED[kind][1]
    return np.mean(np.linalg.norm(found.numbers[:, 3:6] - own, axis=1) < 1e-12)


@paired
@pytest.mark.parametrize("first", [False, True])
def test_the_points_of_a_target_where_they_are_belong_to_themselves_without_residual(kind, first):
    found = pairs(kind, PAIRED[kind][1], T_BOARD, first)
    assert same(kind, found) == 1
    assert np.abs(found.value).max() < 1e-12 and (found.feature >= 0).all()


@paired
def test_the_first_pass_lays_the_centroids_on_each_other(kind):
    """A guess 0.9 m aside pairs every point with another; the residual stays that of the guess."""
    shift = np.array([0.9, 0, 0, 0, 0, 0])
    guess = T_BOARD @ se3.se3_exp(shift)
    q = PAIRED[kind][1]
    assert same(kind, pairs(kind, q, guess, sigma=1.0)) < 0.7
    found = pairs(kind, q, guess, first=True, sigma=1.0)
    assert same(kind, found) == 1
    assert found.value == pytest.approx(np.tile(-shift[:3], (len(q), 1)), abs=1e-12)


@paired
def test_a_point_beyond_the_gate_belongs_to_nothing(kind):
    q = PAIRED[kind][1].copy()
    q[:, 2] = 0.059
    q[0, 2] = 0.061
    found = pairs(kind, q, T_BOARD, sigma=0.01)
    assert found.feature[0] == -1 and (found.feature[1:] >= 0).all()
    assert found.data[-1, 0] == 0 and (found.data[-1, 1:] == 100).all()


def test_the_residual_is_the_measured_point_minus_that_of_the_target_over_sigma():
    """Equation 2: R (1, 2, 3) is (-2, 1, 3) for a quarter turn about z."""
    R, t = se3.so3_exp([0, 0, np.pi / 2]), np.array([10, 20, 30])
    found = nearest_point.residual(R, t, np.array([8.5, 21, 32.9, 1, 2, 3, 10]))
    assert np.asarray(found).reshape(-1) == pytest.approx([5, 0, -1], abs=1e-12)


# --- silhouettes


def border(size):
    """A rectangle (n, 2), px, of points 1 px apart, turned; and the depth of points inside it."""
    R = se3.so3_exp([0, 0, 0.4])[:2, :2]
    u, v = (np.arange(-s / 2, s / 2 + 0.1) for s in size)
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2
    return uv @ R.T, lambda p: -polygon.signed_distance(corners @ R.T, p)


def disc(radius):
    """A disc (n, 2), px, of points 1 px apart, and the depth of points inside it."""
    uv = border((2 * radius, 2 * radius))[0]
    return uv[np.linalg.norm(uv, axis=1) < radius], lambda p: radius - np.linalg.norm(p, axis=1)


DENSE = {"rectangle": border((80, 50)), "disc": disc(30.0), "small disc": disc(5.0)}


@pytest.mark.parametrize("name", DENSE)
@pytest.mark.parametrize("scale", [1.0, 0.02, 7.0])
def test_the_rim_of_points_that_lie_densely_is_their_border(name, scale):
    uv, depth = DENSE[name]
    rim = uv[template_silhouette.rim(scale * uv + [300, 200], scale)]
    assert depth(rim).max() < 1.5
    around = rim[np.argsort(np.arctan2(*rim.T))]
    assert np.linalg.norm(np.roll(around, -1, 0) - around, axis=1).max() < 4


def test_a_hole_inside_is_no_rim():
    uv, depth = DENSE["disc"]
    ring = uv[np.linalg.norm(uv, axis=1) > 15]
    assert depth(ring[template_silhouette.rim(ring, 1.0)]).max() < 1.5


VIEWS = {
    "across, 2 m": ((0, 0, 2), (0, 0, 0)),
    "leaning, 2 m": ((0.1, 0.05, 2), (10, 20, 80)),
    "leaning, 3 m": ((0, 0, 3), (0, -30, 130)),
    "across, 8 m": ((0, 0, 8), (0, 0, 0)),
}


def seen(view, target):
    """Template points (n, 3) on the silhouette of a cylinder, and how far off its limbs, m."""
    at, turn = VIEWS[view]
    T = se3.pose(se3.so3_exp(np.radians(turn)), at)
    uv, valid = PINHOLE.project(se3.transform(T, target.points.template))
    assert valid.all() and PINHOLE.in_image(uv).all()
    keypoints = {"view": np.zeros(len(uv), int), "uv": uv, "sigma": np.full(len(uv), 1e3)}
    found = template_silhouette.assign(PINHOLE, target, T, keypoints, GATE, Noise(1.0, 0.0))
    q = target.points.template[np.unique(found.feature)]
    # The planes through the camera that touch the side have the normals (0, cos, sin) of these.
    _, y, z = se3.inverse(T)[:3, 3]
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
    q, away = seen(view, by_points(cylinder.Cylinder(0.8, 0.1), 0.02))
    on_side = np.abs(q[:, 0]) < 0.4 - 1e-9
    assert away[on_side].max() < 1e-3
    assert np.diff(np.unique(q[:, 0])).max() < 0.1  # m, along the axis, from cap to cap
    assert np.ptp(q[:, 0]) == pytest.approx(0.8)


def contour_of(T):
    """Pixels (n, 2) of the silhouette of the cylinder, as keypoints, and its template points."""
    rows, uv = template_silhouette._silhouette(PINHOLE, CYLINDER, T)
    return {"view": np.zeros(len(uv), int), "uv": uv, "sigma": np.full(len(uv), 0.1)}, rows


def test_the_silhouette_where_it_is_belongs_to_itself_without_residual():
    T = se3.pose(se3.so3_exp([0.2, 0.3, 1.4]), [0.1, 0.05, 2])
    keypoints, rows = contour_of(T)
    for function in (template_silhouette.assign, template_silhouette.first):
        found = function(PINHOLE, CYLINDER, T, keypoints, GATE, Noise(1.0, 0.0))
        assert np.array_equal(found.feature, rows)
        assert np.abs(found.value).max() < 1e-9 and not found.cosine.any()
        assert found.numbers[:, 2:5] == pytest.approx(CYLINDER.points.template[rows])


def test_the_first_pass_lays_the_centroids_of_the_contours_on_each_other():
    """A guess 6 cm aside along the axis is 24 px off; nearest pairs alone would be 6 cm off too."""
    T = se3.pose(se3.so3_exp([0.2, 0.3, 1.4]), [0.1, 0.05, 2])
    keypoints, rows = contour_of(T)
    guess = se3.pose(t=[0, 0.06, 0]) @ T
    wrong = []
    for function in (template_silhouette.first, template_silhouette.assign):
        found = function(PINHOLE, CYLINDER, guess, keypoints, GATE, Noise(100.0, 0.0))
        off_own = found.numbers[:, 2:5] - CYLINDER.points.template[rows]
        wrong.append(np.median(np.linalg.norm(off_own, axis=1)))
        assert (found.feature >= 0).all()
    assert wrong[0] < 0.01 and wrong[1] > 0.05
    value = template_silhouette.first(
        PINHOLE, CYLINDER, guess, keypoints, GATE, Noise(100.0, 0.0)
    ).value
    assert value.mean(0) == pytest.approx([0, -24], abs=2)  # px: 6 cm · 800 px / 2 m


def test_a_target_behind_the_camera_has_no_silhouette():
    T = se3.pose(t=[0, 0, 2.0])
    keypoints, _ = contour_of(T)
    behind = se3.pose(t=[0, 0, -2.0])
    for function in (template_silhouette.assign, template_silhouette.first):
        found = function(PINHOLE, CYLINDER, behind, keypoints, GATE, Noise(1.0, 0.0))
        assert (found.feature == -1).all()


# --- the estimate

TARGETS = {"board": BOARD, "cylinder": CYLINDER}
TRUE = se3.from_rpy([0.1, -0.05, 0.7], [0.02, -0.03, 0.05])  # T_robot_lidar
OFF = se3.se3_exp(np.array([0.02] * 3 + [np.radians(3)] * 3) / np.sqrt(3))  # 2 cm, 3°
TURNS = ((0, 0.7, 0), (0, -0.7, 0), (0, 0, 0.7), (0, 0, -0.7))  # of boards, rad
AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 1), (0, 1, -1))  # of cylinders
PLACES = ((2, -0.3, 0.4), (1.8, 0.3, 0.8), (2.2, 0, 0.6), (1.6, 0.2, 0.5))
MCS_SIGMA = np.repeat([1e-4, np.radians(0.01)], 3)


def keypoint_columns(kind, k, xyz):
    n = len(xyz)
    sigma = np.full(n, np.hypot(LIDAR.range_sigma, SPACING))
    columns = {"view": np.full(n, k), "placement": np.full(n, k), "kind": np.full(n, kind)}
    return columns | {"index": np.zeros(n, int), "xyz": xyz, "sigma": sigma}


def setup(kind, layout, shapes, sigma, mcs=0.0):
    """A Setup without range noise of placements [(target, T_robot_target)]; mcs: errors in σ."""
    rng = np.random.default_rng(0)
    places, groups = [], []
    for k, (name, T) in enumerate(layout):
        robot, body = se3.se3_exp(mcs * MCS_SIGMA * rng.normal(size=(2, 6)))
        said = robot @ T @ se3.inverse(body)
        places.append(estimation_problem.Placement("s", name, said, np.eye(4), sigma))
        T_lidar_target = se3.inverse(TRUE) @ T
        if kind == "vertex":
            q = shapes[name].outline_points()
        elif name == "board":
            q = face(200, seed=k)
        else:
            towards = se3.inverse(T_lidar_target)[:3, 3]
            turn = se3.so3_exp([np.arctan2(towards[2], towards[1]), 0, 0])
            q = side(200, 1.2, seed=k) @ turn.T
        columns = keypoint_columns(kind, k, se3.transform(T_lidar_target, q))
        groups.append(estimation_problem.Group("lidar", k, kind, columns))
    return estimation_problem.Setup({"lidar": LIDAR}, shapes, places, groups, GATE, {})


def boards():
    turns = [se3.so3_exp(w) @ FACING for w in TURNS]
    return [("board", se3.pose(R, at)) for R, at in zip(turns, PLACES, strict=True)]


def cylinders():
    axes = np.array(AXES) / np.linalg.norm(AXES, axis=1, keepdims=True)
    turns = [np.column_stack([x, np.cross(x, -np.eye(3)[0]), -np.eye(3)[0]]) for x in axes]
    return [("cylinder", se3.pose(R, at)) for R, at in zip(turns, PLACES[::-1], strict=True)]


SOLVE = {"max_rounds": 100, "tolerance_m": 1e-8, "tolerance_rad": 1e-8}
SOLVE |= {"points_tolerance_m": 1e-5, "points_tolerance_rad": 1e-5}


def estimated(problem):
    """The Result by the options of the solve stage from a start that is off by 2 cm and 3°."""
    start = {"lidar": TRUE @ OFF}
    return solver.estimate(problem, start, **problem_assembly.limits(problem, SOLVE))


def test_the_estimate_by_nearest_points_comes_within_1_mm_and_0_1_deg():
    """Of MCS poses that are all but exact: softer ones give way to each placement's own pairs."""
    layout = boards()[:3] + cylinders()[1:]
    result = estimated(setup("point", layout, TARGETS, 1e-2 * MCS_SIGMA))
    mm, deg = off(result.state.T_robot_sensor["lidar"], TRUE)
    assert result.settled and len(result.rounds) < 100
    assert np.linalg.norm(mm) < 1 and np.linalg.norm(deg) < 0.1
    assert result.state.mocap == 1
    assert result.rounds[-1]["members"] == 6 * 200


def test_the_estimate_by_exact_corners_is_exact():
    result = estimated(setup("vertex", boards(), TARGETS, MCS_SIGMA))
    mm, deg = off(result.state.T_robot_sensor["lidar"], TRUE)
    assert result.settled
    assert np.linalg.norm(mm) < 1e-3 and np.linalg.norm(np.radians(deg)) < 1e-6


def test_targets_compared_by_points_say_nothing_of_the_noise_of_the_mcs():
    """Errors of 5 σ, each known to 0.3 σ; the same against boards that are not show them."""
    found = []
    for board in (BOARD, replace(BOARD, points=None)):
        problem = setup("vertex", boards(), {"board": board}, MCS_SIGMA)
        state = estimate_state.start(problem, {"lidar": TRUE}, 1.0)
        state.y[:] = 5.0
        found.append(solver.mocap_factor(problem, state, 0.09 * np.eye(problem.n)))
    assert found[0] == 1 and 3 < found[1] < 6


def assigned(feature):
    return SimpleNamespace(feature=np.array(feature))


@pytest.mark.parametrize("kind, changed", [("point", 2), ("silhouette", 2), ("corner", 3)])
def test_a_new_nearest_point_is_no_change_but_coming_and_going_is(kind, changed):
    groups = [estimation_problem.Group("s", 0, kind, {})]
    one = estimation_problem.Setup({}, {}, [], groups, {}, {})
    before, after = [assigned([4, 5, -1, 7])], [assigned([4, 6, 3, -1])]
    assert solver.changes(one, before, after) == changed


@pytest.mark.parametrize(
    "names, expected",
    [(["surface"], 1e-8), (["surface", "point"], 1e-5)],
)
def test_the_estimate_settles_sooner_where_anything_is_compared_by_nearest_points(names, expected):
    groups = [estimation_problem.Group("s", 0, kind, {}) for kind in names]
    found = problem_assembly.limits(estimation_problem.Setup({}, {}, [], groups, {}, {}), SOLVE)
    steps = {"tolerance_m": expected, "tolerance_rad": expected}
    assert found == {"max_rounds": 100, "noise": 10.0, **steps}


# --- a shape that is nothing but its template


def corner_of_a_box():
    """Template (n, 3), 1 cm apart, of three faces 0.4 x 0.3 x 0.2 m that meet in the origin."""
    x, y, z = (np.arange(0, n) / 100 for n in (41, 31, 21))
    faces = (x, y, z[:1]), (x, y[:1], z), (x[:1], y, z)
    grids = [np.stack(np.meshgrid(*f), -1).reshape(-1, 3) for f in faces]
    return np.unique(np.concatenate(grids), axis=0)


BOX = template_cloud.Cloud(point_template.Points(corner_of_a_box(), 0.01, "all"))
FLAT = template_cloud.Cloud(point_template.Points(COARSE.points.template, 0.04, "all"))
every_cloud = pytest.mark.parametrize("target", [BOX, FLAT], ids=["box", "flat"])


@every_cloud
def test_all_of_a_cloud_lies_within_its_reach_of_its_centre(target):
    template = target.points.template
    assert np.linalg.norm(template - target.centre, axis=1).max() == pytest.approx(target.reach)
    outline = target.outline_points()
    assert cKDTree(template).query(outline)[0].max() == 0
    assert np.ptp(outline, axis=0) == pytest.approx(np.ptp(template, axis=0))


def test_a_cloud_has_the_extents_of_its_points():
    assert BOX.centre == pytest.approx([0.2, 0.15, 0.1])
    assert BOX.reach == pytest.approx(np.linalg.norm([0.2, 0.15, 0.1]))
    grid = np.stack(np.meshgrid(np.arange(41) / 50, np.arange(21) / 50, [0]), -1).reshape(-1, 3)
    plate = template_cloud.Cloud(
        point_template.Points(grid @ se3.so3_exp([1, 2, 3]).T, 0.02, "all")
    )
    assert plate.size == pytest.approx([0.8, 0.4, 0], abs=1e-12)
    assert plate.area == pytest.approx(0.32)
    assert (np.diff(BOX.size) <= 0).all()


@every_cloud
def test_a_cloud_is_its_own_template_and_is_seen_from_all_sides_by_no_camera(target):
    assert target.template(0.5) is target.points.template
    assert target.faces(target.centre + [0, 0, -1.1 * target.reach]) == (True, 1.0)
    assert not target.faces(target.centre + [0, 0.9 * target.reach, 0])[0]
    assert target.edges().shape == (0, 2, 3) and target.image_points().shape == (0, 3)
    assert target.pattern is None and target.color is None
    for name in ("distance", "depth"):
        assert not hasattr(target, name)


T_BOX = se3.pose(se3.so3_exp([0.4, -0.5, 0.3]), [2, 0.1, 0.5])
MARGIN = np.repeat([0.05, np.radians(5)], 3)


def scan():
    """Returns (700, 3): 400 on the box without noise, then 300 on a wall 0.6 m behind it."""
    rng = np.random.default_rng(0)
    q = rng.uniform(0, 1, (400, 3)) * [0.4, 0.3, 0.2]
    q[np.arange(400), rng.integers(0, 3, 400)] = 0
    wall = rng.uniform([2.9, -1, 0], [2.9, 1, 1.2], (300, 3))
    return np.concatenate([se3.transform(T_BOX, q), wall])


def test_the_returns_on_a_cloud_are_found_and_a_wall_behind_is_left_out():
    guess = T_BOX @ se3.se3_exp([0.02, -0.01, 0.015, 0.03, 0, -0.02])
    assert np.array_equal(BOX.fit(scan(), guess, MARGIN, LIDAR, {}), np.arange(400))


def test_a_wall_alone_is_no_cloud():
    assert len(BOX.fit(scan()[400:], T_BOX, MARGIN, LIDAR, {})) == 0


def test_a_cloud_that_is_turned_farther_than_the_guess_may_be_wrong_is_not_found():
    guess = T_BOX @ se3.se3_exp([0, 0, 0, 0, 0, 0.3])
    assert len(BOX.fit(scan(), guess, MARGIN, LIDAR, {})) == 0
    assert len(BOX.fit(scan(), guess, 4 * MARGIN, LIDAR, {})) > 350
