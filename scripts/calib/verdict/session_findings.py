"""Findings on poses that differ between the sessions of a rig."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.io.config_change import pipeline_change
from calib.verdict.findings import Finding, Limits, make_finding
from calib.verdict.model_error_findings import format_shift, is_failing_shift

MIN_ALIKE_SHARE = 0.9  # of the squared shifts of sensors, that a shift of the markers explains


def repeatability_findings(rows: list[dict[str, Any]], limits: Limits) -> list[Finding]:
    """Return one finding for each sensor whose pose differs between sessions.

    If all sensors shift alike, the robot's markers moved: one finding for all of them.
    """
    rows = [row for row in rows if _has_moved(row["shift"], row["p_value"], limits)]
    most_significant: dict[str, dict[str, Any]] = {}
    for row in sorted(rows, key=lambda r: r["p_value"]):
        most_significant.setdefault(row["sensor"], row)
    alike = [row for row in rows if _has_alike_shift(row, rows)]
    if alike:
        # Two sessions differ from each other alike: the later one is the one that changed.
        first = min(row["p_value"] for row in alike)
        return [
            _moved_markers_finding([r for r in alike if r["p_value"] == first][-1], rows, limits)
        ]
    return [
        _session_shift_finding(name, row, limits) for name, row in sorted(most_significant.items())
    ]


def _has_moved(shift: Sequence[float], p_value: float, limits: Limits) -> bool:
    is_significant = p_value <= limits["warn_error_p_value"]
    return is_significant and bool(np.linalg.norm(shift[:3]) >= limits["warn_error_moves_pose_m"])


def _has_alike_shift(row: dict[str, Any], moved_rows: Sequence[dict[str, Any]]) -> bool:
    """Return whether several sensors moved in the session of a row, and by the same shift."""
    n_moved = sum(other["session"] == row["session"] for other in moved_rows)
    markers = row["markers"]
    return bool(n_moved > 1 and markers and markers["explained_share"] >= MIN_ALIKE_SHARE)


def _moved_markers_finding(
    row: dict[str, Any], moved_rows: Sequence[dict[str, Any]], limits: Limits
) -> Finding:
    """Return the finding on markers of the robot that moved between sessions."""
    session, key = row["session"], f"sessions.{row['session']}.remounted"
    m, rad = np.linalg.norm(np.reshape(row["markers"]["shift"], (2, 3)), axis=1)
    return make_finding(
        "sensor_moved",
        sorted({other["sensor"] for other in moved_rows}),
        "fail" if is_failing_shift(m, rad, limits) else "warn",
        text=f"the robot's markers sit elsewhere in session {session} than in the other sessions, "
        f"by {format_shift(m, rad)} in the robot frame: all sensors shift alike",
        remedy=f"Set {key}: true, if the markers were re-attached or knocked before {session}.",
        change=pipeline_change(key, True),
    )


def _session_shift_finding(name: str, row: dict[str, Any], limits: Limits) -> Finding:
    """Return the finding on a sensor that moved between sessions."""
    session = row["session"]
    m, rad = np.linalg.norm(np.reshape(row["shift"], (2, 3)), axis=1)
    shift = format_shift(m, rad)
    return make_finding(
        "sensor_moved",
        [name],
        "fail" if is_failing_shift(m, rad, limits) else "warn",
        text=f"{name}: its pose in session {session} differs by {shift} from the other sessions",
        remedy=(
            f"Check whether {name} was moved or bumped before or after {session}, and calibrate "
            "the later sessions separately. If all sensors moved alike, the robot's markers moved: "
            f"set sessions.{session}.remounted: true."
        ),
    )
