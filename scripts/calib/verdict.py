"""Pass, warn or fail, from stated limits, each with a reason in words and numbers, and a remedy."""

import numpy as np

from calib import observability

LEVELS = ("pass", "warn", "fail")
MM, PERCENT, DEG = 1e3, 100.0, np.degrees(1.0)
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
REMEDY = {
    "rejected": "see what was left out and where (Residuals): a stand, a hand, a wrong size or "
    "mount of a target, or wrong lens parameters",
    "rejected edge": "measure outline_m, and see where the crossings lie (Residuals)",
    "rejected corner": "measure square_m and T_body_target; if they are right, the lens parameters "
    "or single views are wrong (Residuals, Extraction)",
    "mocap_factor": "state mocap.pose_sigma and pose_bias_sigma as they are; if they are, look for "
    "a wrong size or T_body_target of a target, wrong lens parameters, or a clock that is off",
    "noise_factor": "see Residuals for what the noise stands for; state the "
    "sensor's own noise if it is what it is",
    "beyond": "see the overlays of the worst views for what does not belong to the target",
    "whiteness": "see the residuals by ring or over the image: an error of single beams, of the "
    "lens or of the printed pattern repeats itself",
    "heldout": "see the most influential placements (Cross-validation): one may not have been "
    "still, or something that nobody estimates is wrong",
    "placements": "hold targets still in more places that it sees; the report says where frames "
    "were lost",
    "correction_sigma": "check the first guess and its sigma; if both are sure, the result is not",
    "settled": "see the rounds in the Appendix, and mend what else is wrong first",
}


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


def finding(check, sensors, found, text, remedy, value=None, limit=None):
    """One entry of the verdict; sensors: names of those whose level it concerns."""
    return {
        "check": check,
        "sensor": sensors[0] if len(sensors) == 1 else None,
        "sensors": sensors,
        "level": found,
        "value": value,
        "limit": limit,
        "text": text,
        "remedy": remedy,
    }


def _measured(name, value, limits, check, words, scale=1.0, unit="", large=True, remedy=None):
    """[finding] of a value that is beyond its limits, else []."""
    found = level(value, limits, check, large)
    if found == "pass":
        return []
    limit = limits[f"{found}_{check}"]
    side = "above" if large else "below"
    shown, most = (f"{v * scale:.3g}{unit}" for v in (value, limit))
    text = f"{words} {shown}, {found} {side} {most}"
    text = f"{name}: {text}" if name else text
    remedy = REMEDY[check] if remedy is None else remedy
    return [finding(check, [name] if name else [], found, text, remedy, value, limit)]


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
    out += _measured(name, sensor["rejected"], limits, "rejected", "rejected", PERCENT, " %")
    out += _measured(name, sensor["placements"], limits, "placements", "placements", large=False)
    for kind, fit in sorted(sensor["fit"].items()):
        if not any(f["check"] == "rejected" for f in out):
            out += _rejected(name, kind, fit["rejected"], sensor["left_out"], limits)
        out += _of_fit(name, kind, fit, limits)
    out += _of_tilt(name, sensor, limits)
    if sensor["held_out"]:
        words = "placements left out differ from what the others predict by, in their σ,"
        out += _measured(name, sensor["held_out"]["ratio"], limits, "heldout", words)
    if sensor["time_offset_s"]:
        off = abs(sensor["time_offset_s"]["value"] - sensor["guess"]["time_offset_s"]["value"])
        words = "its stamps and those of the motion capture differ from the first guess by"
        remedy = (
            f"write sensors.{name}.time_offset_s: {sensor['time_offset_s']['value']:.4f}, so that "
            "frames are taken where they belong"
        )
        out += _measured(name, off, limits, "offset_s", words, MM, " ms", remedy=remedy)
    if sensor["correction"] is not None:
        words = "differs from the first guess by, in its σ,"
        out += _measured(name, sensor["correction"], limits, "correction_sigma", words)
    return out


def _rejected(name, kind, share, left_out, limits):
    """Findings on the share of one kind of measurement that the gate refused, and where it lies."""
    sides = sorted((r for r in left_out if r["kind"] == kind), key=lambda r: -r["count"])
    where = f", mostly {sides[0]['where']} of {sides[0]['target']}," if sides else ""
    words = f"rejected of the {kind} measurements{where}"
    remedy = REMEDY.get(f"rejected {kind}", REMEDY["rejected"])
    return _measured(name, share, limits, "rejected", words, PERCENT, " %", remedy=remedy)


def _of_fit(name, kind, fit, limits):
    """Findings on the residuals of one kind of measurement."""
    return [
        *_measured(
            name,
            fit["noise_factor"],
            limits,
            "noise_factor",
            f"noise of {kind} measurements over the configured",
        ),
        *_measured(
            name, fit["beyond"], limits, "beyond", f"{kind} residuals beyond 3 σ", PERCENT, " %"
        ),
        *_measured(
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
    return _measured(name, degrees, limits, "tilt_deg", words, 1, "°", large=False, remedy=remedy)


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
        out += _measured(name, float(value), limits, check, words, scale, unit, remedy=remedy)
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


def of_suspicion(suspected, solution, limits):
    """Findings on one suspicion of solution.json: one that is sure, and that matters."""
    if suspected["chance"] > limits["warn_suspicion_chance"]:
        return []
    shift = suspected["shift"]
    moved = {
        n: s
        for n, s in shift.items()
        if s["sigmas"] > limits["warn_shift_sigma"] and s["m"] > limits["warn_shift_m"]
    }
    widened = _widened(suspected, solution, limits)
    if not moved and not widened:
        return []
    grave = [
        n
        for n, s in moved.items()
        if s["m"] > limits["fail_sigma_m"] or s["rad"] * DEG > limits["fail_sigma_deg"]
    ]
    effect = [
        f"would move {n} by {s['m'] * MM:.2g} mm and {s['rad'] * DEG:.2g}°"
        for n, s in sorted(moved.items())
    ]
    effect += [f"would explain {v * PERCENT:.0f} % of {_words(k)}" for k, v in widened.items()]
    rivals = "".join(f"; or {r['text']}" for r in suspected["rivals"])
    text = f"probably {suspected['text']}: mending it {' and '.join(effect)}{rivals}"
    remedy = "; ".join(
        dict.fromkeys([suspected["remedy"], *(r["remedy"] for r in suspected["rivals"])])
    )
    sensors = sorted(grave or (set(moved) | {w.split("/")[0] for w in widened if "/" in w}))
    return [finding("suspicion", sensors, "fail" if grave else "warn", text, remedy)]


def _words(noise):
    """`the edge residuals of lidar` for `lidar/edge`."""
    sensor, _, kind = noise.partition("/")
    return f"the {kind} residuals of {sensor}" if kind else "the errors of the MCS poses"


def _widened(suspected, solution, limits):
    """{noise: share} of the noises that are far above the configured and that it explains."""
    factors = {"mocap": solution["noise"]["mocap_factor"]}
    for name, sensor in solution["sensors"].items():
        factors |= {f"{name}/{kind}": f["noise_factor"] for kind, f in sensor["fit"].items()}
    return {
        key: share
        for key, share in sorted(suspected["explained"].items())
        if share > limits["warn_explained"] and factors.get(key, 0.0) > limits["warn_widened"]
    }


def of_target(name, target, limits):
    """Findings on a target whose place in its body was estimated, and had been stated."""
    if target is None or target["prior"] is None:
        return []
    shift, prior = np.array(target["shift"]), np.array(target["prior"])
    value = float((np.abs(shift) / prior).max())
    found = level(value, limits, "correction_sigma")
    if found == "pass":
        return _held(name, target["open"])
    limit = limits[f"{found}_correction_sigma"]
    mm, deg = np.linalg.norm(shift.reshape(2, 3), axis=1) * [MM, DEG]
    text = (
        f"{name} sits {mm:.2g} mm and {deg:.2g}° from where T_body_target says, {value:.3g} of its "
        f"alignment_sigma, {found} above {limit:.3g}; the estimate counts"
    )
    remedy = f"write T_body_target of {name} as estimated, or see what else is wrong if it is sure"
    return [finding("alignment", [], found, text, remedy, value, limit)]


def _held(name, directions):
    """The finding on what nothing tells of a target's place in its body, if there is any."""
    if not directions:
        return []
    text = (
        f"nothing tells where {name} sits in its body by {', '.join(directions)}: its "
        "alignment_sigma stands in the σ of the sensors, as all placements turn alike"
    )
    remedy = f"tilt {name} by 30° or more about two other axes in some placements, and record again"
    return [finding("alignment", [], "warn", text, remedy, None, None)]


def of_sessions(rows, limits):
    """Findings on sensors whose pose is another in one session than in the others."""
    worst_of = {}
    for row in sorted(rows, key=lambda r: r["chance"]):
        worst_of.setdefault(row["sensor"], row)
    out = []
    for name, row in sorted(worst_of.items()):
        m, rad = np.linalg.norm(np.reshape(row["shift"], (2, 3)), axis=1)
        if row["chance"] > limits["warn_suspicion_chance"] or m < limits["warn_shift_m"]:
            continue
        grave = m > limits["fail_sigma_m"] or rad * DEG > limits["fail_sigma_deg"]
        text = (
            f"{name} sits {m * MM:.2g} mm and {rad * DEG:.2g}° elsewhere in session "
            f"{row['session']} than in the others"
        )
        remedy = (
            f"see whether {name} was moved or bumped before or after {row['session']} and "
            "calibrate what comes after by itself; if all sensors moved alike, the robot's markers "
            f"did: write sessions.{row['session']}.remounted: true"
        )
        out.append(finding("moved", [name], "fail" if grave else "warn", text, remedy))
    return out


def of_rig(solution, limits):
    """(level, findings in order of importance, level per sensor) of a solution.json."""
    sensors = sorted(solution["sensors"].items())
    found = [f for name, sensor in sensors for f in of_sensor(name, sensor, limits)]
    found += [f for s in solution["suspicions"] for f in of_suspicion(s, solution, limits)]
    found += [f for n, t in sorted(solution["targets"].items()) for f in of_target(n, t, limits)]
    found += of_sessions(solution["repeatability"], limits)
    words = "errors of the motion capture's poses over the stated σ"
    found += _measured("", solution["noise"]["mocap_factor"], limits, "mocap_factor", words)
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
