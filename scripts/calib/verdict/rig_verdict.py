"""Verdict on a solution: pass, warn or fail by the limits, with findings and remedies."""

from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.observability import describe_next_view
from calib.geometry.units import DEG_PER_RAD
from calib.verdict.findings import (
    VERDICT_LEVELS,
    Finding,
    LimitCheck,
    Limits,
    check_limit,
    make_finding,
    worst_level,
)
from calib.verdict.limit_checks import (
    BOARD_TILT,
    CHECKS_BY_IMPORTANCE,
    CONVERGENCE_REMEDY,
    CYLINDER_TILT,
    GUESS_DEVIATION,
    LEAVE_ONE_OUT,
    MISFIT_CHECKS,
    MOCAP_FACTOR,
    NOISE_FACTOR,
    PLACEMENTS,
    POSITION_SIGMA,
    REJECTED_SHARE,
    REJECTION_REMEDY,
    REJECTION_REMEDY_BY_KIND,
    ROTATION_SIGMA,
    SYSTEMATIC_RESIDUALS,
    TAIL_SHARE,
    TIME_OFFSET,
    limit_check_of_kind,
)
from calib.verdict.model_error_findings import (
    repeatability_findings,
    suspected_error_findings,
    target_mount_findings,
)

OUTLINE_VS_SURFACE = "outline_vs_surface"  # name of a correction and of its check


class Verdict(NamedTuple):
    """Level of the rig, findings with the most severe first, and level by sensor."""

    level: str
    findings: list[Finding]
    levels: dict[str, str]


def rig_findings(solution: dict[str, Any], limits: Limits) -> Verdict:
    """Judge the content of solution.json by the limits of the config."""
    sensors = dict(sorted(solution["sensors"].items()))
    found = [f for name, sensor in sensors.items() for f in sensor_findings(name, sensor, limits)]
    for error in solution["suspected_errors"]:
        found += suspected_error_findings(error, solution, limits)
    for name, target in sorted(solution["targets"].items()):
        found += target_mount_findings(name, target, limits)
    found += repeatability_findings(solution["repeatability"], limits)
    found += check_limit(MOCAP_FACTOR, solution["noise"]["mocap_factor"], limits)
    found += _convergence_findings(solution)
    misfits = [f for f in found if f["check"] in MISFIT_CHECKS]
    for name, sensor in sensors.items():
        if sensor["covariance"] is not None:
            has_misfit = any(not f["sensors"] or name in f["sensors"] for f in misfits)
            found += sigma_findings(name, sensor, limits, has_misfit)
    return make_verdict(found, list(sensors))


def make_verdict(findings: list[Finding], sensors: list[str]) -> Verdict:
    """Sort findings by severity and importance, and derive the levels from them."""
    findings = sorted(
        findings,
        key=lambda f: (-VERDICT_LEVELS.index(f["level"]), CHECKS_BY_IMPORTANCE.index(f["check"])),
    )
    levels = {n: worst_level(f["level"] for f in findings if n in f["sensors"]) for n in sensors}
    return Verdict(worst_level(f["level"] for f in findings), findings, levels)


def sensor_findings(name: str, sensor: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on one sensor of solution.json, except on its σ."""
    status = sensor["status"]
    if not status["ok"]:
        text = f"{name}: {status['reason']}"
        return [make_finding("status", [name], "fail", text=text, remedy=status["remedy"])]
    out = _outline_findings(name, sensor)
    out += check_limit(REJECTED_SHARE, sensor["rejected_share"], limits, sensor=name)
    out += view_findings(name, sensor, limits)
    for kind, fit in sorted(sensor["fit_by_kind"].items()):
        if not any(f["check"] == REJECTED_SHARE.key for f in out):
            out += _rejection_findings(name, kind, sensor, limits)
        out += _fit_findings(name, kind, fit, limits)
    if sensor["leave_one_out"]:
        ratio = sensor["leave_one_out"]["error_over_sigma"]
        out += check_limit(LEAVE_ONE_OUT, ratio, limits, sensor=name)
    if sensor["time_offset_s"]:
        out += _time_offset_findings(name, sensor, limits)
    if sensor["guess_deviation_in_sigma"] is not None:
        deviation = sensor["guess_deviation_in_sigma"]
        out += check_limit(GUESS_DEVIATION, deviation, limits, sensor=name)
    return out


def view_findings(name: str, sensor: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on the number of placements and on parallel targets.

    sensor: kind, placements, direction_spread_deg and recording_advice of solution.json, or the
    same as far as they are known before the solve.
    """
    out = check_limit(PLACEMENTS, sensor["placements"], limits, sensor=name)
    return out + _tilt_findings(name, sensor, limits)


def sigma_findings(
    name: str, sensor: dict[str, Any], limits: Limits, has_misfit: bool
) -> list[Finding]:
    """Return the findings on the σ of a sensor pose. has_misfit: model and data disagree."""
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    values = (
        (POSITION_SIGMA, float(sigma[:3].max())),
        (ROTATION_SIGMA, float(sigma[3:].max() * DEG_PER_RAD)),
    )
    out = []
    for check, value in values:
        remedy = "Correct the other findings first: they increase σ, and more views do not help."
        if not has_misfit:
            remedy = _advise_more_views(sensor, check, value, limits)
        out += check_limit(check, value, limits, sensor=name, remedy=remedy)
    return out


def _advise_more_views(
    sensor: dict[str, Any], check: LimitCheck, value: float, limits: Limits
) -> str:
    """Return which views decrease σ, and about how many are needed."""
    n, limit = sensor["placements"], limits[f"warn_{check.key}"]
    needed = int(np.ceil(n * (value / limit) ** 2)) if np.isfinite(value) else 0
    advice = sensor["recording_advice"]
    remedy = f"{advice} The least certain direction is {sensor['least_certain']['direction']}."
    if sensor["next_view"]:
        remedy = describe_next_view(sensor["next_view"])
    if needed > n:
        remedy += f" About {needed} placements like the {n} so far would reach the limit."
    return remedy


def _convergence_findings(solution: dict[str, Any]) -> list[Finding]:
    if solution["ipopt_status"] is None or solution["has_converged"]:
        return []
    text = "the iterations of solving and re-association did not converge"
    return [make_finding("convergence", [], "warn", text=text, remedy=CONVERGENCE_REMEDY)]


def _outline_findings(name: str, sensor: dict[str, Any]) -> list[Finding]:
    """Return the findings on outlines that disagree with the returns of a lidar."""
    return [
        make_finding(
            OUTLINE_VS_SURFACE,
            [name],
            "warn",
            text=f"{c['description']}; the returns are used",
            remedy=c["remedy"],
        )
        for c in sensor["corrections"]
        if c["name"] == OUTLINE_VS_SURFACE
    ]


def _time_offset_findings(name: str, sensor: dict[str, Any], limits: Limits) -> list[Finding]:
    offset_s = sensor["time_offset_s"]["value"]
    change_s = abs(offset_s - sensor["guess"]["time_offset_s"]["value"])
    remedy = (
        f"Set sensors.{name}.time_offset_s: {offset_s:.4f}, so that frames are assigned to the "
        "right placements."
    )
    return check_limit(TIME_OFFSET, change_s, limits, sensor=name, remedy=remedy)


def _rejection_findings(
    name: str, kind: str, sensor: dict[str, Any], limits: Limits
) -> list[Finding]:
    """Return the findings on the rejected share of one kind, with where most of them lie."""
    words = kind.replace("_", " ")
    text = f"{{}} of the {words} measurements are rejected"
    regions = [r for r in sensor["rejected_by_region"] if r["kind"] == kind]
    if regions:
        largest = max(regions, key=lambda r: r["count"])
        text += f", mostly {largest['region']} of {largest['target']}"
    check = LimitCheck(
        REJECTED_SHARE.key,
        text,
        REJECTION_REMEDY_BY_KIND.get(kind, REJECTION_REMEDY),
        unit=REJECTED_SHARE.unit,
        display_factor=REJECTED_SHARE.display_factor,
    )
    share = sensor["fit_by_kind"][kind]["rejected_share"]
    return check_limit(check, share, limits, sensor=name)


def _fit_findings(name: str, kind: str, fit: dict[str, float], limits: Limits) -> list[Finding]:
    """Return the findings on the residuals of one kind of measurement."""
    out = []
    for check, value in (
        (NOISE_FACTOR, fit["noise_factor"]),
        (TAIL_SHARE, fit["tail_share"]),
        (SYSTEMATIC_RESIDUALS, fit["systematic_ratio"]),
    ):
        out += check_limit(limit_check_of_kind(check, kind), value, limits, sensor=name)
    return out


def _tilt_findings(name: str, sensor: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on parallel targets, where they leave a direction undetermined."""
    spread = sensor["direction_spread_deg"]
    if set(spread) == {"axes"}:
        check = CYLINDER_TILT
    elif set(spread) == {"normals"} and sensor["kind"] == "lidar":
        check = BOARD_TILT
    else:
        return []
    (degrees,) = spread.values()
    return check_limit(check, degrees, limits, sensor=name, remedy=sensor["recording_advice"])
