"""Coverage of each sensor as one row of plots: field of view, distances, incidence, directions."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib.report.data.run_data import ReportRun
from calib.report.figures import figure_encoding
from calib.report.figures.captions import CAMERA_COVERAGE, LIDAR_COVERAGE
from calib.report.figures.figure_encoding import BLUE, GREEN, GREY, MUTED_COLOR, ORANGE, Drawing
from calib.report.sections.coverage import ViewCoverage, azimuth_elevation_deg

MAX_POINTS = 3000
N_BINS = 24
SKY_AXES = {
    "xlim": (-180, 180),
    "ylim": (-90, 90),
    "xlabel": "azimuth, °",
    "ylabel": "elevation, °",
}
PANEL_SHARES = (1.7, 1, 1, 1.4)


def draw_view_coverage(run: ReportRun, sensor: str, coverage: ViewCoverage) -> Drawing:
    """Draw the coverage of one sensor."""
    config = run.options["sensors"][sensor]
    is_camera = config["kind"] == "camera"
    fig, (field, distance, incidence, sky) = figure_encoding.create_panels(
        PANEL_SHARES, height=2.05
    )
    if is_camera:
        _plot_image_coverage(field, coverage, config["size_px"])
    else:
        _plot_lidar_coverage(field, coverage, config)
    field.set_title(f"{sensor}: field of view")
    _plot_histogram(distance, coverage.range_m, "distance, m", "distances")
    _plot_histogram(incidence, coverage.incidence_deg, "incidence, °", "incidence")
    _plot_target_directions(sky, coverage)
    return figure_encoding.finish_drawing(
        fig,
        f"coverage-{sensor}",
        label=f"Coverage of {sensor}",
        caption=CAMERA_COVERAGE if is_camera else LIDAR_COVERAGE,
        column_span=0,
    )


def _plot_points(ax: Axes, points: np.ndarray) -> None:
    step = len(points) // MAX_POINTS + 1
    ax.plot(*points[::step].T, ".", ms=2.2, mew=0, alpha=0.7, color=GREEN, rasterized=True)


def _plot_image_coverage(ax: Axes, coverage: ViewCoverage, size_px: tuple[int, int]) -> None:
    """Plot the pixels of the inliers in the image."""
    width, height = size_px
    _plot_points(ax, coverage.view_coordinates)
    u, v = np.array([0, 1, 1, 0, 0]) * width - 0.5, np.array([0, 0, 1, 1, 0]) * height - 0.5
    ax.plot(u, v, color=MUTED_COLOR, lw=0.8)
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    ax.set(xlabel="u, px", ylabel="v, px", anchor="W")


def _plot_lidar_coverage(ax: Axes, coverage: ViewCoverage, config: dict[str, Any]) -> None:
    """Plot azimuth and elevation of the inliers in the view of a lidar."""
    _plot_points(ax, coverage.view_coordinates)
    elevation = coverage.view_coordinates[:, 1]
    low, high = config.get("elevation_deg", (elevation.min(), elevation.max()))
    margin = 0.08 * (high - low) + 1
    ax.set(xlim=config.get("azimuth_deg", (-180, 180)), ylim=(low - margin, high + margin))
    ax.set(xlabel="azimuth about its z axis, °", ylabel="elevation, °")


def _plot_histogram(ax: Axes, values: np.ndarray, xlabel: str, title: str) -> None:
    if len(values):
        counts, edges = np.histogram(values, N_BINS)
        share = 100 * counts / len(values)
        ax.stairs(share, edges, fill=True, color=BLUE, alpha=0.75)
    ax.set(xlabel=xlabel, ylabel="% of points", title=title)


def _plot_target_directions(ax: Axes, coverage: ViewCoverage) -> None:
    """Plot normals and axes of the targets as directions from the robot."""
    for directions, mark, size, color, label in (
        (coverage.normals, "o", 4.5, BLUE, "normals"),
        (coverage.axes, "_", 7, ORANGE, "axes"),
    ):
        if len(directions):
            angles = azimuth_elevation_deg(directions)
            ax.plot(*angles.T, mark, ms=size, mew=1.6, color=color, label=label)
    ax.set(title="directions", **SKY_AXES)
    ax.xaxis.set_ticks((-180, -90, 0, 90, 180))
    ax.yaxis.set_ticks((-90, -45, 0, 45, 90))
    ax.axhline(0, color=GREY, lw=0.6)
    if len(coverage.normals) or len(coverage.axes):
        # Beside the title: inside the axes it would hide points.
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1, 0.99),
            borderpad=0,
            borderaxespad=0,
            ncols=2,
            columnspacing=0.8,
            handletextpad=0,
            handlelength=1.2,
        )
