"""Lay a board target out on a sheet of paper at true size, in mm, and draw it as PDF."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from calib.geometry.polygon import signed_polygon_distance
from calib.geometry.units import MM_PER_M
from calib.io.status import InputError
from calib.targets.board import Board

PAGE_SIZES_MM = {"a3": (297, 420), "a2": (420, 594), "a1": (594, 841), "a0": (841, 1189)}  # upright
SHEET_MARGIN_MM = 12  # around the outline
TEXT_STRIP_MM = 24  # below the outline, for the text and the scale bar
SCALE_BAR_MM = 100
N_MARKERS = 5  # suggested places for markers
MARKER_GRID_MM = 10  # the coordinates of markers are multiples of this
MARKER_TO_OUTLINE_MM = 40
MARKER_TO_PATTERN_MM = 30
MAX_STROKE_MM = 40  # of the strokes that show the axes
MM_PER_INCH = 25.4
SHEET_INK_COLOR, SHEET_CUT_COLOR = "black", "#c02020"


@dataclass(frozen=True)
class BoardSheet:
    """What is printed, in mm from the page's lower left corner.

    squares: (n, 4, 2) the black ones; outline: (m, 2); markers: (k, 2), and their coordinates in
    the target frame; strokes: (4, 2, 2) along +x, +y, -x and -y, which meet in the origin if
    extended; turn_deg: of the target's x axis on the page; description: the text on the strip.
    """

    size_mm: tuple[float, float]
    squares: np.ndarray
    outline: np.ndarray
    markers: np.ndarray
    marker_coordinates: np.ndarray
    strokes: np.ndarray
    turn_deg: float
    description: str


def lay_out_sheet(board: Board, name: str, page: str, turn_deg: float) -> BoardSheet:
    """Lay a board out on a page of PAGE_SIZES_MM, or on one as large as it needs ("custom").

    Raises InputError if the board does not fit or is smaller than its pattern.
    """
    turn = np.radians(turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    outline = MM_PER_M * board.vertices @ R.T
    low, high = outline.min(0), outline.max(0)
    required = high - low + [2 * SHEET_MARGIN_MM, 2 * SHEET_MARGIN_MM + TEXT_STRIP_MM]
    size = _choose_page_size(required, page)
    shift = (size - required) / 2 + [SHEET_MARGIN_MM, SHEET_MARGIN_MM + TEXT_STRIP_MM] - low
    squares, markers = make_black_squares(board), suggest_marker_positions(board)
    description = board.pattern.print_description if board.pattern else "no pattern"

    def to_page(points: np.ndarray) -> np.ndarray:
        return points @ R.T + shift

    return BoardSheet(
        size_mm=(float(size[0]), float(size[1])),
        squares=to_page(squares),
        outline=outline + shift,
        markers=to_page(markers),
        marker_coordinates=markers,
        strokes=to_page(make_axis_strokes(board)),
        turn_deg=turn_deg,
        description=f"{name}: {description}. Print at 100 %; "
        f"both bars must measure {SCALE_BAR_MM} mm.",
    )


def _choose_page_size(required: np.ndarray, page: str) -> np.ndarray:
    """Return the size (2,), mm, of a page, upright or on its side, that holds required (2,), mm."""
    if page == "custom":
        return np.ceil(required)
    for size in (PAGE_SIZES_MM[page], PAGE_SIZES_MM[page][::-1]):
        if np.all(required <= size):
            return np.array(size, float)
    width, height = np.ceil(required)
    raise InputError(
        f"page {page} is too small: the sheet needs {width:.0f} × {height:.0f} mm, {page} has "
        f"{PAGE_SIZES_MM[page][0]} × {PAGE_SIZES_MM[page][1]} mm. Choose a larger --page, use "
        "--page custom for a plotter, turn a diamond by --turn-deg 45, or make the board smaller."
    )


def find_pattern_box(board: Board) -> np.ndarray | None:
    """Return the low and high corner (2, 2), mm, target frame, of the pattern, or None."""
    if board.pattern is None:
        return None
    outline = MM_PER_M * board.pattern.outline
    return np.stack([outline.min(0), outline.max(0)])


def make_black_squares(board: Board) -> np.ndarray:
    """Return the black areas (n, 4, 2), mm, target frame.

    Raises InputError if they do not lie within the outline.
    """
    if board.pattern is None:
        return np.zeros((0, 4, 2))
    low, high = MM_PER_M * np.moveaxis(board.pattern.black_rectangles(), 1, 0)
    is_high = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    squares = low[:, None] + is_high * (high - low)[:, None]
    if signed_polygon_distance(MM_PER_M * board.vertices, squares.reshape(-1, 2)).max() > 1e-6:
        raise InputError(
            "the pattern is larger than the outline. Check first_corner_m, square_m and outline_m."
        )
    return squares


def suggest_marker_positions(board: Board) -> np.ndarray:
    """Return places (k, 2), mm, target frame, for markers on the face, far from any symmetry.

    k is N_MARKERS, or less where there is no room.
    """
    vertices, box = MM_PER_M * board.vertices, find_pattern_box(board)
    low = MARKER_GRID_MM * np.ceil(vertices.min(0) / MARKER_GRID_MM)
    high = MARKER_GRID_MM * np.floor(vertices.max(0) / MARKER_GRID_MM)
    x, y = (np.arange(a, b + 1, MARKER_GRID_MM) for a, b in zip(low, high, strict=True))
    free = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    free = free[signed_polygon_distance(vertices, free) < -MARKER_TO_OUTLINE_MM]
    if box is not None:
        is_beside = (free < box[0] - MARKER_TO_PATTERN_MM) | (free > box[1] + MARKER_TO_PATTERN_MM)
        free = free[is_beside.any(axis=1)]
    chosen = free[:0]
    while len(chosen) < N_MARKERS and len(free):
        merit = _marker_merit(chosen, free)
        best = int(np.argmax(merit))
        if len(chosen) > 1 and merit[best] < 3 * MARKER_GRID_MM:
            break
        chosen, free = np.vstack([chosen, free[best]]), np.delete(free, best, 0)
    return chosen


def _marker_merit(chosen: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return how well each free place (n, 2), mm, goes with the chosen ones (k, 2).

    The smallest distance between any two, or three times the smallest difference of such distances
    if that is less; for the first marker its distance from the origin.
    """
    if len(chosen) == 0:
        return np.linalg.norm(free, axis=1)
    between_chosen = [np.linalg.norm(a - b) for a, b in combinations(chosen, 2)]
    to_chosen = np.linalg.norm(free[:, None] - chosen, axis=2)
    lengths = np.sort(np.hstack([np.tile(between_chosen, (len(free), 1)), to_chosen]), axis=1)
    return np.min(np.hstack([lengths[:, :1], 3 * np.diff(lengths)]), axis=1)


def make_axis_strokes(board: Board) -> np.ndarray:
    """Return the strokes (4, 2, 2), mm, target frame, on the axes towards +x, +y, -x and -y.

    Each runs from [k, 0] to [k, 1], between the pattern and the outline as far as there is room; it
    has no length if there is none.
    """
    box = find_pattern_box(board)
    strokes = []
    for direction in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        d = np.array(direction, float)
        start = 0 if box is None else max(0, (box @ d).max()) + MARKER_TO_PATTERN_MM / 2
        positions = (start + np.arange(1, MAX_STROKE_MM + 1))[:, None] * d
        outside = signed_polygon_distance(MM_PER_M * board.vertices, positions)
        has_room = outside < -MARKER_TO_PATTERN_MM / 3
        strokes.append([start * d, (start + has_room.cumprod().sum()) * d])
    return np.array(strokes)


def draw_board_sheet(sheet: BoardSheet) -> Figure:
    """Draw the sheet as a figure whose data coordinates are millimetres on the page."""
    matplotlib.rcdefaults()
    width, height = sheet.size_mm
    fig = Figure((width / MM_PER_INCH, height / MM_PER_INCH))
    ax = fig.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
    ax.set_axis_off()
    for square in sheet.squares:
        ax.add_patch(Polygon(square, facecolor=SHEET_INK_COLOR, edgecolor="none", linewidth=0))
    ax.add_patch(Polygon(sheet.outline, fill=False, edgecolor=SHEET_CUT_COLOR, linewidth=0.5))
    for position, coordinates in zip(sheet.markers, sheet.marker_coordinates, strict=True):
        _draw_marker_cross(ax, position, "({:.0f}, {:.0f})".format(*coordinates), sheet.turn_deg)
    for stroke, label in zip(sheet.strokes, ("x", "y", "", ""), strict=True):
        _draw_axis_stroke(ax, stroke, label, sheet.turn_deg)
    _draw_text_strip(ax, sheet)
    return fig


def _draw_marker_cross(ax: Axes, position: np.ndarray, label: str, turn_deg: float) -> None:
    """Draw a cross of 10 mm at a marker's place, with its coordinates beside it."""
    for d in ([5, 0], [0, 5]):
        ax.plot(*np.transpose([position - d, position + d]), color=SHEET_INK_COLOR, linewidth=0.5)
    ax.annotate(
        label, tuple(position), (6, 6), textcoords="offset points", fontsize=11, rotation=turn_deg
    )


def _draw_axis_stroke(ax: Axes, stroke: np.ndarray, label: str, turn_deg: float) -> None:
    """Draw a stroke along an axis, with the label at its end."""
    length = np.linalg.norm(stroke[1] - stroke[0])
    if length == 0:
        return
    ax.plot(*stroke.T, color=SHEET_INK_COLOR, linewidth=0.6)
    if label:
        x, y = stroke[1] + 5 * (stroke[1] - stroke[0]) / length
        ax.text(x, y, label, fontsize=14, rotation=turn_deg, ha="center", va="center")


def _draw_text_strip(ax: Axes, sheet: BoardSheet) -> None:
    """Draw the text along the lower edge, and a scale bar along the lower and the left edge."""
    tick_mm = 2
    for along, across in (([1, 0], [0, 1]), ([0, 1], [1, 0])):
        start = np.array([SHEET_MARGIN_MM, 6.0]) if along[0] else np.array([6.0, SHEET_MARGIN_MM])
        end = start + SCALE_BAR_MM * np.array(along)
        ax.plot(*np.transpose([start, end]), color=SHEET_INK_COLOR, linewidth=0.5)
        for p in (start, end):
            tick = tick_mm * np.array(across)
            ax.plot(*np.transpose([p - tick, p + tick]), color=SHEET_INK_COLOR, linewidth=0.5)
    ax.text(SHEET_MARGIN_MM, 10, sheet.description, fontsize=8)
    note = (
        f"{SCALE_BAR_MM} mm. Cut along the red line. Crosses: places for markers, mm, target "
        "frame. Strokes: its axes, towards +x and +y where lettered; they meet in the origin."
    )
    ax.text(SHEET_MARGIN_MM, 15.5, note, fontsize=8)


def write_board_pdf(path: Path, sheet: BoardSheet) -> None:
    """Write the sheet as PDF, the same bytes for the same sheet."""
    fig = draw_board_sheet(sheet)
    FigureCanvasPdf(fig).print_pdf(str(path), metadata={"CreationDate": None})
