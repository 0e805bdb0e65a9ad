"""Verdict on a solution: pass, warn or fail by the limits, with findings and remedies."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from calib.diagnosis.observability import describe_next_view
from calib.geometry.units import DEG_PER_RAD
from calib.io.config_change import fill_rig
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
    CAUSE_CHECKS,
    CHECKS_BY_IMPORTANCE,
    CONVERGENCE_REMEDY,
    CYLINDER_TILT,
    EFFECT_CHECKS,
    GUESS_DEVIATION,
    LEAVE_ONE_OUT,
    MISFIT_CHECKS,
    PLACEMENTS,
    POSITION_SIGMA,
    REJECTED_SHARE,
    REJECTION_REMEDY,
    REJECTION_REMEDY_BY_KIND,
    ROTATION_SIGMA,
    SYSTEMATIC_CHECKS,
)
from calib.verdict.model_error_findings import (
    clock_step_findings,
    mocap_scale_findings,
    suspected_error_findings,
    target_mount_findings,
    time_offset_findings,
)
from calib.verdict.noise_findings import (
    MOCAP_NOISE,
    find_noises_beyond_limits,
    fit_findings,
    mocap_findings,
    scatter_cause_findings,
)
from calib.verdict.session_findings import repeatability_findings
from calib.verdict.split_half_findings import split_half_findings

OUTLINE_VS_SURFACE = "outline_vs_surface"  # name of a correction and of its check
MIN_USELESS_SIGMA_RATIO = 0.9  # of σ with four more placements at the best place over that now


class Verdict(NamedTuple):
    """Level of the rig, findings with the most severe first, and level by sensor."""

    level: str
    findings: list[Finding]
    levels: dict[str, str]


def rig_findings(
    solution: dict[str, Any], limits: Limits, audits: Mapping[str, dict[str, Any]] | None = None
) -> Verdict:
    """Judge the content of solution.json by the limits of the config.

    audits: log.json by session; their steps of clocks are findings.
    """
    sensors = dict(sorted(solution["sensors"].items()))
    found = [f for name, sensor in sensors.items() for f in sensor_findings(name, sensor, limits)]
    found = [_with_rig_name(finding, solution["rig"]) for finding in found]
    found += clock_step_findings(audits or {})
    found += time_offset_findings(solution, limits)
    found += mocap_scale_findings(solution["mocap_scales"], limits)
    found += _cause_findings(solution, limits, found)
    has_systematic = any(f["check"] in SYSTEMATIC_CHECKS for f in found)
    found += mocap_findings(solution, limits, has_systematic)
    found += split_half_findings(solution["split_halves"], limits)
    found += _convergence_findings(solution)
    misfits = [f for f in found if f["check"] in MISFIT_CHECKS]
    for name, sensor in sensors.items():
        if sensor["covariance"] is not None:
            has_misfit = any(_concerns(f, name) for f in misfits)
            found += sigma_findings(name, sensor, limits, has_misfit)
    return make_verdict(found, list(sensors))


def _with_rig_name(finding: Finding, rig: str) -> Finding:
    """Return a finding whose change names the file of the rig."""
    out = finding.copy()
    out["change"] = out["change"] and fill_rig(out["change"], rig)
    return out


def _cause_findings(
    solution: dict[str, Any], limits: Limits, found: list[Finding]
) -> list[Finding]:
    """Return the findings on errors that explain others. found: those on single sensors."""
    noisy, told, out = find_noises_beyond_limits(solution, limits), [], []
    for error in solution["suspected_errors"]:
        if findings := suspected_error_findings(error, noisy, limits):
            told.append(error)
            out += findings
    for name, target in sorted(solution["targets"].items()):
        out += target_mount_findings(name, target, limits)
    out += repeatability_findings(solution["repeatability"], limits)
    for name, sensor in sorted(solution["sensors"].items()):
        is_misfit = any(f["check"] in MISFIT_CHECKS and _concerns(f, name) for f in found)
        if is_misfit or MOCAP_NOISE in noisy:
            out += scatter_cause_findings(name, sensor, told)
    return out


def _concerns(finding: Finding, sensor: str) -> bool:
    """Return whether a finding is on a sensor or on the whole rig."""
    return not finding["sensors"] or sensor in finding["sensors"]


def make_verdict(findings: list[Finding], sensors: list[str]) -> Verdict:
    """Sort findings by severity, a cause before what it may explain, and derive the levels."""
    findings = sorted(
        findings,
        key=lambda f: (
            -VERDICT_LEVELS.index(_rank_level(f, findings)),
            CHECKS_BY_IMPORTANCE.index(f["check"]),
            -VERDICT_LEVELS.index(f["level"]),
        ),
    )
    levels = {n: worst_level(f["level"] for f in findings if n in f["sensors"]) for n in sensors}
    return Verdict(worst_level(f["level"] for f in findings), findings, levels)


def _rank_level(finding: Finding, findings: list[Finding]) -> str:
    """Return the level of a finding; of a cause, the worst of the effects on its sensors."""
    if finding["check"] not in CAUSE_CHECKS:
        return finding["level"]
    names = finding["sensors"]
    effects = [
        f["level"]
        for f in findings
        if f["check"] in EFFECT_CHECKS
        and (not names or not f["sensors"] or set(names) & set(f["sensors"]))
    ]
    return worst_level([finding["level"], *effects])


def sensor_findings(name: str, sensor: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on one sensor of solution.json, except on its σ."""
    status = sensor["status"]
    if not status["ok"]:
        text = f"{name}: {status['reason']}"
        remedy, change = status["remedy"], status["change"]
        return [make_finding("status", [name], "fail", text=text, remedy=remedy, change=change)]
    out = _outline_findings(name, sensor)
    out += check_limit(REJECTED_SHARE, sensor["rejected_share"], limits, sensor=name)
    out += view_findings(name, sensor, limits)
    for kind, fit in sorted(sensor["fit_by_kind"].items()):
        if not any(f["check"] == REJECTED_SHARE.key for f in out):
            out += _rejection_findings(name, kind, sensor, limits)
        out += fit_findings(name, kind, fit, limits)
    if sensor["leave_one_out"]:
        ratio = sensor["leave_one_out"]["error_over_sigma"]
        out += check_limit(LEAVE_ONE_OUT, ratio, limits, sensor=name)
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
        remedy = _describe_misfit_sigma(sensor)
        if not has_misfit:
            remedy = _advise_more_views(sensor, check, value, limits)
        out += check_limit(check, value, limits, sensor=name, remedy=remedy)
    return out


def _describe_misfit_sigma(sensor: dict[str, Any]) -> str:
    """Say what to do about a σ where model and data disagree, and whether more views would help."""
    text = "Correct the other findings first: they increase σ."
    return f"{text} {_describe_useless_views(sensor)}".rstrip()


def _describe_useless_views(sensor: dict[str, Any]) -> str:
    """Say that more views would not help where even the best ones leave σ as it is; else ""."""
    view = sensor["next_view"]
    if not view or view["sigma_four"] < MIN_USELESS_SIGMA_RATIO * view["sigma"]:
        return ""
    return f"More views would not help. The best: {describe_next_view(view)}"


def _advise_more_views(
    sensor: dict[str, Any], check: LimitCheck, value: float, limits: Limits
) -> str:
    """Return which views decrease σ, and about how many are needed."""
    if useless := _describe_useless_views(sensor):
        return useless
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
