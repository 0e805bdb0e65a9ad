"""The result in a few lines for the terminal."""

from typing import Any

import numpy as np

from calib.io.pose_block import pose_from_config
from calib.report.number_format import format_number, format_plural
from calib.report.sections.extrinsics import (
    choose_pose_decimals,
    format_pose_error,
    format_pose_numbers,
    xyz_rpy_mm_deg,
    xyz_rpy_sigma,
)

MAX_LINES = 9  # without the line with the path of the report
MAX_LINE_CHARS = 110
TEXT_CELLS = (3, 7, 8)  # of x y z mm roll pitch yaw deg error: aligned to the left


def format_terminal_summary(
    calibration: dict[str, Any], verdict: dict[str, Any], truth: dict[str, dict[str, Any]]
) -> list[str]:
    """Return the verdict, its reasons, and a line per sensor: its pose, or why it has none.

    At most MAX_LINES lines, except for rigs with so many sensors that each takes one anyway.
    calibration, verdict: content of the JSON files; truth: pose blocks by sensor, if known.
    """
    sensors = sorted(calibration["sensors"].items())
    max_reasons = max(MAX_LINES - 1 - len(sensors), 1)
    lines = [f"{calibration['rig']}: {verdict['verdict'].upper()}"]
    lines += _shorten_reasons(verdict["reasons"], max_reasons)
    cells = {
        name: _format_pose_cells(sensor, truth.get(name))
        for name, sensor in sensors
        if sensor["T_robot_sensor"]
    }
    widths = [max(map(len, column)) for column in zip(*cells.values(), strict=True)]
    name_width = max((len(name) for name, _ in sensors), default=0)
    for name, sensor in sensors:
        if name in cells:
            text = _align_cells(cells[name], widths)
            lines.append(f"{name:{name_width}}  {text}".rstrip())
        else:
            text = f"no pose: {sensor['status']['reason']}"
            lines.append(f"{name:{name_width}}  {text}"[:MAX_LINE_CHARS])
    return lines


def _shorten_reasons(reasons: list[str], max_lines: int) -> list[str]:
    """Return the reasons, long ones cut, or the first of them and the number of the others."""
    lines = [
        r if len(r) <= MAX_LINE_CHARS else f"{r[: MAX_LINE_CHARS - 1].rstrip()}…" for r in reasons
    ]
    if len(lines) <= max_lines:
        return lines
    n_more = len(reasons) - (max_lines - 1)
    return [*lines[: max_lines - 1], f"and {format_plural(n_more, 'more reason')}, see the report"]


def _format_pose_cells(sensor: dict[str, Any], truth: dict[str, Any] | None) -> list[str]:
    """Return the cells of a pose with its σ, and its error if the truth is known."""
    T, covariance = np.array(sensor["T_robot_sensor"]["matrix"]), sensor["covariance"]
    sigma = xyz_rpy_sigma(T, covariance)
    # One digit of σ is enough here, and the line stays short.
    decimals = [max(d - 1, 0) for d in choose_pose_decimals(sigma)]
    x, y, z, roll, pitch, yaw = format_pose_numbers(xyz_rpy_mm_deg(T), decimals)
    sigma_mm, sigma_deg = (format_number(s.max(), 2) for s in sigma.reshape(2, 3))
    error_text = ""
    if truth is not None:
        error = format_pose_error(T, covariance, pose_from_config(truth)) or {}
        error_text = f"error {error['mm']} mm {error['deg']}° ({error['sigmas']} σ)"
    return [x, y, z, f"mm ± {sigma_mm},", roll, pitch, yaw, f"° ± {sigma_deg}", error_text]


def _align_cells(cells: list[str], widths: list[int]) -> str:
    """Join cells of the given widths: texts aligned to the left, numbers to the right."""
    return " ".join(
        f"{cell:{'<' if i in TEXT_CELLS else '>'}{width}}"
        for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
    )
