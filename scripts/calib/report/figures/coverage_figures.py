"""Coverage of each sensor as one row of plots: field of view, distances, incidence, directions."""

import numpy as np

from calib.report.figures import svg_plots
from calib.report.figures.captions import CAMERA_COVERAGE, LIDAR_COVERAGE
from calib.report.figures.svg_plots import BLUE, GREEN, GREY, MUTED_COLOR, ORANGE
from calib.report.sections.view_coverage import azimuth_elevation_deg

MAX_POINTS = 3000
N_BINS = 24
SKY_AXES = dict(xlim=(-180, 180), ylim=(-90, 90), xlabel="azimuth, °", ylabel="elevation, °")
PANEL_SHARES = (1.7, 1, 1, 1.4)


def draw_view_coverage(run, sensor, coverage):
    """The Drawing of one sensor's Coverage."""
    config = run.options["sensors"][sensor]
    fig, (field, distance, incidence, sky) = svg_plots.create_panels(PANEL_SHARES, height=2.05)
    if config["kind"] == "camera":
        _plot_image_coverage(field, coverage, config)
    else:
        _plot_lidar_coverage(field, coverage, config)
    field.set_title(f"{sensor}: field of view")
    _plot_histogram(distance, coverage.range_m, "distance, m", "distances")
    _plot_histogram(incidence, coverage.incidence_deg, "incidence, °", "incidence")
    _plot_target_directions(sky, coverage)
    camera = config["kind"] == "camera"
    caption = CAMERA_COVERAGE if camera else LIDAR_COVERAGE
    return svg_plots.finish_drawing(
        fig, f"coverage-{sensor}", f"Coverage of {sensor}", caption, column_span=0
    )


def _plot_points(ax, at):
    step = len(at) // MAX_POINTS + 1
    ax.plot(*at[::step].T, ".", ms=2.2, mew=0, alpha=0.7, color=GREEN, rasterized=True)


def _plot_image_coverage(ax, coverage, config):
    """Pixels of the members in the image."""
    width, height = config["size_px"]
    _plot_points(ax, coverage.view_coordinates)
    ax.plot(np.array([0, 1, 1, 0, 0]) * width - 0.5, np.array([0, 0, 1, 1, 0]) * height - 0.5,
            color=MUTED_COLOR, lw=0.8)  # fmt: skip
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", anchor="W")


def _plot_lidar_coverage(ax, coverage, config):
    """Azimuth and elevation of the members in a lidar's view."""
    _plot_points(ax, coverage.view_coordinates)
    sides = config.get("azimuth_deg", (-180, 180))
    low, high = config.get(
        "elevation_deg",
        (coverage.view_coordinates[:, 1].min(), coverage.view_coordinates[:, 1].max()),
    )
    room = 0.08 * (high - low) + 1
    ax.set(xlim=sides, ylim=(low - room, high + room))
    ax.set(xlabel="azimuth about its z axis, °", ylabel="elevation, °")


def _plot_histogram(ax, values, xlabel, title):
    if len(values):
        counts, edges = np.histogram(values, N_BINS)
        share = 100 * counts / len(values)
        ax.stairs(share, edges, fill=True, color=BLUE, alpha=0.75)
    ax.set(xlabel=xlabel, ylabel="% of points", title=title)


def _plot_target_directions(ax, coverage):
    """Normals and axes of the targets about the robot."""
    for at, mark, colour, label in (
        (azimuth_elevation_deg(coverage.normals), "o", BLUE, "normals"),
        (azimuth_elevation_deg(coverage.axes), "_", ORANGE, "axes"),
    ):
        if len(at):
            ax.plot(*at.T, mark, ms=4.5 if mark == "o" else 7, mew=1.6, color=colour, label=label)
    ax.set(title="directions", **SKY_AXES)
    ax.xaxis.set_ticks((-180, -90, 0, 90, 180))
    ax.yaxis.set_ticks((-90, -45, 0, 45, 90))
    ax.axhline(0, color=GREY, lw=0.6)
    if len(coverage.normals) or len(coverage.axes):
        # Beside the title: within, it would lie on what it names.
        place = dict(loc="lower right", bbox_to_anchor=(1, 0.99), borderpad=0, borderaxespad=0)
        ax.legend(ncols=2, columnspacing=0.8, handletextpad=0, handlelength=1.2, **place)
