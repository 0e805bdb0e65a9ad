"""What failed or nearly failed, ranked by its cost."""

from typing import Any

import numpy as np

from calib.geometry.units import DEG_PER_RAD, MM_PER_M
from calib.report.data.run_data import ReportRun
from calib.report.number_format import DASH, format_count, format_number, format_plural
from calib.verdict.findings import VERDICT_LEVELS

LOWER_LIMIT_CHECKS = ("placements", "tilt_deg")  # checks of which small values are bad


def tabulate_diagnostics(
    run: ReportRun, losses_by_session: dict[str, list[dict[str, Any]]]
) -> list[dict[str, str]]:
    """Return {level, text, cost, remedy} of all findings, then of all losses of views.

    Each part begins with the most expensive. losses_by_session: rows of tabulate_frame_losses.
    """
    findings = [(*_rank_finding(run, f), f) for f in run.verdict["findings"]]
    findings.sort(key=lambda item: (-VERDICT_LEVELS.index(item[2]["level"]), -item[0]))
    rows = [
        {"level": f["level"], "text": f["text"], "cost": cost, "remedy": f["remedy"]}
        for _, cost, f in findings
    ]
    return rows + tabulate_lost_views(run, losses_by_session)


def _rank_finding(run: ReportRun, finding: dict[str, Any]) -> tuple[float, str]:
    """Return the cost of a finding, in multiples of its limit, as number and as text."""
    check, ratio = finding["check"], finding["ratio"]
    if check == "status":
        return float("inf"), f"the pose of {', '.join(finding['sensors'])}"
    if check == "suspected_error":
        return _rank_suspected_error(run, finding)
    if check == "sensor_moved":
        return _rank_session_move(run, finding)
    if ratio is None:
        return 1.0, DASH
    if check in LOWER_LIMIT_CHECKS:
        percent = format_number(100 * finding["value"] / finding["limit"], 2)
        return ratio, f"{percent} % of the limit"
    return ratio, f"{format_number(ratio, 2)} × the limit"


def _rank_suspected_error(run: ReportRun, finding: dict[str, Any]) -> tuple[float, str]:
    """Return the largest shift of a pose if the suspected error is corrected."""
    shifts = [
        (shift["sigmas"], sensor, shift)
        for error in run.calibration["suspected_errors"]
        if error["description"] in finding["text"]
        for sensor, shift in error["pose_shift"].items()
    ]
    if not shifts:
        return 1.0, DASH
    sigmas, sensor, shift = max(shifts, key=lambda item: item[0])
    mm = format_number(shift["m"] * MM_PER_M, 2)
    deg = format_number(shift["rad"] * DEG_PER_RAD, 2)
    return sigmas / run.verdict["limits"].get(
        "warn_error_moves_pose_sigma", 1.0
    ), f"{mm} mm, {deg}° of {sensor}"


def _rank_session_move(run: ReportRun, finding: dict[str, Any]) -> tuple[float, str]:
    """Return the largest shift of a sensor between sessions, over the limit of the position σ."""
    shifts = [
        r["shift"] for r in run.calibration["repeatability"] if r["sensor"] in finding["sensors"]
    ]
    shift_m = max((float(np.linalg.norm(shift[:3])) for shift in shifts), default=0.0)
    cost = f"{format_number(shift_m * MM_PER_M, 2)} mm between sessions"
    return shift_m / run.verdict["limits"]["warn_sigma_m"], cost


def tabulate_lost_views(
    run: ReportRun, losses_by_session: dict[str, list[dict[str, Any]]]
) -> list[dict[str, str]]:
    """Return {level, text, cost, remedy} of kept views without an inlier, and of unused targets."""
    rows: list[tuple[float, dict[str, str]]] = []
    n_used_views: dict[tuple[str, str], int] = {}
    for session, losses in losses_by_session.items():
        for row in losses:
            key = row["sensor"], row["target"]
            n_used_views[key] = n_used_views.get(key, 0) + row["frame_counts"][-1]
            rows += _summarize_lost_views(session, row)
    for (sensor, target), n in sorted(n_used_views.items()):
        if not n and run.sensors[sensor]["T_robot_sensor"]:
            text = f"{sensor}: no view of {target} was used"
            remedy = (
                f"If {sensor} should use {target}, record placements of it in the view of {sensor}."
            )
            rows.append((0.0, {"text": text, "cost": "one kind of target", "remedy": remedy}))
    rows.sort(key=lambda item: -item[0])
    return [{"level": "note"} | row for _, row in rows]


def _summarize_lost_views(session: str, row: dict[str, Any]) -> list[tuple[float, dict[str, str]]]:
    """Return [(lost share, row)] of one sensor and target, empty if no kept view was lost."""
    n_kept, n_extracted, n_used = row["frame_counts"][2:]
    if n_kept <= n_used:
        return []
    # The first reason of each step is the most frequent one.
    reasons = {step: reason for step, _, reason in reversed(row["losses"])}
    reason = reasons.get("not found" if n_kept > n_extracted else "not used")
    text = f"{row['sensor']}, {row['target']}, {session}: {reason}"
    cost = f"{format_count(n_kept - n_used)} of {format_plural(n_kept, 'kept view')}"
    return [((n_kept - n_used) / n_kept, {"text": text, "cost": cost, "remedy": ""})]
