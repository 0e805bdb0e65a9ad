"""Figures as inline SVG that follows the page's light or dark colours."""

import io
import re

import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

WIDTH, HEIGHT, WIDE = 3.6, 2.5, 8.5  # inch: a phone's width at a readable size; the page's
LEFT, RIGHT, BOTTOM, TOP = 0.62, 0.12, 0.46, 0.26  # inch, for tick labels, axis labels and title
DPI = 160  # of what is drawn as pixels
# Stand-ins that to_svg replaces by the page's colours.
INK, MUTED, GRID = "#010203", "#040506", "#070809"
THEME = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--grid)"}
BLUE, ORANGE, GREEN, RED, PURPLE, GREY = (
    "#3f83e8", "#d9820f", "#1f9d63", "#d9483b", "#a05be0", "#8a93a0",
)  # fmt: skip
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 8,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def height_for(share, width=WIDTH):
    """Height, inch, of a figure whose axes are `share` as high as wide."""
    return BOTTOM + TOP + share * (width - LEFT - RIGHT)


def figure(width=WIDTH, height=HEIGHT, left=LEFT):
    """An empty figure of the report's style and its axes; left: room for its tick labels, inch."""
    matplotlib.rcdefaults()
    matplotlib.rcParams.update(STYLE)
    fig = Figure((width, height), dpi=DPI)
    inside = width - left - RIGHT, height - BOTTOM - TOP
    ax = fig.add_axes((left / width, BOTTOM / height, inside[0] / width, inside[1] / height))
    ax.locator_params(nbins=6)
    return fig, ax


def to_svg(fig, name, label):
    """The figure as an <svg> element; name keeps its ids its own, label is what is read aloud."""
    buffer = io.StringIO()
    matplotlib.rcParams["svg.hashsalt"] = name
    # Straight to the canvas: savefig would draw everything twice.
    FigureCanvasSVG(fig).print_svg(buffer, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", svg, flags=re.S)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = svg.replace("xlink:href", "href")
    svg = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", svg)
    for stand_in, colour in THEME.items():
        svg = svg.replace(stand_in, colour)
    box = re.search(r'viewBox="[^"]*"', svg)[0]
    opening = f'<svg class="plot" role="img" aria-label="{label}" {box}>'
    return re.sub(r"<svg.*?>", lambda _: opening, svg, count=1, flags=re.S)
