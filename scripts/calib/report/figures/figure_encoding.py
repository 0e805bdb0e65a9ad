"""Figures as inline SVG in the light or dark colours of the page, as files, and for paper."""

import io
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

FIGURE_WIDTH_IN, FIGURE_HEIGHT_IN = 3.6, 2.5  # width of a phone at a readable font size
PAGE_WIDTH_IN = 8.5
# Space for tick labels, axis labels and title.
MARGIN_LEFT_IN, MARGIN_RIGHT_IN, MARGIN_BOTTOM_IN, MARGIN_TOP_IN = 0.62, 0.12, 0.46, 0.26
SCREEN_DPI = 130  # of the parts of an SVG that are drawn as pixels
PAPER_DPI = 180
MAX_SPARSE_CHARS = 90_000  # length of an SVG up to which the PDF contains it
# Full colour resolution: otherwise thin coloured lines blur.
JPEG_OPTIONS = [
    cv2.IMWRITE_JPEG_QUALITY, 82,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]  # fmt: skip
Y_LABEL_DISTANCE_IN, X_LABEL_DISTANCE_IN = 0.44, 0.23  # from the axes
# Colours of the light page, which paper uses; encode_figure_svg lets them follow the page.
INK_COLOR, MUTED_COLOR, GRID_COLOR = "#1d2126", "#667080", "#e4e7eb"
THEME_VARIABLES = {INK_COLOR: "var(--ink)", MUTED_COLOR: "var(--muted)", GRID_COLOR: "var(--grid)"}
BLUE, ORANGE, GREEN, RED, PURPLE, GREY = (
    "#3f83e8", "#d9820f", "#1f9d63", "#d9483b", "#a05be0", "#8a93a0",
)  # fmt: skip
COLOR_CYCLE = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
# As in the figures of the paper.
GUESS_COLOR, RESULT_COLOR = RED, GREEN
SVG_NAMESPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
SVG_FONT_FAMILY = "Liberation Sans, Arial, DejaVu Sans, sans-serif"
MATPLOTLIB_STYLE = {
    "svg.fonttype": "none",
    "font.family": ["sans-serif"],
    # Matplotlib's own font, and it alone: each further name costs a search at every text.
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8,
    "text.hinting": "no_hinting",
    "text.color": INK_COLOR,
    "axes.labelcolor": INK_COLOR,
    "axes.edgecolor": MUTED_COLOR,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "axes.grid": True,
    "grid.color": GRID_COLOR,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED_COLOR,
    "ytick.color": MUTED_COLOR,
    "xtick.labelcolor": INK_COLOR,
    "ytick.labelcolor": INK_COLOR,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@dataclass(frozen=True)
class Drawing:
    """A figure with its caption.

    svg: an <svg> element; paper_jpeg: the figure for paper if the SVG is too large, else None;
    column_span: columns of the page that it takes, 0 for all.
    """

    svg: str
    paper_jpeg: bytes | None
    caption: str
    how_to_read: str = ""
    column_span: int = 1


def cycle_colors() -> Iterator[str]:
    """Yield the colours of lines, again and again."""
    return itertools.cycle(COLOR_CYCLE)


def compute_figure_height(aspect: float, width: float = FIGURE_WIDTH_IN) -> float:
    """Return the height, inch, of a figure whose axes have a ratio of height to width."""
    return MARGIN_BOTTOM_IN + MARGIN_TOP_IN + aspect * (width - MARGIN_LEFT_IN - MARGIN_RIGHT_IN)


def create_figure(
    width: float = FIGURE_WIDTH_IN, height: float = FIGURE_HEIGHT_IN, left: float = MARGIN_LEFT_IN
) -> tuple[Figure, Axes]:
    """Create an empty figure and its axes; left: space for tick labels, inch."""
    fig, axes = create_panels((1,), width, height, left)
    return fig, axes[0]


def apply_report_style() -> None:
    """Set the style of Matplotlib to MATPLOTLIB_STYLE alone. It is slow, so only if needed."""
    parameters = cast(dict[str, Any], matplotlib.rcParams)
    if any(parameters[k] != v for k, v in MATPLOTLIB_STYLE.items()):
        matplotlib.rcdefaults()
        parameters.update(MATPLOTLIB_STYLE)


def create_panels(
    shares: Sequence[float],
    width: float = PAGE_WIDTH_IN,
    height: float = FIGURE_HEIGHT_IN,
    left: float = MARGIN_LEFT_IN,
) -> tuple[Figure, list[Axes]]:
    """Create an empty figure and axes side by side, whose widths have the ratio of shares; inch."""
    apply_report_style()
    fig = Figure((width, height), dpi=SCREEN_DPI)
    free_width = width - left - MARGIN_RIGHT_IN - MARGIN_LEFT_IN * (len(shares) - 1)
    axes_height = (height - MARGIN_BOTTOM_IN - MARGIN_TOP_IN) / height
    axes, start = [], left
    for share in shares:
        axes_width = free_width * share / sum(shares)
        ax = fig.add_axes(
            (start / width, MARGIN_BOTTOM_IN / height, axes_width / width, axes_height)
        )
        ax.locator_params(nbins=5 if axes_width > FIGURE_WIDTH_IN / 2 else 4)
        _place_labels(fig, ax)
        axes.append(ax)
        start += axes_width + MARGIN_LEFT_IN
    return fig, axes


def _place_labels(fig: Figure, ax: Axes) -> None:
    """Put labels at a fixed distance: their search beside ticks takes a quarter of the drawing."""
    y_offset = ScaledTranslation(-Y_LABEL_DISTANCE_IN, 0, fig.dpi_scale_trans)
    x_offset = ScaledTranslation(0, -X_LABEL_DISTANCE_IN, fig.dpi_scale_trans)
    ax.yaxis.set_label_coords(0, 0.5, transform=ax.transAxes + y_offset)
    ax.xaxis.set_label_coords(0.5, 0, transform=ax.transAxes + x_offset)


def finish_drawing(
    fig: Figure, name: str, *, label: str, caption: str, column_span: int = 1
) -> Drawing:
    """Encode a figure.

    name: unique on the page; label: read aloud; caption: from "Good:" on it becomes how_to_read.
    """
    description, good, how_to_read = caption.partition("Good:")
    svg = encode_figure_svg(fig, name, label)
    jpeg = None if is_sparse_svg(svg) else encode_figure_jpeg(fig)
    return Drawing(svg, jpeg, description.strip(), (good + how_to_read).strip(), column_span)


def is_sparse_svg(svg: str) -> bool:
    """Return whether an <svg> is so small that the PDF contains it, with sharp lines and text."""
    return len(svg) < MAX_SPARSE_CHARS and "<image" not in svg


def encode_figure_jpeg(fig: Figure) -> bytes:
    """Encode the figure on white as JPEG, which a PDF contains unchanged; PNG is packed again.

    A full SVG would take longer in the PDF: each of its elements is laid out.
    """
    fig.patch.set_facecolor("white")
    fig.set_dpi(PAPER_DPI)
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    bgr = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
    return cv2.imencode(".jpg", bgr, JPEG_OPTIONS)[1].tobytes()


def encode_figure_svg(fig: Figure, name: str, label: str) -> str:
    """Encode the figure as an <svg> element; name makes its ids unique, label is read aloud."""
    buffer = io.StringIO()
    matplotlib.rcParams["svg.hashsalt"] = name
    # Directly to the canvas: savefig would draw everything twice.
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.S)
    svg = _remove_empty_groups(re.sub(r'<g id="[^"]*"', "<g", svg))
    svg = svg.replace("xlink:href", "href")
    svg = re.sub(r" font-family: [^;\"]*;| transform=\"rotate\(-0 [^\"]*\"|\n", "", svg)
    for light_color, variable in THEME_VARIABLES.items():
        svg = svg.replace(light_color, variable)
    view_box = re.findall(r'viewBox="[^"]*"', svg)[0]
    opening = f'<svg class="plot" role="img" aria-label="{label}" {view_box}>'
    return re.sub(r"<svg.*?>", lambda _: opening, svg, count=1, flags=re.S)


def _remove_empty_groups(svg: str) -> str:
    """Remove the tags of groups without attributes, which are half of all elements."""
    has_attributes: list[bool] = []  # of the open groups
    parts = []
    svg = re.sub(r"<g\b[^>]*/>", "", svg)
    for part in re.split(r"(<g\b[^>]*>|</g>)", svg):
        if part.startswith("<g"):
            has_attributes.append(part != "<g>")
        is_kept = has_attributes.pop() if part == "</g>" else part != "<g>"
        parts.append(part.strip() if is_kept else "")
    return "".join(parts)


def make_standalone_svg(svg: str) -> str:
    """Return an <svg> element that needs no page around it, in the colours of the light page."""
    for light_color, variable in THEME_VARIABLES.items():
        svg = svg.replace(variable, light_color)
    return svg.replace("<svg ", f'<svg {SVG_NAMESPACES} font-family="{SVG_FONT_FAMILY}" ', 1)


def encode_for_paper(drawing: Drawing) -> tuple[str, bytes]:
    """Return the media type and the bytes of a drawing for the PDF."""
    if drawing.paper_jpeg is None:
        return "image/svg+xml", make_standalone_svg(drawing.svg).encode()
    return "image/jpeg", drawing.paper_jpeg


def tile_drawings(drawings: Sequence[Drawing], n_columns: int) -> str:
    """Return an SVG file, as text, of drawings in rows of n_columns."""
    number = r"([\d.]+)"
    boxes = [re.findall(rf'viewBox="[\d.]+ [\d.]+ {number} {number}"', d.svg)[0] for d in drawings]
    sizes = np.reshape([[float(w), float(h)] for w, h in boxes], (-1, 2))
    parts, top, total_width = [], 0.0, 1.0
    for i in range(0, len(drawings), n_columns):
        row = sizes[i : i + n_columns]
        left = np.cumsum(row[:, 0]) - row[:, 0]
        for k, (w, h) in enumerate(row):
            box = f'x="{left[k]:g}" y="{top:g}" width="{w:g}" height="{h:g}"'
            parts.append(drawings[i + k].svg.replace("<svg ", f"<svg {box} ", 1))
        top, total_width = top + row[:, 1].max(), max(total_width, row[:, 0].sum())
    view_box = f'viewBox="0 0 {total_width:g} {max(top, 1.0):g}"'
    return make_standalone_svg(f"<svg {view_box}>{''.join(parts)}</svg>\n")
