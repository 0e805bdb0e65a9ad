"""The printed sheet has the size, squares and marks that the target's config states."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import board
from board import draw_target_pdf
from calib.io.config import validate_and_complete
from calib.io.status import InputError
from calib.targets.board_pdf import (
    draw_board_sheet,
    lay_out_sheet,
    make_axis_strokes,
    make_black_squares,
)
from calib.targets.target_shapes import target_from_config

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "targets" / "board.yaml"
SMALL = {
    "body": "mocap/board",
    "shape": "board",
    "outline_m": [[-0.19, -0.12], [0.19, -0.12], [0.19, 0.12], [-0.19, 0.12]],
    "pattern": {
        "kind": "checkerboard",
        "inner_corners": [4, 3],
        "square_m": 0.03,
        "first_corner_m": [-0.045, -0.03],
        "first_square": "white",
    },
}


def written(folder, content):
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def laid_out(content, page="custom", turn_deg=0.0):
    block = validate_and_complete("target", content, "small")
    return lay_out_sheet(target_from_config(block), "small", page, turn_deg)


def example(**more):
    return laid_out(yaml.safe_load(EXAMPLE.read_text()), **more)


def page_mm(pdf):
    """Width and height of a PDF's page, mm."""
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf)
    return np.array([float(x) for x in box.groups()]) * 25.4 / 72


@pytest.mark.parametrize("page, mm", [("a3", (420, 297)), ("a2", (594, 420)), ("a0", (1189, 841))])
def test_a_sheet_has_the_size_of_its_page_upright_or_on_its_side(tmp_path, page, mm):
    out = tmp_path / "out.pdf"
    board.main([str(written(tmp_path, SMALL)), str(out), "--page", page])
    found = page_mm(out.read_bytes())
    expected = mm if page == "a3" else mm[::-1]  # only A3 is too narrow for it upright
    assert found == pytest.approx(expected, abs=0.02)


def test_a_millimetre_of_the_drawing_is_a_millimetre_on_the_page():
    drawn = draw_board_sheet(example(turn_deg=45))
    (ax,) = drawn.axes
    inches = ax.transData.transform([[0, 0], [100, 0], [0, 100]]) / drawn.dpi
    assert inches * 25.4 == pytest.approx(np.array([[0, 0], [100, 0], [0, 100]]), abs=1e-9)


def test_squares_have_the_number_and_the_size_of_the_config():
    patches = draw_board_sheet(example(turn_deg=45)).axes[0].patches
    black = [p for p in patches if p.get_fill()]
    assert len(black) == 7 * 6 // 2
    for p in black:
        sides = np.linalg.norm(np.diff(p.get_xy(), axis=0), axis=1)
        assert sides == pytest.approx([80] * 4, abs=1e-9)
        assert p.get_facecolor() == (0, 0, 0, 1) and p.get_linewidth() == 0


def test_inner_corners_are_where_squares_meet():
    block = validate_and_complete("target", yaml.safe_load(EXAMPLE.read_text()), EXAMPLE)
    target = target_from_config(block)
    corners = 1e3 * target.pattern.corners()[:, :2]
    vertices = make_black_squares(target).reshape(-1, 2)
    for corner in corners:
        assert np.sum(np.linalg.norm(vertices - corner, axis=1) < 1e-6) == 2


@pytest.mark.parametrize("first, blacks", [("black", 10), ("white", 10)])
def test_the_square_at_the_low_end_has_the_stated_colour(first, blacks):
    content = SMALL | {"pattern": SMALL["pattern"] | {"first_square": first}}
    block = validate_and_complete("target", content, "small")
    squares = make_black_squares(target_from_config(block))
    assert len(squares) == blacks
    low = np.any(np.all(np.isclose(squares[:, 0], [-75, -60]), axis=1))
    assert low == (first == "black")


def test_the_outline_is_cut_at_its_true_size_wherever_it_lies_on_the_page():
    for turn in (0, 45):
        line = example(turn_deg=turn).outline
        sides = np.linalg.norm(np.roll(line, -1, 0) - line, axis=1)
        assert sides == pytest.approx([1e3 * 0.7071 * np.sqrt(2)] * 4, abs=1e-6)


def test_suggested_markers_lie_off_outline_and_pattern_and_have_no_symmetry():
    places = example().marker_coordinates
    assert len(places) == 5 and np.all(places % 10 == 0)
    assert np.abs(places).sum(1).max() < 707.1 - 40 * np.sqrt(2)
    inside = (np.abs(places[:, 0]) < 280 + 30) & (np.abs(places[:, 1]) < 240 + 30)
    assert not inside.any()
    lengths = [np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]]
    assert np.diff(np.sort(lengths)).min() >= 10


def test_the_axes_are_shown_between_pattern_and_outline_and_meet_in_the_origin():
    block = validate_and_complete("target", SMALL, "small")
    strokes = make_axis_strokes(target_from_config(block))
    towards = strokes[:, 1] / np.linalg.norm(strokes[:, 1], axis=1)[:, None]
    assert towards == pytest.approx(np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]))
    assert np.abs(strokes[[0, 2], :, 0]).min() >= 75 and np.abs(strokes[..., 0]).max() < 190
    assert np.abs(strokes[[1, 3], :, 1]).min() >= 60 and np.abs(strokes[..., 1]).max() < 120


def test_a_printed_coordinate_is_where_its_cross_lies_on_the_target():
    drawn = example(turn_deg=45)
    first, second = drawn.markers[:2]
    length = np.linalg.norm(drawn.marker_coordinates[1] - drawn.marker_coordinates[0])
    assert np.linalg.norm(second - first) == pytest.approx(length)
    labels = {t.get_text() for t in draw_board_sheet(drawn).axes[0].texts}
    assert "({:.0f}, {:.0f})".format(*drawn.marker_coordinates[0]) in labels


def test_a_page_too_small_is_refused_with_both_sizes_and_the_remedy(tmp_path, capsys):
    out = tmp_path / "out.pdf"
    with pytest.raises(SystemExit) as stopped:
        board.main([str(EXAMPLE), str(out), "--page", "a3"])
    message = str(stopped.value)
    assert "1439 × 1463 mm" in message and "297 × 420 mm" in message
    assert "--page custom" in message and not out.exists()


def test_a_pattern_beyond_the_outline_is_refused():
    wide = SMALL | {"pattern": SMALL["pattern"] | {"square_m": 0.06}}
    with pytest.raises(InputError, match="larger than the outline"):
        laid_out(wide)


def test_a_cylinder_is_refused(tmp_path):
    with pytest.raises(InputError, match="shape cylinder cannot be printed; expected shape: board"):
        draw_target_pdf(ROOT / "config/targets/cylinder.yaml", tmp_path / "out.pdf", "custom", 0)


def test_the_same_target_gives_the_same_bytes_and_the_example_in_docs(tmp_path):
    made = []
    for name in ("a.pdf", "b.pdf"):
        board.main([str(EXAMPLE), str(tmp_path / name), "--turn-deg", "45"])
        made.append((tmp_path / name).read_bytes())
    assert made[0] == made[1] == (ROOT / "docs" / "board.pdf").read_bytes()


CHARUCO = {"kind": "charuco", "squares": [5, 7], "square_m": 0.04, "marker_m": 0.03}


@pytest.mark.parametrize("more", [{}, {"squares": [6, 8], "legacy": True}])
def test_a_charuco_board_is_drawn_as_opencv_finds_it(more):
    """Squares of 40 mm at 4 px per mm: all inner corners, within 1 px, with their numbers."""
    pattern = CHARUCO | {"dictionary": "DICT_5X5_100"} | more
    block = validate_and_complete(
        "target", {"body": "b", "shape": "board", "pattern": pattern}, "x"
    )
    made = target_from_config(block)
    low, high = made.vertices.min(0) - 0.01, made.vertices.max(0) + 0.01
    image = np.full(np.ceil(4e3 * (high - low)).astype(int)[::-1], 255, np.uint8)

    def to_pixels(mm):
        return np.column_stack([mm[:, 0] - 1e3 * low[0], 1e3 * high[1] - mm[:, 1]]) * 4

    for square in make_black_squares(made):
        (u0, v0), (u1, v1) = np.round([to_pixels(square).min(0), to_pixels(square).max(0)])
        image[int(v0) : int(v1), int(u0) : int(u1)] = 0
    found = made.pattern.detect_corners_fast(image)
    expected = to_pixels(1e3 * made.pattern.corners()) - 0.5
    np.testing.assert_allclose(found, expected, atol=1)


def test_the_sheet_of_a_charuco_board_says_what_is_printed(tmp_path):
    content = {"body": "b", "shape": "board", "pattern": CHARUCO | {"dictionary": "DICT_4X4_50"}}
    board.main([str(written(tmp_path, content)), str(tmp_path / "out.pdf")])
    assert page_mm((tmp_path / "out.pdf").read_bytes()) == pytest.approx([224, 328], abs=0.02)
    said = "5 × 7 squares of 40 mm along x × y, markers of 30 mm, DICT_4X4_50"
    assert said in laid_out(content).description
