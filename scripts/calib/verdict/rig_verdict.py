"""Pass, warn or fail, from stated limits, each with a reason in words and numbers, and a remedy."""

import numpy as np

from calib.diagnosis.observability import describe_next_view
from calib.geometry.units import DEG_PER_RAD, MM_PER_M, MS_PER_S, SHARE_TO_PERCENT
from calib.verdict.findings import (
    REMEDY_BY_CHECK,
    VERDICT_LEVELS,
    check_limit,
    make_finding,
    worst_level,
)
from calib.verdict.model_error_findings import (
    repeatability_findings,
    suspected_error_findings,
    target_mount_findings,
)

# Checks in order of importance: what is wrong comes before what it does to the numbers.
CHECKS_BY_IMPORTANCE = (
    "status", "sensor_moved", "suspected_error", "outline_vs_surface", "target_mount", "time_offset_s", "tilt_deg", "rejected",
    "mocap_factor", "noise_factor", "tail_share", "systematic", "leave_one_out", "sigma_m", "sigma_deg",
    "placements", "guess_deviation_sigma", "convergence",
)  # fmt: skip
# Those that say that measurements and model disagree: more views of the same would not help.
MISFIT_CHECKS = {
    "suspected_error",
    "rejected",
    "mocap_factor",
    "noise_factor",
    "tail_share",
    "systematic",
    "leave_one_out",
    "outline_vs_surface",
}


def sensor_findings(name, sensor, limits):
    """Findings on one sensor of solution.json, but for its σ."""
    if not sensor["status"]["ok"]:
        status = sensor["status"]
        return [
            make_finding("status", [name], "fail", f"{name}: {status['reason']}", status["remedy"])
        ]
    out = [
        make_finding(
            "outline_vs_surface",
            [name],
            "warn",
            f"{c['description']}; returns are believed",
            c["remedy"],
        )
        for c in sensor["corrections"]
        if c["name"] == "outline_vs_surface"
    ]
    out += check_limit(
        name, sensor["rejected_share"], limits, "rejected", "rejected", SHARE_TO_PERCENT, " %"
    )
    out += view_findings(name, sensor, limits)
    for kind, fit in sorted(sensor["fit_by_kind"].items()):
        if not any(f["check"] == "rejected" for f in out):
            out += _rejection_findings(
                name, kind, fit["rejected_share"], sensor["rejected_by_region"], limits
            )
        out += _fit_findings(name, kind, fit, limits)
    if sensor["leave_one_out"]:
        words = "placements left out differ from what the others predict by, in their σ,"
        out += check_limit(
            name, sensor["leave_one_out"]["error_over_sigma"], limits, "leave_one_out", words
        )
    if sensor["time_offset_s"]:
        off = abs(sensor["time_offset_s"]["value"] - sensor["guess"]["time_offset_s"]["value"])
        words = "its stamps and those of the motion capture differ from the first guess by"
        remedy = (
            f"write sensors.{name}.time_offset_s: {sensor['time_offset_s']['value']:.4f}, so that "
            "frames are taken where they belong"
        )
        out += check_limit(
            name, off, limits, "time_offset_s", words, MS_PER_S, " ms", remedy=remedy
        )
    if sensor["guess_deviation_in_sigma"] is not None:
        words = "differs from the first guess by, in its σ,"
        out += check_limit(
            name, sensor["guess_deviation_in_sigma"], limits, "guess_deviation_sigma", words
        )
    return out


def view_findings(name, sensor, limits):
    """Findings on how many placements a sensor saw, and on targets that all point the same way.

    sensor: kind, placements, tilt, advice of solution.json, or of what is known before the solve.
    """
    n = sensor["placements"]
    out = check_limit(name, n, limits, "placements", "placements", is_large_bad=False)
    return out + _tilt_findings(name, sensor, limits)


def _rejection_findings(name, kind, share, left_out, limits):
    """Findings on the share of one kind of measurement that the gate refused, and where it lies."""
    sides = sorted((r for r in left_out if r["kind"] == kind), key=lambda r: -r["count"])
    where = f", mostly {sides[0]['region']} of {sides[0]['target']}," if sides else ""
    words = f"rejected of the {kind} measurements{where}"
    remedy = REMEDY_BY_CHECK.get(f"rejected {kind}", REMEDY_BY_CHECK["rejected"])
    return check_limit(
        name, share, limits, "rejected", words, SHARE_TO_PERCENT, " %", remedy=remedy
    )


def _fit_findings(name, kind, fit, limits):
    """Findings on the residuals of one kind of measurement."""
    return [
        *check_limit(
            name,
            fit["noise_factor"],
            limits,
            "noise_factor",
            f"noise of {kind} measurements over the configured",
        ),
        *check_limit(
            name,
            fit["tail_share"],
            limits,
            "tail_share",
            f"{kind} residuals beyond 3 σ",
            SHARE_TO_PERCENT,
            " %",
        ),
        *check_limit(
            name,
            fit["systematic_ratio"],
            limits,
            "systematic",
            f"mean {kind} residuals that repeat in all placements, in their σ,",
        ),
    ]


def _tilt_findings(name, sensor, limits):
    """Findings on targets that all point the same way, where that leaves a direction loose."""
    tilt = sensor["direction_spread_deg"]
    only = set(tilt) == {"axes"} or (set(tilt) == {"normals"} and sensor["kind"] == "lidar")
    if not only:
        return []
    ((what, degrees),) = tilt.items()
    words = {"axes": "axes of the cylinders", "normals": "normals of the boards"}[what]
    words = f"{words} differ by at most"
    remedy = sensor["recording_advice"]
    return check_limit(
        name, degrees, limits, "tilt_deg", words, 1, "°", is_large_bad=False, remedy=remedy
    )


def sigma_findings(name, sensor, limits, has_misfit):
    """Findings on the σ of one sensor with a pose; has_misfit: whether model and data disagree."""
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    values = {"sigma_m": sigma[:3].max(), "sigma_deg": sigma[3:].max() * DEG_PER_RAD}
    told = {"sigma_m": ("position σ", MM_PER_M, " mm"), "sigma_deg": ("rotation σ", 1.0, "°")}
    out = []
    for check, value in values.items():
        words, scale, unit = told[check]
        remedy = "mend what else is wrong first: it widens σ, and more views would not help"
        if not has_misfit:
            remedy = _advise_more_views(sensor, check, value, limits)
        out += check_limit(name, float(value), limits, check, words, scale, unit, remedy=remedy)
    return out


def _advise_more_views(sensor, check, value, limits):
    """Which views would narrow σ, and about how many."""
    n, limit = sensor["placements"], limits[f"warn_{check}"]
    needed = int(np.ceil(n * (value / limit) ** 2)) if np.isfinite(value) else None
    remedy = f"least certain: {sensor['least_certain']['direction']}. {sensor['recording_advice']}"
    if sensor["next_view"]:
        remedy = describe_next_view(sensor["next_view"])
    if needed and needed > n:
        remedy += f" About {needed} placements like the {n} so far would reach the limit."
    return remedy


def rig_findings(solution, limits):
    """(level, findings in order of importance, level per sensor) of a solution.json."""
    sensors = sorted(solution["sensors"].items())
    found = [f for name, sensor in sensors for f in sensor_findings(name, sensor, limits)]
    found += [
        f
        for s in solution["suspected_errors"]
        for f in suspected_error_findings(s, solution, limits)
    ]
    found += [
        f
        for n, t in sorted(solution["targets"].items())
        for f in target_mount_findings(n, t, limits)
    ]
    found += repeatability_findings(solution["repeatability"], limits)
    words = "errors of the motion capture's poses over the stated σ"
    found += check_limit("", solution["noise"]["mocap_factor"], limits, "mocap_factor", words)
    if solution["ipopt_status"] is not None and not solution["has_converged"]:
        text = "the rounds of solving and re-association did not settle"
        found.append(make_finding("convergence", [], "warn", text, REMEDY_BY_CHECK["convergence"]))
    rig_wide = any(f["check"] in MISFIT_CHECKS and not f["sensors"] for f in found)
    for name, sensor in sensors:
        if sensor["covariance"] is not None:
            misfit = rig_wide or any(
                f["check"] in MISFIT_CHECKS and name in f["sensors"] for f in found
            )
            found += sigma_findings(name, sensor, limits, misfit)
    found.sort(
        key=lambda f: (-VERDICT_LEVELS.index(f["level"]), CHECKS_BY_IMPORTANCE.index(f["check"]))
    )
    levels = {
        name: worst_level(f["level"] for f in found if name in f["sensors"]) for name, _ in sensors
    }
    return worst_level(f["level"] for f in found), found, levels
