"""Pass, warn or fail, from stated limits, each with a reason in words and numbers."""

import numpy as np

LEVELS = ("pass", "warn", "fail")


def worst(levels):
    """The gravest of some levels; pass of none."""
    return max(levels, key=LEVELS.index, default="pass")


def level(value, limits, key, large_is_bad=True):
    """What a value is by the limits warn_<key> and fail_<key>; one that is no number fails."""
    for grave in ("fail", "warn"):
        limit = limits[f"{grave}_{key}"]
        if not (value <= limit if large_is_bad else value >= limit):
            return grave
    return "pass"


def _above(value, limits, what, unit, key, scale=1.0):
    """(level, reason) of a value that must not exceed its limits."""
    found = level(value, limits, key)
    if found == "pass":
        return found, ""
    limit = limits[f"{found}_{key}"] * scale
    return found, f"{what} {value * scale:.3g} {unit}, {found} above {limit:.3g} {unit}"


def _below(value, limits, what, key):
    """(level, reason) of a value that must reach its limits."""
    found = level(value, limits, key, large_is_bad=False)
    if found == "pass":
        return found, ""
    return found, f"{what} {value}, {found} below {limits[f'{found}_{key}']}"


def of_sensor(name, sensor, limits):
    """(level, reasons) of one sensor of solution.json."""
    if not sensor["status"]["ok"]:
        status = sensor["status"]
        text = status["reason"] + (f"; {status['remedy']}" if status["remedy"] else "")
        return "fail", [f"{name}: {text}"]
    sigma = np.sqrt(np.diag(sensor["covariance"]))
    checks = (
        _above(sigma[:3].max(), limits, "position σ", "mm", "sigma_m", 1e3),
        _above(np.degrees(sigma[3:].max()), limits, "rotation σ", "deg", "sigma_deg"),
        _above(sensor["rejected"], limits, "rejected", "%", "rejected", 100),
        _below(sensor["placements"], limits, "placements", "placements"),
    )
    reasons = [f"{name}: {text}" for found, text in checks if found != "pass"]
    weak = sensor["weakest"]
    if any("σ" in r for r in reasons):
        reasons.append(f"{name}: least certain {weak['direction']}; add views that differ there")
    return worst([found for found, _ in checks]), reasons


def of_rig(solution, limits):
    """(level, reasons, level per sensor) of a solution.json."""
    levels, reasons = {}, []
    for name, sensor in sorted(solution["sensors"].items()):
        levels[name], why = of_sensor(name, sensor, limits)
        reasons += why
    overall = worst(levels.values())
    if solution["ipopt"] is not None and not solution["settled"]:
        overall = worst([overall, "warn"])
        reasons.append("the rounds of solving and re-association did not settle; see iterations")
    return overall, reasons, levels
