"""A board target laid out on a sheet of paper at true size, in mm, and drawn as PDF."""

from dataclasses import dataclass
from itertools import combinations

import matplotlib
import numpy as np
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from calib.geometry import polygon
from calib.io.status import InputError

PAGES = {"a3": (297, 420), "a2": (420, 594), "a1": (594, 841), "a0": (841, 1189)}  # mm, upright
MARGIN, STRIP = 12, 24  # mm: around the outline; below it, for words and the scale bar
BAR = 100  # mm, of the scale bars
MARKERS, GRID = 5, 10  # suggested markers; their coordinates are multiples of this, mm
INSIDE, CLEAR = 40, 30  # mm from a marker to the outline, and to the pattern
STROKE = 40  # mm, at most, of the strokes that show the axes
INK, CUT = "black", "#c02020"


@dataclass(frozen=True)
class Sheet:
    """What is printed, in mm from the page's lower left corner.

    size (2,) of the page; squares (n, 4, 2), the black ones; outline (m, 2); markers (k, 2) and
    their coordinates in the target frame, mm; strokes (4, 2, 2) along +x, +y, -x and -y, which meet
    in the origin when drawn on; turn, deg, of the target's x axis on the page; words on the strip.
    """

    size: tuple
    squares: np.ndarray
    outline: np.ndarray
    markers: np.ndarray
    coordinates: np.ndarray
    strokes: np.ndarray
    turn: float
    words: str


def lay_out(board, name, page, turn_deg):
    """The Sheet of a Board on a page of PAGES, or on one as large as it needs ("custom")."""
    turn = np.radians(turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    outline = 1e3 * board.vertices @ R.T
    low, high = outline.min(0), outline.max(0)
    need = high - low + [2 * MARGIN, 2 * MARGIN + STRIP]
    size = _page(need, page)
    shift = (size - need) / 2 + [MARGIN, MARGIN + STRIP] - low
    squares, marks = black_squares(board), marker_places(board)

    def place(p):
        return p @ R.T + shift

    return Sheet(
        size=tuple(size.tolist()),
        squares=place(squares),
        outline=outline + shift,
        markers=place(marks),
        coordinates=marks,
        strokes=place(axis_strokes(board)),
        turn=turn_deg,
        words=f"{name}: {_words(board)}. Print at 100 %; both bars must measure {BAR} mm.",
    )


def _page(need, page):
    """Size (2,), mm, of a page that holds need (2,), mm, upright or on its side."""
    if page == "custom":
        return np.ceil(need)
    for size in (PAGES[page], PAGES[page][::-1]):
        if np.all(need <= size):
            return np.array(size, float)
    wide, high = np.ceil(need)
    raise InputError(
        f"the sheet needs {wide:.0f} × {high:.0f} mm, {page} has "
        f"{PAGES[page][0]} × {PAGES[page][1]} mm; choose a larger --page, --page custom for a "
        "plotter, turn a diamond by --turn-deg 45, or make the board smaller"
    )


def _words(board):
    if board.pattern is None:
        return "no pattern"
    p = board.pattern
    return f"{p.columns} × {p.rows} inner corners along x × y, squares of {1e3 * p.square:g} mm"


def pattern_box(board):
    """Low and high corner (2, 2), mm, target frame, of the pattern's squares; None without one."""
    if board.pattern is None:
        return None
    p = board.pattern
    low = 1e3 * (np.array(p.first) - p.square)
    return np.stack([low, low + 1e3 * p.square * np.array([p.columns + 1, p.rows + 1])])


def black_squares(board):
    """(n, 4, 2), mm, target frame; raises InputError where they do not lie within the outline."""
    if board.pattern is None:
        return np.zeros((0, 4, 2))
    p, side = board.pattern, 1e3 * board.pattern.square
    first = 1 if p.first_square == "white" else 0
    cells = [
        (i, j) for j in range(p.rows + 1) for i in range(p.columns + 1) if (i + j) % 2 == first
    ]
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    squares = pattern_box(board)[0] + side * (np.array(cells)[:, None] + corner)
    if polygon.signed_distance(1e3 * board.vertices, squares.reshape(-1, 2)).max() > 1e-6:
        raise InputError("the pattern is larger than the outline: see first_corner_m and outline_m")
    return squares


def marker_places(board):
    """(k, 2), mm, target frame: places for markers on the face, as unlike a symmetry as they can
    be; fewer than MARKERS, or none, where there is no room."""
    vertices, box = 1e3 * board.vertices, pattern_box(board)
    low, high = (GRID * np.ceil(vertices.min(0) / GRID), GRID * np.floor(vertices.max(0) / GRID))
    x, y = np.meshgrid(*(np.arange(a, b + 1, GRID) for a, b in zip(low, high, strict=True)))
    free = np.stack([x, y], -1).reshape(-1, 2)
    free = free[polygon.signed_distance(vertices, free) < -INSIDE]
    if box is not None:
        free = free[np.any((free < box[0] - CLEAR) | (free > box[1] + CLEAR), axis=1)]
    chosen = free[:0]
    while len(chosen) < MARKERS and len(free):
        merit = _merit(chosen, free)
        best = int(np.argmax(merit))
        if len(chosen) > 1 and merit[best] < 3 * GRID:
            break
        chosen, free = np.vstack([chosen, free[best]]), np.delete(free, best, 0)
    return chosen


def _merit(chosen, free):
    """Of each of free (n, 2), mm, beside chosen (k, 2): the smallest distance between any two, or
    three times the smallest difference of such distances where that is less; for the first its
    distance from the origin."""
    if len(chosen) == 0:
        return np.linalg.norm(free, axis=1)
    known = [np.linalg.norm(a - b) for a, b in combinations(chosen, 2)]
    away = np.linalg.norm(free[:, None] - chosen, axis=2)
    lengths = np.sort(np.hstack([np.tile(known, (len(free), 1)), away]), axis=1)
    return np.min(np.hstack([lengths[:, :1], 3 * np.diff(lengths)]), axis=1)


def axis_strokes(board):
    """(4, 2, 2), mm, target frame: strokes from (k, 0) to (k, 1) on the axes, towards +x, +y, -x
    and -y, between the pattern and the outline as far as there is room; of no length without."""
    box = pattern_box(board)
    strokes = []
    for direction in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        d = np.array(direction, float)
        start = 0 if box is None else max(0, (box @ d).max()) + CLEAR / 2
        beyond = start + np.arange(1, STROKE + 1)
        room = polygon.signed_distance(1e3 * board.vertices, beyond[:, None] * d) < -CLEAR / 3
        strokes.append([start * d, (start + room.cumprod().sum()) * d])
    return np.array(strokes)


def figure(sheet):
    """The sheet as a figure whose data coordinates are millimetres on the page."""
    matplotlib.rcdefaults()
    fig = Figure(np.array(sheet.size) / 25.4)
    ax = fig.add_axes((0, 0, 1, 1), xlim=(0, sheet.size[0]), ylim=(0, sheet.size[1]))
    ax.set_axis_off()
    for square in sheet.squares:
        ax.add_patch(Polygon(square, facecolor=INK, edgecolor="none", linewidth=0))
    ax.add_patch(Polygon(sheet.outline, fill=False, edgecolor=CUT, linewidth=0.5))
    for place, coordinates in zip(sheet.markers, sheet.coordinates, strict=True):
        _cross(ax, place, "({:.0f}, {:.0f})".format(*coordinates), sheet.turn)
    for stroke, label in zip(sheet.strokes, ("x", "y", "", ""), strict=True):
        _stroke(ax, stroke, label, sheet.turn)
    _strip(ax, sheet)
    return fig


def _cross(ax, place, label, turn):
    """A marker's place: a cross of 10 mm, its coordinates in the target frame beside it."""
    for d in ([5, 0], [0, 5]):
        ax.plot(*np.transpose([place - d, place + d]), color=INK, linewidth=0.5)
    ax.annotate(label, place, (6, 6), textcoords="offset points", fontsize=11, rotation=turn)


def _stroke(ax, stroke, label, turn):
    """A stroke along an axis, with the axis' letter at its end where it has one."""
    length = np.linalg.norm(stroke[1] - stroke[0])
    if length == 0:
        return
    ax.plot(*stroke.T, color=INK, linewidth=0.6)
    if label:
        beyond = stroke[1] + 5 * (stroke[1] - stroke[0]) / length
        ax.text(*beyond, label, fontsize=14, rotation=turn, ha="center", va="center")


def _strip(ax, sheet):
    """Words along the lower edge, and a scale bar along either edge."""
    ticks = 2
    for along, across in (([1, 0], [0, 1]), ([0, 1], [1, 0])):
        start = np.array([MARGIN, 6.0]) if along[0] else np.array([6.0, MARGIN])
        end = start + BAR * np.array(along)
        ax.plot(*np.transpose([start, end]), color=INK, linewidth=0.5)
        for p in (start, end):
            tick = ticks * np.array(across)
            ax.plot(*np.transpose([p - tick, p + tick]), color=INK, linewidth=0.5)
    ax.text(MARGIN, 10, sheet.words, fontsize=8)
    note = (
        f"{BAR} mm. Cut along the red line. Crosses: places for markers, mm, target frame. "
        "Strokes: its axes, towards +x and +y where lettered; they meet in the origin."
    )
    ax.text(MARGIN, 15.5, note, fontsize=8)


def write(path, sheet):
    """Write the sheet as PDF, the same bytes for the same sheet."""
    fig = figure(sheet)
    FigureCanvasPdf(fig).print_pdf(str(path), metadata={"CreationDate": None})
