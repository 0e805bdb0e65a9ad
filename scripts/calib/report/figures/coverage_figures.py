"""Coverage of each sensor as one row of plots: field of view, distances, incidence, directions."""

import numpy as np

from calib.report.figures import captions, svg_plots
from calib.report.figures.svg_plots import BLUE, GREEN, GREY, MUTED, ORANGE
from calib.report.sections.view_coverage import angles

MOST_POINTS = 3000
BINS = 24
SKY = dict(xlim=(-180, 180), ylim=(-90, 90), xlabel="azimuth, °", ylabel="elevation, °")
SHARES = (1.7, 1, 1, 1.4)


def draw(run, sensor, found):
    """The Drawing of one sensor's Coverage."""
    config = run.options["sensors"][sensor]
    fig, (field, distance, incidence, sky) = svg_plots.panels(SHARES, height=2.05)
    if config["kind"] == "camera":
        _image(field, found, config)
    else:
        _view(field, found, config)
    field.set_title(f"{sensor}: field of view")
    _histogram(distance, found.range, "distance, m", "distances")
    _histogram(incidence, found.incidence, "incidence, °", "incidence")
    _directions(sky, found)
    camera = config["kind"] == "camera"
    caption = captions.COVERAGE_CAMERA if camera else captions.COVERAGE_LIDAR
    return svg_plots.drawing(fig, f"coverage-{sensor}", f"Coverage of {sensor}", caption, span=0)


def _scatter(ax, at):
    step = len(at) // MOST_POINTS + 1
    ax.plot(*at[::step].T, ".", ms=2.2, mew=0, alpha=0.7, color=GREEN, rasterized=True)


def _image(ax, found, config):
    """Pixels of the members in the image."""
    width, height = config["size_px"]
    _scatter(ax, found.at)
    ax.plot(np.array([0, 1, 1, 0, 0]) * width - 0.5, np.array([0, 0, 1, 1, 0]) * height - 0.5,
            color=MUTED, lw=0.8)  # fmt: skip
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", anchor="W")


def _view(ax, found, config):
    """Azimuth and elevation of the members in a lidar's view."""
    _scatter(ax, found.at)
    sides = config.get("azimuth_deg", (-180, 180))
    low, high = config.get("elevation_deg", (found.at[:, 1].min(), found.at[:, 1].max()))
    room = 0.08 * (high - low) + 1
    ax.set(xlim=sides, ylim=(low - room, high + room))
    ax.set(xlabel="azimuth about its z axis, °", ylabel="elevation, °")


def _histogram(ax, values, xlabel, title):
    if len(values):
        counts, edges = np.histogram(values, BINS)
        share = 100 * counts / len(values)
        ax.stairs(share, edges, fill=True, color=BLUE, alpha=0.75)
    ax.set(xlabel=xlabel, ylabel="% of points", title=title)


def _directions(ax, found):
    """Normals and axes of the targets about the robot."""
    for at, mark, colour, label in (
        (angles(found.normals), "o", BLUE, "normals"),
        (angles(found.axes), "_", ORANGE, "axes"),
    ):
        if len(at):
            ax.plot(*at.T, mark, ms=4.5 if mark == "o" else 7, mew=1.6, color=colour, label=label)
    ax.set(title="directions", **SKY)
    ax.xaxis.set_ticks((-180, -90, 0, 90, 180))
    ax.yaxis.set_ticks((-90, -45, 0, 45, 90))
    ax.axhline(0, color=GREY, lw=0.6)
    if len(found.normals) or len(found.axes):
        # Beside the title: within, it would lie on what it names.
        place = dict(loc="lower right", bbox_to_anchor=(1, 0.99), borderpad=0, borderaxespad=0)
        ax.legend(ncols=2, columnspacing=0.8, handletextpad=0, handlelength=1.2, **place)
