"""Figures as inline SVG that follows the page's light or dark colours, as files, and for paper."""

import io
import re
from dataclasses import dataclass

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

FIGURE_WIDTH_IN, FIGURE_HEIGHT_IN, PAGE_WIDTH_IN = (
    3.6,
    2.5,
    8.5,
)  # inch: a phone's width at a readable size; the page's
MARGIN_LEFT_IN, MARGIN_RIGHT_IN, MARGIN_BOTTOM_IN, MARGIN_TOP_IN = (
    0.62,
    0.12,
    0.46,
    0.26,
)  # inch, for tick labels, axis labels and title
SCREEN_DPI = 130  # of what is drawn as pixels in an SVG
PAPER_DPI = 180
MAX_SPARSE_CHARS = 90_000  # characters of an SVG, up to which paper shows it
# Full colour resolution, or thin lines of colour smear.
JPEG_OPTIONS = [cv2.IMWRITE_JPEG_QUALITY, 82, cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]  # fmt: skip
LABEL_DISTANCES_IN = 0.44, 0.23  # inch from the axes to the labels of y and x
# The light page's own colours, so that paper needs no others; to_svg makes them follow the page.
INK_COLOR, MUTED_COLOR, GRID_COLOR = "#1d2126", "#667080", "#e4e7eb"
THEME_VARIABLES = {INK_COLOR: "var(--ink)", MUTED_COLOR: "var(--muted)", GRID_COLOR: "var(--grid)"}
BLUE, ORANGE, GREEN, RED, PURPLE, GREY = (
    "#3f83e8", "#d9820f", "#1f9d63", "#d9483b", "#a05be0", "#8a93a0",
)  # fmt: skip
COLOR_CYCLE = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
# As in the paper's figures: the first guess, the result.
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
    """A figure with its caption: an <svg> element, and the JPEG that paper shows in its stead where
    there is much in it.

    caption says what is seen, reading what good looks like; span: how many of the page's columns
    it takes, 0 for all of them. A photograph or a sparse plot has no JPEG: paper shows its <svg>.
    """

    svg: str
    paper_jpeg: bytes | None
    caption: str
    how_to_read: str = ""
    column_span: int = 1


def compute_figure_height(aspect, width=FIGURE_WIDTH_IN):
    """Height, inch, of a figure whose axes are `share` as high as wide."""
    return MARGIN_BOTTOM_IN + MARGIN_TOP_IN + aspect * (width - MARGIN_LEFT_IN - MARGIN_RIGHT_IN)


def create_figure(width=FIGURE_WIDTH_IN, height=FIGURE_HEIGHT_IN, left=MARGIN_LEFT_IN):
    """An empty figure of the report's style and its axes; left: room for its tick labels, inch."""
    fig, axes = create_panels((1,), width, height, left)
    return fig, axes[0]


def apply_report_style():
    """Matplotlib's defaults but for STYLE, whatever its user prefers; slow, so only if needed."""
    if any(matplotlib.rcParams[k] != v for k, v in MATPLOTLIB_STYLE.items()):
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(MATPLOTLIB_STYLE)


def create_panels(
    shares, width=PAGE_WIDTH_IN, height=FIGURE_HEIGHT_IN, left=MARGIN_LEFT_IN, gap=MARGIN_LEFT_IN
):
    """An empty figure and axes side by side, their widths in proportion to shares; inches."""
    apply_report_style()
    fig = Figure((width, height), dpi=SCREEN_DPI)
    room = width - left - MARGIN_RIGHT_IN - gap * (len(shares) - 1)
    axes, at = [], left
    for share in shares:
        inside = room * share / sum(shares)
        box = (
            at / width,
            MARGIN_BOTTOM_IN / height,
            inside / width,
            (height - MARGIN_BOTTOM_IN - MARGIN_TOP_IN) / height,
        )
        axes.append(fig.add_axes(box))
        axes[-1].locator_params(nbins=5 if inside > FIGURE_WIDTH_IN / 2 else 4)
        _place_labels(fig, axes[-1])
        at += inside + gap
    return fig, axes


def _place_labels(fig, ax):
    """Labels at a fixed distance: to find room beside the ticks takes a quarter of the drawing."""
    left, below = (-LABEL_DISTANCES_IN[0], 0), (0, -LABEL_DISTANCES_IN[1])
    offset = [ax.transAxes + ScaledTranslation(*o, fig.dpi_scale_trans) for o in (left, below)]
    ax.yaxis.set_label_coords(0, 0.5, transform=offset[0])
    ax.xaxis.set_label_coords(0.5, 0, transform=offset[1])


def finish_drawing(fig, name, label, caption, column_span=1):
    """The Drawing of a figure; what its caption says from "Good:" on is its reading."""
    seen, good, reading = caption.partition("Good:")
    svg = encode_figure_svg(fig, name, label)
    raster = None if is_sparse_svg(svg) else encode_figure_jpeg(fig)
    return Drawing(svg, raster, seen.strip(), (good + reading).strip(), column_span)


def is_sparse_svg(svg):
    """Whether so little is in an <svg> that paper takes it as it is, with sharp lines and text."""
    return len(svg) < MAX_SPARSE_CHARS and "<image" not in svg


def encode_figure_jpeg(fig):
    """The figure on white, as JPEG bytes, which a PDF takes as they are; PNG is packed anew.

    On paper a full SVG would take longer than this: every element of it is laid out.
    """
    fig.patch.set_facecolor("white")
    fig.set_dpi(PAPER_DPI)
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    bgr = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
    return cv2.imencode(".jpg", bgr, JPEG_OPTIONS)[1].tobytes()


def encode_figure_svg(fig, name, label):
    """The figure as an <svg> element; name keeps its ids its own, label is what is read aloud."""
    buffer = io.StringIO()
    matplotlib.rcParams["svg.hashsalt"] = name
    # Straight to the canvas: savefig would draw everything twice.
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.S)
    svg = _remove_empty_groups(re.sub(r'<g id="[^"]*"', "<g", svg))
    svg = svg.replace("xlink:href", "href")
    svg = re.sub(r" font-family: [^;\"]*;| transform=\"rotate\(-0 [^\"]*\"|\n", "", svg)
    for light, colour in THEME_VARIABLES.items():
        svg = svg.replace(light, colour)
    box = re.search(r'viewBox="[^"]*"', svg)[0]
    opening = f'<svg class="plot" role="img" aria-label="{label}" {box}>'
    return re.sub(r"<svg.*?>", lambda _: opening, svg, count=1, flags=re.S)


def _remove_empty_groups(svg):
    """The SVG without groups that say nothing, which are half of its elements."""
    kept, parts = [], []
    svg = re.sub(r"<g\b[^>]*/>", "", svg)
    for part in re.split(r"(<g\b[^>]*>|</g>)", svg):
        if part.startswith("<g"):
            kept.append(part != "<g>")
        said = kept.pop() if part == "</g>" else part != "<g>"
        parts.append(part.strip() if said else "")
    return "".join(parts)


def make_standalone_svg(svg):
    """An <svg> element that needs no page around it, in the light page's colours."""
    for light, colour in THEME_VARIABLES.items():
        svg = svg.replace(colour, light)
    return svg.replace("<svg ", f'<svg {SVG_NAMESPACES} font-family="{SVG_FONT_FAMILY}" ', 1)


def encode_for_paper(drawing):
    """(media type, bytes) of a Drawing."""
    if drawing.paper_jpeg is None:
        return "image/svg+xml", make_standalone_svg(drawing.svg).encode()
    return "image/jpeg", drawing.paper_jpeg


def tile_drawings(drawings, n_columns):
    """An SVG file, as text, of several Drawings in rows of so many columns."""
    boxes = [re.search(r'viewBox="[\d.]+ [\d.]+ ([\d.]+) ([\d.]+)"', d.svg) for d in drawings]
    sizes = np.reshape([[float(b[1]), float(b[2])] for b in boxes], (-1, 2))
    parts, top, widest = [], 0.0, 1.0
    for i in range(0, len(drawings), n_columns):
        row = sizes[i : i + n_columns]
        left = np.cumsum(row[:, 0]) - row[:, 0]
        for k, (w, h) in enumerate(row):
            place = f'x="{left[k]:g}" y="{top:g}" width="{w:g}" height="{h:g}"'
            parts.append(drawings[i + k].svg.replace("<svg ", f"<svg {place} ", 1))
        top, widest = top + row[:, 1].max(), max(widest, row[:, 0].sum())
    box = f'viewBox="0 0 {widest:g} {max(top, 1.0):g}"'
    return make_standalone_svg(f"<svg {box}>{''.join(parts)}</svg>\n")
