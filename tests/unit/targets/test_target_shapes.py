"""Target shapes against numbers worked out by hand, patterns on images of known corners."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from calib.estimation.nlp.symbolic_chain import ca
from calib.geometry.polygon import nearest_polygon_edge, polygon_contains, signed_polygon_distance
from calib.geometry.se3 import make_pose, so3_exp, transform_points
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.board import Board
from calib.targets.cylinder import Cylinder
from calib.targets.patterns.checkerboard import Checkerboard
from calib.targets.patterns.gradient_corners import refine_gradient_corners
from calib.targets.patterns.pattern_registry import TARGET_PATTERNS
from calib.targets.target_shapes import TARGET_SHAPES, target_from_config
from calib.targets.template_cloud import TemplateCloud

SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
DIAMOND = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
CONCAVE = np.array([[0.0, 0], [4, 0], [4, 3], [2, 1], [0, 3]])  # a notch from above
SHAPES = {"square": SQUARE, "diamond": DIAMOND, "concave": CONCAVE}
every_outline = pytest.mark.parametrize("vertices", SHAPES.values(), ids=SHAPES.keys())
coordinates = st.floats(-6, 6)
planar_points = st.tuples(coordinates, coordinates)


# --- outlines


@pytest.mark.parametrize(
    "vertices, p, distance",
    [
        (SQUARE, (0, 0), -1),
        (SQUARE, (0.75, 0.2), -0.25),
        (SQUARE, (3, 0), 2),
        (SQUARE, (4, 5), 5),
        (SQUARE, (1, 0.3), 0),
        (DIAMOND, (0, 0), -np.sqrt(0.5)),
        (DIAMOND, (1, 1), np.sqrt(0.5)),
        (DIAMOND, (2, 0), 1),
        (CONCAVE, (2, 2), np.sqrt(0.5)),
        (CONCAVE, (2, 0.5), -0.5),
        (CONCAVE, (0.5, 1), -0.5),
        (CONCAVE, (2, 4), np.sqrt(4.5)),
    ],
)
def test_the_distance_to_an_outline_is_negative_inside(vertices, p, distance):
    found = signed_polygon_distance(vertices, np.array([p], float))
    assert found == pytest.approx([distance], abs=1e-15)


@every_outline
@given(planar_points)
@settings(max_examples=60, deadline=None)
def test_the_sign_says_whether_a_point_is_inside(vertices, p):
    p = np.array([p])
    distance = signed_polygon_distance(vertices, p)[0]
    if abs(distance) > 1e-9:
        assert (distance < 0) == polygon_contains(vertices, p)[0]
        assert (distance < 0) == polygon_contains(vertices[::-1], p)[0]
        reference = cv2.pointPolygonTest(vertices.astype(np.float32), p[0].tolist(), True)
        assert -distance == pytest.approx(reference, abs=1e-5)


@every_outline
@given(planar_points, planar_points)
@settings(max_examples=60, deadline=None)
def test_the_distance_changes_no_faster_than_the_point_moves(vertices, p, q):
    p, q = np.array([p]), np.array([q])
    change = signed_polygon_distance(vertices, p) - signed_polygon_distance(vertices, q)
    assert abs(change[0]) <= np.linalg.norm(p - q) + 1e-12


@every_outline
def test_the_distance_moves_and_turns_with_the_outline(vertices):
    R, t = so3_exp([0, 0, 0.7])[:2, :2], np.array([3, -2])
    p = np.random.default_rng(0).uniform(-3, 5, (100, 2))
    there = signed_polygon_distance(vertices @ R.T + t, p @ R.T + t)
    assert there == pytest.approx(signed_polygon_distance(vertices, p), abs=1e-12)


def test_the_nearest_edge_comes_with_the_fraction_along_its_line():
    edge, fraction = nearest_polygon_edge(SQUARE, np.array([[0.5, -1.2], [1.1, 0], [2, 1.9]]))
    assert edge.tolist() == [0, 1, 1]
    assert fraction == pytest.approx([0.75, 0.5, 1.45])


# --- shapes

PATTERN = {"inner_corners": [6, 5], "square_m": 0.08, "first_corner_m": [-0.2, -0.16]}
PATTERN = {"kind": "checkerboard"} | PATTERN
BOARD = target_from_config(
    {"shape": "board", "outline_m": (DIAMOND * 0.7071).tolist(), "thickness_m": 0.005}
    | {"pattern": PATTERN}
)
WEDGE = Board(CONCAVE, 0.01, None)
CYLINDER = target_from_config({"shape": "cylinder", "length_m": 0.8, "radius_m": 0.1})
ALL = {"board": BOARD, "wedge": WEDGE, "cylinder": CYLINDER}
every_shape = pytest.mark.parametrize("target", ALL.values(), ids=ALL.keys())


def test_every_shape_is_tested():
    """A cloud has no surface but its points: test_points.py."""
    assert {type(t) for t in ALL.values()} == set(TARGET_SHAPES.values()) - {TemplateCloud}
    assert isinstance(BOARD.pattern, Checkerboard) and CYLINDER.pattern is None


@every_shape
def test_the_distance_is_the_same_in_numpy_and_in_casadi(target):
    q = np.random.default_rng(0).normal(size=(50, 3))
    s = ca.SX.sym("q", 3)
    function = ca.Function("d", [s], [target.surface_distance(s[0], s[1], s[2])])
    expected = [float(function(row)) for row in q]
    assert target.surface_distance(*q.T) == pytest.approx(expected, abs=1e-15)


def beams(rng, n):
    """Unit beams (3, n) towards -z, within 60° of it."""
    beam = np.vstack([rng.uniform(-0.6, 0.6, (2, n)), -np.ones(n)])
    return beam / np.linalg.norm(beam, axis=0)


@every_shape
def test_the_gap_is_the_distance_along_the_beam_wherever_on_it_the_return_lies(target):
    """At y = 0.03 m a cylinder of 0.1 m is met; the noise is 5 cm, half its radius."""
    rng = np.random.default_rng(1)
    beam = beams(rng, 50)
    on = np.vstack([rng.uniform(-0.2, 0.2, 50), np.full(50, 0.03), np.zeros(50)])
    if target is CYLINDER:
        on[2] = np.sqrt(0.1**2 - 0.03**2)
    normal = np.array([0, 0.3, np.sqrt(1 - 0.09)]) if target is CYLINDER else np.array([0, 0, 1.0])
    expected = -normal @ beam
    for noise in (-0.05, 0.0, 1e-3, 0.05):
        gap, cosine = target.distance_along_beam(on + noise * beam, beam)
        clear = expected > 0.3
        assert cosine[clear] == pytest.approx(expected[clear], rel=2e-4)
        assert gap[clear] == pytest.approx(np.full(clear.sum(), -noise), rel=0.02, abs=1e-15)


def test_the_gap_of_a_cylinder_has_no_bias_from_range_noise():
    """Radially, ±1 cm along a beam 60° off the normal would have a mean of 0.37 mm."""
    beam = np.array([0, np.sin(np.pi / 3), -np.cos(np.pi / 3)])
    on = np.array([0, 0, 0.1])
    gaps = [CYLINDER.distance_along_beam(on + e * beam, beam)[0] for e in (-0.01, 0.01)]
    assert abs(np.mean(gaps)) < 5e-6
    radial = [CYLINDER.surface_distance(*(on + e * beam)) for e in (-0.01, 0.01)]
    assert np.mean(radial) == pytest.approx(3.7e-4, rel=0.05)


def test_the_gap_of_a_beam_that_misses_a_cylinder_stays_finite_and_smooth():
    s = ca.SX.sym("q", 3)
    beam = np.array([0.0, 0.0, -1.0])
    slope = ca.Function("d", [s], [ca.jacobian(CYLINDER.distance_along_beam(s, beam)[0], s)])
    jumps = []
    for step in (1e-6, 1e-7):
        heights = np.arange(0.0999, 0.1001, step)
        slopes = np.array([np.array(slope([0, y, 0.02])).reshape(-1) for y in heights])
        assert np.isfinite(slopes).all()
        jumps.append(np.abs(np.diff(slopes, axis=0)).max())
    assert jumps[1] < 0.2 * jumps[0]


@every_shape
def test_all_of_a_shape_lies_within_its_reach_of_its_centre(target):
    away = np.linalg.norm(target.outline_points() - target.centre, axis=1)
    assert away.max() == pytest.approx(target.bounding_radius)


@every_shape
def test_the_derivative_of_the_distance_is_finite_everywhere(target):
    s = ca.SX.sym("q", 3)
    slope = ca.Function("d", [s], [ca.jacobian(target.surface_distance(s[0], s[1], s[2]), s)])
    for q in ([0, 0, 0], [0.3, 0, 0], [0, 1e-12, 0], [1e6, -1e6, 1e6]):
        assert np.isfinite(np.array(ca.densify(slope(q)))).all()


def test_the_distance_to_a_board_is_the_height_over_its_face():
    q = np.array([[0.1, 0.2, 0.03], [5, 5, -0.5]])
    assert BOARD.surface_distance(*q.T) == pytest.approx([0.03, -0.5])


def test_a_point_is_over_a_board_where_its_outline_is_farther_than_the_slack():
    """The edge of the diamond is 0.5 m from its centre."""
    q = np.array([[0, 0, 0.3], [0.3, 0.15, -1], [0.34, 0.34, 0], [0.4, 0.4, 0]])
    assert (BOARD.distance_inside_rim(q) > 0.0).tolist() == [True, True, True, False]
    assert (BOARD.distance_inside_rim(q) > 0.05).tolist() == [True, True, False, False]
    assert (BOARD.distance_inside_rim(q) > -0.1).tolist() == [True, True, True, True]


def test_a_board_is_seen_from_the_side_of_its_printed_face():
    assert BOARD.check_facing(np.array([0, 0, 2.0])) == (True, pytest.approx(1))
    assert BOARD.check_facing(np.array([2.0, 0, 2.0])) == (True, pytest.approx(np.sqrt(0.5)))
    assert not BOARD.check_facing(np.array([0, 0, -2.0]))[0]
    assert WEDGE.check_facing(WEDGE.centre + [0, 0, 1])[1] == pytest.approx(1)


def test_a_board_has_the_extents_and_the_area_of_its_outline():
    assert BOARD.extents == pytest.approx([1.4142, 1.4142])
    assert BOARD.area == pytest.approx(2 * 0.7071**2)
    oblong = Board(np.array([[0, 0], [3.0, 0], [3, 4], [0, 4]]), 0.01, None)
    assert oblong.extents == pytest.approx([5, 4.8])  # the diagonal, and twice 3 · 4 / 5 across it
    assert oblong.area == pytest.approx(12) and WEDGE.area == pytest.approx(8)
    assert Board(CONCAVE[::-1], 0.01, None).area == pytest.approx(8)


def test_the_edges_of_a_board_go_round_its_outline():
    edges = WEDGE.outline_edges()
    assert edges.shape == (5, 2, 3)
    assert np.array_equal(edges[:, 1], np.roll(edges[:, 0], -1, 0))
    assert np.array_equal(edges[:, 0], np.column_stack([CONCAVE, np.zeros(5)]))


def test_the_distance_to_a_cylinder_is_that_to_its_side():
    q = np.array([[0.2, 0.3, 0.4], [5, 0, 0.05], [0, 0, 0]])
    assert CYLINDER.surface_distance(*q.T) == pytest.approx([0.4, -0.05, -0.1], abs=1e-9)


def test_a_point_is_over_a_cylinder_between_its_ends():
    q = np.array([[0.39, 0.1, 0], [-0.39, 5, 5], [0.41, 0, 0.1]])
    assert (CYLINDER.distance_inside_rim(q) > 0.0).tolist() == [True, True, False]
    assert (CYLINDER.distance_inside_rim(q) > 0.02).tolist() == [False, False, False]
    assert (CYLINDER.distance_inside_rim(q) > -0.02).tolist() == [True, True, True]


def test_a_cylinder_is_seen_from_all_sides_best_from_beside_it():
    assert CYLINDER.check_facing(np.array([0, 3.0, 0])) == (True, pytest.approx(1))
    assert CYLINDER.check_facing(np.array([3.0, 0, 0])) == (True, pytest.approx(0))
    assert CYLINDER.check_facing(np.array([3.0, 0, -4.0])) == (True, pytest.approx(0.8))
    assert not CYLINDER.check_facing(np.array([0, 0.2, 0]))[0]


def test_a_cylinder_has_the_size_and_the_area_of_what_is_seen_of_it_from_beside_it():
    assert CYLINDER.extents == pytest.approx([0.8, 0.2])
    assert CYLINDER.area == pytest.approx(0.16)
    assert CYLINDER.bounding_radius == pytest.approx(np.sqrt(0.17))
    assert CYLINDER.outline_edges().shape == (0, 2, 3)
    assert isinstance(CYLINDER, Cylinder)


# --- the checkerboard


def test_corners_run_along_x_first_then_along_y():
    corners = BOARD.pattern.corners()
    assert corners.shape == (30, 3)
    assert corners[0] == pytest.approx([-0.2, -0.16, 0])
    assert corners[1] == pytest.approx([-0.12, -0.16, 0])
    assert corners[6] == pytest.approx([-0.2, -0.08, 0])
    assert corners[29] == pytest.approx([0.2, 0.16, 0])


@pytest.mark.parametrize("columns, rows", [(6, 5), (3, 7), (5, 5)])
def test_labellings_are_permutations_that_contain_the_identity_and_the_half_turn(columns, rows):
    pattern = Checkerboard(columns, rows, 0.1, (-0.05 * (columns - 1), -0.05 * (rows - 1)))
    ways = pattern.corner_orders()
    n = columns * rows
    assert np.array_equal(np.sort(ways, 1), np.tile(np.arange(n), (len(ways), 1)))
    assert len(np.unique(ways, axis=0)) == len(ways) == (8 if columns == rows else 4)
    corners = pattern.corners()
    turned = corners * [-1, -1, 1]
    assert any(np.array_equal(w, np.arange(n)) for w in ways)
    assert any(np.abs(corners[w] - turned).max() < 1e-12 for w in ways)


@pytest.mark.parametrize("quarters", range(4))
def test_labellings_of_a_square_grid_contain_every_quarter_turn(quarters):
    pattern = Checkerboard(4, 4, 0.1, (-0.15, -0.15))
    R = so3_exp([0, 0, quarters * np.pi / 2])
    turned = pattern.corners() @ R.T
    assert min(np.abs(pattern.corners()[w] - turned).max() for w in pattern.corner_orders()) < 1e-12


def test_every_pattern_says_what_it_expects():
    assert BOARD.pattern.expected_description == "6 × 5 inner corners"
    tested = {"checkerboard", "charuco"}  # test_charuco.py
    assert set(TARGET_PATTERNS) == tested, "add the new pattern's tests"


# --- finding corners

CAMERA = CameraModel("radtan", (420, 425, 160.3, 119.6, 0, 0, 0, 0), (320, 240))
SAMPLES = 4  # per pixel and axis, each of them anti-aliased


def render(pattern, T_camera_target, blur=0.7):
    """Grey image (h, w) of a checkerboard with a white rim on grey."""
    width, height = CAMERA.size_px
    step = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u, v = ((np.arange(n)[:, None] + step).reshape(-1) for n in CAMERA.size_px)
    rays = np.stack([*np.meshgrid((u - 160.3) / 420, (v - 119.6) / 425), np.ones((len(v), len(u)))])
    R, t = T_camera_target[:3, :3], T_camera_target[:3, 3]
    depth = R[:, 2] @ t / np.tensordot(R[:, 2], rays, 1)
    q = np.tensordot(R.T[:2], depth * rays - t[:, None, None], 1)
    across, up = ((q[i] - pattern.first_corner[i]) / pattern.square_m for i in range(2))
    image = 120.0 - 0 * across
    for margin, contrast in ((2, 0.0), (1, 95.0)):
        low = np.minimum(across, up) > -margin
        on = low & (across < pattern.n_columns - 1 + margin) & (up < pattern.n_rows - 1 + margin)
        image[on] = 220.0 if not contrast else (125 + contrast * _wave(across) * _wave(up))[on]
    image = cv2.GaussianBlur(image, (0, 0), blur * SAMPLES)  # of the lens, before the pixels
    return image.reshape(height, SAMPLES, width, SAMPLES).mean((1, 3))


def _wave(a):
    """±1 by turns between whole numbers, with the ramp of one sample where they change."""
    line = np.round(a)
    samples = (a - line) / np.hypot(*np.gradient(a))
    return np.clip(2 * samples, -1, 1) * np.where(line % 2 == 0, 1, -1)


def facing(xyz, rotvec_deg):
    """T_camera_target of a target at xyz, m, that faces the camera but for a turn."""
    front = np.diag([1.0, -1.0, -1.0])
    return make_pose(front @ so3_exp(np.radians(rotvec_deg)), xyz)


VIEWS = {
    "face on": ([0.01, 0.02, 0.95], [0, 0, 0]),
    "turned": ([0.0, 0.0, 1.0], [0, 0, 27]),
    "leaning": ([-0.03, 0.01, 0.95], [25, -20, 10]),
    "upside down": ([0.02, 0.0, 1.0], [-15, 20, 170]),
    "far": ([0.1, -0.05, 1.6], [10, 15, -5]),
}


def best(pattern, found, truth):
    """Least of the largest distances, px, of a detection to the truth in any of the labellings."""
    return min(np.linalg.norm(found - truth[w], axis=1).max() for w in pattern.corner_orders())


def located(pattern, image):
    """All corners (n, 2) of an image of CAMERA in the order of the grid."""
    corners, status = pattern.locate_corners(image, CAMERA, np.zeros(2))
    assert status.ok and status.reason == ""
    assert corners.corner_index.tolist() == list(range(pattern.n_columns * pattern.n_rows))
    return corners.uv


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
def test_the_corners_of_a_board_are_found_to_0_02_px(view):
    pattern = Checkerboard(6, 5, 0.08, (-0.2, -0.16))
    T = facing(*view)
    image = np.rint(render(pattern, T)).astype(np.uint8)
    truth, valid = CAMERA.project(transform_points(T, pattern.corners()))
    assert valid.all() and CAMERA.is_in_image(truth, 10).all()
    assert best(pattern, located(pattern, image), truth) < 0.02
    assert best(pattern, pattern.detect_corners_fast(image), truth) < 0.35


GRIDS = [(6, 5), (5, 6), (7, 5), (6, 4), (5, 5), (4, 4)]
turned = pytest.mark.parametrize("turn", [0, 90, 180, 270])


def centred(columns, rows, first_square=None):
    """A checkerboard in the middle of its target; render() makes its first square white."""
    first = (-0.04 * (columns - 1), -0.04 * (rows - 1))
    return Checkerboard(columns, rows, 0.08, first, first_square)


@turned
@pytest.mark.parametrize("columns, rows", GRIDS)
@pytest.mark.parametrize("stated", [None, "white"])
def test_a_board_in_any_turn_is_read_in_one_of_its_labellings(columns, rows, stated, turn):
    pattern = centred(columns, rows, stated)
    T = facing([0.01, 0.02, 1.1], [8, -6, turn + 4])
    truth, _ = CAMERA.project(transform_points(T, pattern.corners()))
    found = located(pattern, np.rint(render(pattern, T)).astype(np.uint8))
    assert best(pattern, found, truth) < 0.02


@pytest.mark.parametrize("columns, rows", GRIDS)
def test_a_stated_colour_resolves_the_half_turn_where_one_side_is_odd_and_one_even(columns, rows):
    plain, stated = centred(columns, rows), centred(columns, rows, "white")
    ways = {tuple(w) for w in stated.corner_orders()}
    assert ways <= {tuple(w) for w in plain.corner_orders()}
    assert tuple(range(columns * rows)) in ways
    half_turn = tuple(reversed(range(columns * rows)))
    assert (half_turn in ways) == ((columns + rows) % 2 == 0)


@turned
@pytest.mark.parametrize("columns, rows", [(6, 4), (4, 4)])
def test_a_grid_that_cannot_begin_at_the_stated_colour_is_refused(columns, rows, turn):
    pattern = centred(columns, rows, "black")
    image = render(pattern, facing([0.01, 0.02, 1.1], [8, -6, turn + 4]))
    image = np.rint(image).astype(np.uint8)
    assert pattern.detect_corners_fast(image) is None
    corners, status = pattern.locate_corners(image, CAMERA, np.zeros(2))
    assert corners is None and status.found == "a grid whose ends are not black"


def test_a_board_of_another_size_is_not_taken_for_this_one():
    other = Checkerboard(7, 4, 0.08, (-0.24, -0.12))
    image = np.rint(render(other, facing([0, 0, 1.0], [5, 5, 5]))).astype(np.uint8)
    pattern = Checkerboard(6, 5, 0.08, (-0.2, -0.16))
    assert pattern.detect_corners_fast(image) is None
    corners, status = pattern.locate_corners(image, CAMERA, np.zeros(2))
    assert corners is None
    assert status.found == "7 × 4 inner corners" and status.expected == "6 × 5 inner corners"


NOISE = np.random.default_rng(0).normal(120, 20, (240, 320)).clip(0, 255).astype(np.uint8)
RAMP = np.tile(np.linspace(0, 255, 320), (240, 1)).astype(np.uint8)


@pytest.mark.parametrize(
    "image", [np.full((240, 320), 128, np.uint8), RAMP, NOISE], ids=["flat", "ramp", "noise"]
)
def test_an_image_without_a_board_gives_none(image):
    assert BOARD.pattern.detect_corners_fast(image) is None
    corners, status = BOARD.pattern.locate_corners(image, CAMERA, np.zeros(2))
    assert corners is None and status.reason.startswith(
        "no checkerboard in the region of 320 x 240"
    )


def corner_image(at, angles_deg, blur, size=41):
    """Grey image of one corner where two straight edges of these directions cross, blurred."""
    x, y = np.meshgrid(np.arange(size) - at[0], np.arange(size) - at[1])
    a, b = (np.cos(a) * y - np.sin(a) * x for a in np.radians(angles_deg))
    return 120 + 80 * erf(a / (np.sqrt(2) * blur)) * erf(b / (np.sqrt(2) * blur))


@pytest.mark.parametrize(
    "blur, rounded, limit",
    [
        (0.7, True, 0.01),
        (1.0, True, 0.01),
        (0.7, False, 0.005),
        (1.0, False, 0.005),
        (1.5, False, 0.002),
    ],
)
@pytest.mark.parametrize("angles", [(0, 90), (20, 110), (10, 75), (35, 145)])
@pytest.mark.parametrize("shift", [(0, 0), (0.5, 0.5), (0.31, -0.27), (-0.13, 0.44)])
def test_a_corner_is_refined_to_0_01_px_from_a_start_that_is_off_by_one(
    shift, angles, blur, rounded, limit
):
    """Whole grey levels, of 160, are all that is lost; half of the limit without that."""
    truth = 20 + np.array(shift)
    image = corner_image(truth, angles, blur)
    start = truth + [[0.7, -0.6], [-1, 0.3], [0, 0]]
    found, settled = refine_gradient_corners(np.rint(image) if rounded else image, start, 6.0)
    assert settled.all()
    assert np.linalg.norm(found - truth, axis=1).max() < limit


def test_a_corner_image_half_a_pixel_aside_is_found_half_a_pixel_aside():
    a, b = (corner_image((20 + d, 20), (10, 100), 1.0) for d in (0, 0.5))
    start = np.array([[20.2, 20.1]])
    move = refine_gradient_corners(b, start, 6.0)[0] - refine_gradient_corners(a, start, 6.0)[0]
    assert move[0] == pytest.approx([0.5, 0], abs=0.01)


@pytest.mark.parametrize("kind", ["flat", "edge"])
def test_where_no_edges_cross_nothing_settles(kind):
    image = np.full((41, 41), 99.0)
    if kind == "edge":
        image[:, 21:] = 200
        image = cv2.GaussianBlur(image, (0, 0), 1.0)
    _, settled = refine_gradient_corners(image, np.array([[20.3, 20.2]]), 6.0)
    assert not settled.any()


# --- a board that is not flat

WARPED = replace(BOARD, warp=(0.005, -0.003, 0.002))


def test_the_middle_of_a_bowed_board_lies_over_its_ends_by_the_bow():
    bowed = replace(BOARD, warp=(0.005, 0.0, 0.0))
    reach = bowed.half_size[0]
    z = bowed.lift(np.array([[0.0, 0.0, 0.0], [reach, 0.0, 0.0], [reach / 2, 0.1, 0.0]]))[:, 2]
    np.testing.assert_allclose(z, [0.005, 0.0, 0.00375], atol=1e-12)


def test_a_twisted_board_is_raised_at_two_corners_and_lowered_at_two():
    twisted = replace(BOARD, warp=(0.0, 0.0, 0.002))
    a, b = twisted.half_size
    corners = np.array([[a, b, 0.0], [-a, b, 0.0], [-a, -b, 0.0], [a, -b, 0.0]])
    np.testing.assert_allclose(twisted.lift(corners)[:, 2], [0.002, -0.002, 0.002, -0.002])


def test_the_distance_to_a_warped_board_along_a_beam_is_where_the_beam_meets_it():
    """Returns up to 1 cm before or behind the face, beams up to 50° off: to 10 µm."""
    rng = np.random.default_rng(0)
    hit = WARPED.lift(np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), np.zeros(50)]))
    beam = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)), -np.ones(50)])
    beam /= np.linalg.norm(beam, axis=1)[:, None]
    before = rng.uniform(-0.01, 0.01, 50)
    gap, cosine = WARPED.distance_along_beam((hit - before[:, None] * beam).T, beam.T)
    np.testing.assert_allclose(gap, before, atol=1e-5)
    np.testing.assert_allclose(cosine, -beam[:, 2], atol=0.02)


def test_the_tangent_of_an_edge_touches_the_warped_face():
    ends = WARPED.edge_tangents(np.array([0, 1]), np.array([0.25, 0.6]))
    at = ends[:, 0] + np.array([[0.25], [0.6]]) * (ends[:, 1] - ends[:, 0])
    np.testing.assert_allclose(WARPED.surface_distance(*at.T), 0.0, atol=1e-12)
    for fraction in (0.249, 0.251):
        near = WARPED.edge_tangents(np.array([0]), np.array([fraction]))[0]
        on_edge = near[0] + fraction * (near[1] - near[0])
        on_tangent = ends[0, 0] + fraction * (ends[0, 1] - ends[0, 0])
        np.testing.assert_allclose(on_edge, on_tangent, atol=1e-7)
