"""Pass, warn or fail, from stated limits, each with a reason in words and numbers, and a remedy."""

import numpy as np

from calib.diagnosis import observability
from calib.verdict import model_error_findings
from calib.verdict.findings import DEG, LEVELS, MM, PERCENT, REMEDY, finding, measured, worst

# Checks in order of importance: what is wrong comes before what it does to the numbers.
CHECKS = (
    "status", "moved", "suspicion", "apart", "alignment", "offset_s", "tilt_deg", "rejected",
    "mocap_factor", "noise_factor", "beyond", "whiteness", "heldout", "sigma_m", "sigma_deg",
    "placements", "correction_sigma", "settled",
)  # fmt: skip
# Those that say that measurements and model disagree: more views of the same would not help.
MISFIT = {
    "suspicion",
    "rejected",
    "mocap_factor",
    "noise_factor",
    "beyond",
    "whiteness",
    "heldout",
    "apart",
}


def of_sensor(name, sensor, limits):
    """Findings on one sensor of solution.json, but for its σ."""
    if not sensor["status"]["ok"]:
        status = sensor["status"]
        return [finding("status", [name], "fail", f"{name}: {status['reason']}", status["remedy"])]
    out = [
        finding("apart", [name], "warn", f"{c['text']}; returns are believed", c["remedy"])
        for c in sensor["corrections"]
        if c["name"] == "apart"
    ]
    out += measured(name, sensor["rejected"], limits, "rejected", "rejected", PERCENT, " %")
    out += of_views(name, sensor, limits)
    for kind, fit in sorted(sensor["fit"].items()):
        if not any(f["check"] == "rejected" for f in out):
            out += _rejected(name, kind, fit["rejected"], sensor["left_out"], limits)
        out += _of_fit(name, kind, fit, limits)
    if sensor["held_out"]:
        words = "placements left out differ from what the others predict by, in their σ,"
        out += measured(name, sensor["held_out"]["ratio"], limits, "heldout", words)
    if sensor["time_offset_s"]:
        off = abs(sensor["time_offset_s"]["value"] - sensor["guess"]["time_offset_s"]["value"])
        words = "its stamps and those of the motion capture differ from the first guess by"
        remedy = (
            f"write sensors.{name}.time_offset_s: {sensor['time_offset_s']['value']:.4f}, so that "
            "frames are taken where they belong"
        )
        out += measured(name, off, limits, "offset_s", words, MM, " ms", remedy=remedy)
    if sensor["correction"] is not None:
        words = "differs from the first guess by, in its σ,"
        out += measured(name, sensor["correction"], limits, "correction_sigma", words)
    return out


def of_views(name, sensor, limits):
    """Findings on how many placements a sensor saw, and on targets that all point the same way.

    sensor: kind, placements, tilt, advice of solution.json, or of what is known before the solve.
    """
    n = sensor["placements"]
    out = measured(name, n, limits, "placements", "placements", large=False)
    return out + _of_tilt(name, sensor, limits)


def _rejected(name, kind, share, left_out, limits):
    """Findings on the share of one kind of measurement that the gate refused, and where it lies."""
    sides = sorted((r for r in left_out if r["kind"] == kind), key=lambda r: -r["count"])
    where = f", mostly {sides[0]['where']} of {sides[0]['target']}," if sides else ""
    words = f"rejected of the {kind} measurements{where}"
    remedy = REMEDY.get(f"rejected {kind}", REMEDY["rejected"])
    return measured(name, share, limits, "rejected", words, PERCENT, " %", remedy=remedy)


def _of_fit(name, kind, fit, limits):
    """Findings on the residuals of one kind of measurement."""
    return [
        *measured(
            name,
            fit["noise_factor"],
            limits,
            "noise_factor",
            f"noise of {kind} measurements over the configured",
        ),
        *measured(
            name, fit["beyond"], limits, "beyond", f"{kind} residuals beyond 3 σ", PERCENT, " %"
        ),
        *measured(
            name,
            fit["whiteness"],
            limits,
            "whiteness",
            f"mean {kind} residuals that repeat in all placements, in their σ,",
        ),
    ]


def _of_tilt(name, sensor, limits):
    """Findings on targets that all point the same way, where that leaves a direction loose."""
    tilt = sensor["tilt"]
    only = set(tilt) == {"axes"} or (set(tilt) == {"normals"} and sensor["kind"] == "lidar")
    if not only:
        return []
    ((what, degrees),) = tilt.items()
    words = {"axes": "axes of the cylinders", "normals": "normals of the boards"}[what]
    words = f"{words} differ by at most"
    remedy = sensor["advice"]
    return measured(name, degrees, limits, "tilt_deg", words, 1, "°", large=False, remedy=remedy)


def of_sigma(name, sensor, limits, misfit):
    """Findings on the σ of one sensor with a pose; misfit: whether model and data disagree."""
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    values = {"sigma_m": sigma[:3].max(), "sigma_deg": sigma[3:].max() * DEG}
    told = {"sigma_m": ("position σ", MM, " mm"), "sigma_deg": ("rotation σ", 1.0, "°")}
    out = []
    for check, value in values.items():
        words, scale, unit = told[check]
        remedy = "mend what else is wrong first: it widens σ, and more views would not help"
        if not misfit:
            remedy = _more_views(sensor, check, value, limits)
        out += measured(name, float(value), limits, check, words, scale, unit, remedy=remedy)
    return out


def _more_views(sensor, check, value, limits):
    """Which views would narrow σ, and about how many."""
    n, limit = sensor["placements"], limits[f"warn_{check}"]
    needed = int(np.ceil(n * (value / limit) ** 2)) if np.isfinite(value) else None
    remedy = f"least certain: {sensor['weakest']['direction']}. {sensor['advice']}"
    if sensor["next_view"]:
        remedy = observability.next_view(sensor["next_view"])
    if needed and needed > n:
        remedy += f" About {needed} placements like the {n} so far would reach the limit."
    return remedy


def of_rig(solution, limits):
    """(level, findings in order of importance, level per sensor) of a solution.json."""
    sensors = sorted(solution["sensors"].items())
    found = [f for name, sensor in sensors for f in of_sensor(name, sensor, limits)]
    found += [
        f
        for s in solution["suspicions"]
        for f in model_error_findings.of_suspicion(s, solution, limits)
    ]
    found += [
        f
        for n, t in sorted(solution["targets"].items())
        for f in model_error_findings.of_target(n, t, limits)
    ]
    found += model_error_findings.of_sessions(solution["repeatability"], limits)
    words = "errors of the motion capture's poses over the stated σ"
    found += measured("", solution["noise"]["mocap_factor"], limits, "mocap_factor", words)
    if solution["ipopt"] is not None and not solution["settled"]:
        text = "the rounds of solving and re-association did not settle"
        found.append(finding("settled", [], "warn", text, REMEDY["settled"]))
    rig_wide = any(f["check"] in MISFIT and not f["sensors"] for f in found)
    for name, sensor in sensors:
        if sensor["covariance"] is not None:
            misfit = rig_wide or any(f["check"] in MISFIT and name in f["sensors"] for f in found)
            found += of_sigma(name, sensor, limits, misfit)
    found.sort(key=lambda f: (-LEVELS.index(f["level"]), CHECKS.index(f["check"])))
    levels = {name: worst(f["level"] for f in found if name in f["sensors"]) for name, _ in sensors}
    return worst(f["level"] for f in found), found, levels
