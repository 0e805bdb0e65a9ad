"""The result in a few lines for the terminal."""

from calib.io.pose_block import pose_from_config
from calib.report.number_format import format_number, format_plural
from calib.report.sections.extrinsics import (
    choose_pose_decimals,
    format_pose_error,
    format_pose_numbers,
    xyz_rpy_mm_deg,
    xyz_rpy_sigma,
)

MAX_LINES = 9  # without the line that says where the report is
MAX_LINE_CHARS = 110


def format_terminal_summary(calibration, verdict, truth):
    """At most nine lines: the verdict, its reasons, and every sensor's pose or why it has none.

    calibration.json and verdict.json as they are; truth: pose block by sensor, or empty. A rig of
    more than five sensors takes a line for each of them all the same.
    """
    sensors = sorted(calibration["sensors"].items())
    room = max(MAX_LINES - 1 - len(sensors), 1)
    told = [
        f"{calibration['rig']}: {verdict['verdict'].upper()}",
        *_shorten_reasons(verdict["reasons"], room),
    ]
    rows = [_format_cells(name, sensor, truth.get(name)) for name, sensor in sensors]
    posed = [row for row in rows if len(row) > 2]
    widths = [max(map(len, column)) for column in zip(*posed, strict=True)]
    name_width = max((len(name) for name, _ in sensors), default=0)
    return told + [_align_line(row, name_width, widths) for row in rows]


def _shorten_reasons(reasons, max_lines):
    """The reasons, or the first of them and how many there are beside; what is long is cut."""
    told = [
        r if len(r) <= MAX_LINE_CHARS else f"{r[: MAX_LINE_CHARS - 1].rstrip()}…" for r in reasons
    ]
    if len(told) <= max_lines:
        return told
    shown = told[: max_lines - 1]
    return [
        *shown,
        f"and {format_plural(len(reasons) - len(shown), 'reason')} more, in the report",
    ]


def _format_cells(name, sensor, truth):
    """What stands in the columns of one sensor: its name, the parts of its pose, its error."""
    if not sensor["T_robot_sensor"]:
        return name, f"no pose: {sensor['status']['reason']}"
    T = pose_from_config({"matrix": sensor["T_robot_sensor"]["matrix"]})
    sigma = xyz_rpy_sigma(T, sensor["covariance"])
    # One digit of σ is enough here, and lets the line fit.
    places = [max(d - 1, 0) for d in choose_pose_decimals(sigma)]
    told = format_pose_numbers(xyz_rpy_mm_deg(T), places)
    of_position, of_rotation = (format_number(s.max(), 2) for s in sigma.reshape(2, 3))
    cells = name, *told[:3], f"mm ± {of_position},", *told[3:], f"° ± {of_rotation}"
    return *cells, _format_error(T, sensor["covariance"], truth)


def _format_error(T, covariance, truth):
    if truth is None:
        return ""
    off = format_pose_error(T, covariance, pose_from_config(truth))
    return f"error {off['mm']} mm {off['deg']}° ({off['sigmas']} σ)"


def _align_line(row, name_width, widths):
    """One line: numbers to the right, words to the left."""
    name, *rest = row
    if len(rest) == 1:
        return f"{name:{name_width}}  {rest[0]}"[:MAX_LINE_CHARS]
    numbers = {1, 2, 3, 5, 6, 7}
    cells = [
        f"{cell:>{widths[i]}}" if i in numbers else f"{cell:{widths[i]}}"
        for i, cell in enumerate(rest, 1)
    ]
    return f"{name:{name_width}}  {' '.join(cells)}".rstrip()
