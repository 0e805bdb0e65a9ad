"""A board target laid out on a sheet of paper at true size, in mm, and drawn as PDF."""

from dataclasses import dataclass
from itertools import combinations

import matplotlib
import numpy as np
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from calib.geometry.polygon import signed_polygon_distance
from calib.io.status import InputError

PAGE_SIZES_MM = {
    "a3": (297, 420),
    "a2": (420, 594),
    "a1": (594, 841),
    "a0": (841, 1189),
}  # mm, upright
SHEET_MARGIN_MM, TEXT_STRIP_MM = (
    12,
    24,
)  # mm: around the outline; below it, for words and the scale bar
SCALE_BAR_MM = 100  # mm, of the scale bars
N_MARKERS, MARKER_GRID_MM = 5, 10  # suggested markers; their coordinates are multiples of this, mm
MARKER_TO_OUTLINE_MM, MARKER_TO_PATTERN_MM = (
    40,
    30,
)  # mm from a marker to the outline, and to the pattern
MAX_STROKE_MM = 40  # mm, at most, of the strokes that show the axes
SHEET_INK_COLOR, SHEET_CUT_COLOR = "black", "#c02020"


@dataclass(frozen=True)
class BoardSheet:
    """What is printed, in mm from the page's lower left corner.

    size (2,) of the page; squares (n, 4, 2), the black ones; outline (m, 2); markers (k, 2) and
    their coordinates in the target frame, mm; strokes (4, 2, 2) along +x, +y, -x and -y, which meet
    in the origin when drawn on; turn, deg, of the target's x axis on the page; words on the strip.
    """

    size_mm: tuple
    squares: np.ndarray
    outline: np.ndarray
    markers: np.ndarray
    marker_coordinates: np.ndarray
    strokes: np.ndarray
    turn_deg: float
    description: str


def lay_out_sheet(board, name, page, turn_deg):
    """The Sheet of a Board on a page of PAGES, or on one as large as it needs ("custom")."""
    turn = np.radians(turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    outline = 1e3 * board.vertices @ R.T
    low, high = outline.min(0), outline.max(0)
    need = high - low + [2 * SHEET_MARGIN_MM, 2 * SHEET_MARGIN_MM + TEXT_STRIP_MM]
    size = _choose_page_size(need, page)
    shift = (size - need) / 2 + [SHEET_MARGIN_MM, SHEET_MARGIN_MM + TEXT_STRIP_MM] - low
    squares, marks = make_black_squares(board), suggest_marker_positions(board)

    def place(p):
        return p @ R.T + shift

    return BoardSheet(
        size_mm=tuple(size.tolist()),
        squares=place(squares),
        outline=outline + shift,
        markers=place(marks),
        marker_coordinates=marks,
        strokes=place(make_axis_strokes(board)),
        turn_deg=turn_deg,
        description=f"{name}: {_describe_pattern(board)}. Print at 100 %; both bars must measure {SCALE_BAR_MM} mm.",
    )


def _choose_page_size(need, page):
    """Size (2,), mm, of a page that holds need (2,), mm, upright or on its side."""
    if page == "custom":
        return np.ceil(need)
    for size in (PAGE_SIZES_MM[page], PAGE_SIZES_MM[page][::-1]):
        if np.all(need <= size):
            return np.array(size, float)
    wide, high = np.ceil(need)
    raise InputError(
        f"the sheet needs {wide:.0f} × {high:.0f} mm, {page} has "
        f"{PAGE_SIZES_MM[page][0]} × {PAGE_SIZES_MM[page][1]} mm; choose a larger --page, --page custom for a "
        "plotter, turn a diamond by --turn-deg 45, or make the board smaller"
    )


def _describe_pattern(board):
    if board.pattern is None:
        return "no pattern"
    p = board.pattern
    return (
        f"{p.n_columns} × {p.n_rows} inner corners along x × y, squares of {1e3 * p.square_m:g} mm"
    )


def find_pattern_box(board):
    """Low and high corner (2, 2), mm, target frame, of the pattern's squares; None without one."""
    if board.pattern is None:
        return None
    p = board.pattern
    low = 1e3 * (np.array(p.first_corner) - p.square_m)
    return np.stack([low, low + 1e3 * p.square_m * np.array([p.n_columns + 1, p.n_rows + 1])])


def make_black_squares(board):
    """(n, 4, 2), mm, target frame; raises InputError where they do not lie within the outline."""
    if board.pattern is None:
        return np.zeros((0, 4, 2))
    p, side = board.pattern, 1e3 * board.pattern.square_m
    first = 1 if p.first_square_color == "white" else 0
    cells = [
        (i, j) for j in range(p.n_rows + 1) for i in range(p.n_columns + 1) if (i + j) % 2 == first
    ]
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    squares = find_pattern_box(board)[0] + side * (np.array(cells)[:, None] + corner)
    if signed_polygon_distance(1e3 * board.vertices, squares.reshape(-1, 2)).max() > 1e-6:
        raise InputError("the pattern is larger than the outline: see first_corner_m and outline_m")
    return squares


def suggest_marker_positions(board):
    """(k, 2), mm, target frame: places for markers on the face, as unlike a symmetry as they can
    be; fewer than MARKERS, or none, where there is no room."""
    vertices, box = 1e3 * board.vertices, find_pattern_box(board)
    low, high = (
        MARKER_GRID_MM * np.ceil(vertices.min(0) / MARKER_GRID_MM),
        MARKER_GRID_MM * np.floor(vertices.max(0) / MARKER_GRID_MM),
    )
    x, y = np.meshgrid(
        *(np.arange(a, b + 1, MARKER_GRID_MM) for a, b in zip(low, high, strict=True))
    )
    free = np.stack([x, y], -1).reshape(-1, 2)
    free = free[signed_polygon_distance(vertices, free) < -MARKER_TO_OUTLINE_MM]
    if box is not None:
        free = free[
            np.any(
                (free < box[0] - MARKER_TO_PATTERN_MM) | (free > box[1] + MARKER_TO_PATTERN_MM),
                axis=1,
            )
        ]
    chosen = free[:0]
    while len(chosen) < N_MARKERS and len(free):
        merit = _marker_merit(chosen, free)
        best = int(np.argmax(merit))
        if len(chosen) > 1 and merit[best] < 3 * MARKER_GRID_MM:
            break
        chosen, free = np.vstack([chosen, free[best]]), np.delete(free, best, 0)
    return chosen


def _marker_merit(chosen, free):
    """Of each of free (n, 2), mm, beside chosen (k, 2): the smallest distance between any two, or
    three times the smallest difference of such distances where that is less; for the first its
    distance from the origin."""
    if len(chosen) == 0:
        return np.linalg.norm(free, axis=1)
    known = [np.linalg.norm(a - b) for a, b in combinations(chosen, 2)]
    away = np.linalg.norm(free[:, None] - chosen, axis=2)
    lengths = np.sort(np.hstack([np.tile(known, (len(free), 1)), away]), axis=1)
    return np.min(np.hstack([lengths[:, :1], 3 * np.diff(lengths)]), axis=1)


def make_axis_strokes(board):
    """(4, 2, 2), mm, target frame: strokes from (k, 0) to (k, 1) on the axes, towards +x, +y, -x
    and -y, between the pattern and the outline as far as there is room; of no length without."""
    box = find_pattern_box(board)
    strokes = []
    for direction in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        d = np.array(direction, float)
        start = 0 if box is None else max(0, (box @ d).max()) + MARKER_TO_PATTERN_MM / 2
        beyond = start + np.arange(1, MAX_STROKE_MM + 1)
        room = (
            signed_polygon_distance(1e3 * board.vertices, beyond[:, None] * d)
            < -MARKER_TO_PATTERN_MM / 3
        )
        strokes.append([start * d, (start + room.cumprod().sum()) * d])
    return np.array(strokes)


def draw_board_sheet(sheet):
    """The sheet as a figure whose data coordinates are millimetres on the page."""
    matplotlib.rcdefaults()
    fig = Figure(np.array(sheet.size_mm) / 25.4)
    ax = fig.add_axes((0, 0, 1, 1), xlim=(0, sheet.size_mm[0]), ylim=(0, sheet.size_mm[1]))
    ax.set_axis_off()
    for square in sheet.squares:
        ax.add_patch(Polygon(square, facecolor=SHEET_INK_COLOR, edgecolor="none", linewidth=0))
    ax.add_patch(Polygon(sheet.outline, fill=False, edgecolor=SHEET_CUT_COLOR, linewidth=0.5))
    for place, coordinates in zip(sheet.markers, sheet.marker_coordinates, strict=True):
        _draw_marker_cross(ax, place, "({:.0f}, {:.0f})".format(*coordinates), sheet.turn_deg)
    for stroke, label in zip(sheet.strokes, ("x", "y", "", ""), strict=True):
        _draw_axis_stroke(ax, stroke, label, sheet.turn_deg)
    _draw_text_strip(ax, sheet)
    return fig


def _draw_marker_cross(ax, place, label, turn):
    """A marker's place: a cross of 10 mm, its coordinates in the target frame beside it."""
    for d in ([5, 0], [0, 5]):
        ax.plot(*np.transpose([place - d, place + d]), color=SHEET_INK_COLOR, linewidth=0.5)
    ax.annotate(label, place, (6, 6), textcoords="offset points", fontsize=11, rotation=turn)


def _draw_axis_stroke(ax, stroke, label, turn):
    """A stroke along an axis, with the axis' letter at its end where it has one."""
    length = np.linalg.norm(stroke[1] - stroke[0])
    if length == 0:
        return
    ax.plot(*stroke.T, color=SHEET_INK_COLOR, linewidth=0.6)
    if label:
        beyond = stroke[1] + 5 * (stroke[1] - stroke[0]) / length
        ax.text(*beyond, label, fontsize=14, rotation=turn, ha="center", va="center")


def _draw_text_strip(ax, sheet):
    """Words along the lower edge, and a scale bar along either edge."""
    ticks = 2
    for along, across in (([1, 0], [0, 1]), ([0, 1], [1, 0])):
        start = np.array([SHEET_MARGIN_MM, 6.0]) if along[0] else np.array([6.0, SHEET_MARGIN_MM])
        end = start + SCALE_BAR_MM * np.array(along)
        ax.plot(*np.transpose([start, end]), color=SHEET_INK_COLOR, linewidth=0.5)
        for p in (start, end):
            tick = ticks * np.array(across)
            ax.plot(*np.transpose([p - tick, p + tick]), color=SHEET_INK_COLOR, linewidth=0.5)
    ax.text(SHEET_MARGIN_MM, 10, sheet.description, fontsize=8)
    note = (
        f"{SCALE_BAR_MM} mm. Cut along the red line. Crosses: places for markers, mm, target frame. "
        "Strokes: its axes, towards +x and +y where lettered; they meet in the origin."
    )
    ax.text(SHEET_MARGIN_MM, 15.5, note, fontsize=8)


def write_board_pdf(path, sheet):
    """Write the sheet as PDF, the same bytes for the same sheet."""
    fig = draw_board_sheet(sheet)
    FigureCanvasPdf(fig).print_pdf(str(path), metadata={"CreationDate": None})
