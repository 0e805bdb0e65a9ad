"""The result in a few lines for the terminal."""

from calib.io import pose_block
from calib.report import number_format
from calib.report.sections import extrinsics

MOST_LINES = 9  # without the line that says where the report is
WIDEST = 110


def lines(calibration, verdict, truth):
    """At most nine lines: the verdict, its reasons, and every sensor's pose or why it has none.

    calibration.json and verdict.json as they are; truth: pose block by sensor, or empty. A rig of
    more than five sensors takes a line for each of them all the same.
    """
    sensors = sorted(calibration["sensors"].items())
    room = max(MOST_LINES - 1 - len(sensors), 1)
    told = [f"{calibration['rig']}: {verdict['verdict'].upper()}", *_some(verdict["reasons"], room)]
    rows = [_cells(name, sensor, truth.get(name)) for name, sensor in sensors]
    posed = [row for row in rows if len(row) > 2]
    widths = [max(map(len, column)) for column in zip(*posed, strict=True)]
    name_width = max((len(name) for name, _ in sensors), default=0)
    return told + [_aligned(row, name_width, widths) for row in rows]


def _some(reasons, most):
    """The reasons, or the first of them and how many there are beside; what is long is cut."""
    told = [r if len(r) <= WIDEST else f"{r[: WIDEST - 1].rstrip()}…" for r in reasons]
    if len(told) <= most:
        return told
    shown = told[: most - 1]
    return [
        *shown,
        f"and {number_format.plural(len(reasons) - len(shown), 'reason')} more, in the report",
    ]


def _cells(name, sensor, truth):
    """What stands in the columns of one sensor: its name, the parts of its pose, its error."""
    if not sensor["T_robot_sensor"]:
        return name, f"no pose: {sensor['status']['reason']}"
    T = pose_block.pose({"matrix": sensor["T_robot_sensor"]["matrix"]})
    sigma = extrinsics.sigmas(T, sensor["covariance"])
    # One digit of σ is enough here, and lets the line fit.
    places = [max(d - 1, 0) for d in extrinsics.decimals(sigma)]
    told = extrinsics.fixed(extrinsics.numbers(T), places)
    of_position, of_rotation = (number_format.number(s.max(), 2) for s in sigma.reshape(2, 3))
    cells = name, *told[:3], f"mm ± {of_position},", *told[3:], f"° ± {of_rotation}"
    return *cells, _error(T, sensor["covariance"], truth)


def _error(T, covariance, truth):
    if truth is None:
        return ""
    off = extrinsics.told_error(T, covariance, pose_block.pose(truth))
    return f"error {off['mm']} mm {off['deg']}° ({off['sigmas']} σ)"


def _aligned(row, name_width, widths):
    """One line: numbers to the right, words to the left."""
    name, *rest = row
    if len(rest) == 1:
        return f"{name:{name_width}}  {rest[0]}"[:WIDEST]
    numbers = {1, 2, 3, 5, 6, 7}
    cells = [
        f"{cell:>{widths[i]}}" if i in numbers else f"{cell:{widths[i]}}"
        for i, cell in enumerate(rest, 1)
    ]
    return f"{name:{name_width}}  {' '.join(cells)}".rstrip()
