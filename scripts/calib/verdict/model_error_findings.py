"""Findings on what is wrong about a recording or its config: suspicions, targets, sessions."""

import numpy as np

from calib.estimation.corrections.clock_offset import TIME_OFFSET
from calib.geometry.units import DEG_PER_RAD, MM_PER_M, SHARE_TO_PERCENT
from calib.verdict.findings import level_by_limits, make_finding


def suspected_error_findings(error, solution, limits):
    """Findings on one suspicion of solution.json: one that is sure, and that matters."""
    if error["p_value"] > limits["warn_error_p_value"]:
        return []
    if error["name"] == TIME_OFFSET:
        return _clock_error_findings(error, limits)
    shift = error["pose_shift"]
    moved = {
        n: s
        for n, s in shift.items()
        if s["sigmas"] > limits["warn_error_moves_pose_sigma"]
        and s["m"] > limits["warn_error_moves_pose_m"]
    }
    widened = _explained_noise(error, solution, limits)
    if not moved and not widened:
        return []
    grave = [
        n
        for n, s in moved.items()
        if s["m"] > limits["fail_sigma_m"] or s["rad"] * DEG_PER_RAD > limits["fail_sigma_deg"]
    ]
    effect = [
        f"would move {n} by {s['m'] * MM_PER_M:.2g} mm and {s['rad'] * DEG_PER_RAD:.2g}°"
        for n, s in sorted(moved.items())
    ]
    effect += [
        f"would explain {v * SHARE_TO_PERCENT:.0f} % of {_describe_noise_name(k)}"
        for k, v in widened.items()
    ]
    rivals = "".join(f"; or {r['description']}" for r in error["alternatives"])
    text = f"probably {error['description']}: mending it {' and '.join(effect)}{rivals}"
    remedy = "; ".join(
        dict.fromkeys([error["remedy"], *(r["remedy"] for r in error["alternatives"])])
    )
    sensors = sorted(grave or (set(moved) | {w.split("/")[0] for w in widened if "/" in w}))
    return [make_finding("suspected_error", sensors, "fail" if grave else "warn", text, remedy)]


def _clock_error_findings(suspected, limits):
    """The finding on a clock that is off and not to be estimated, if by much."""
    (late,), name = suspected["estimate"], suspected["subject"]
    if abs(late) < limits["warn_fixed_time_offset_s"]:
        return []
    text = (
        f"{suspected['description']}, and solve.estimate.time_offset is false: poses from still "
        "placements hardly feel it, whoever uses scans or images in motion does"
    )
    limit = limits["warn_fixed_time_offset_s"]
    return [
        make_finding("time_offset_s", [name], "warn", text, suspected["remedy"], abs(late), limit)
    ]


def _describe_noise_name(noise):
    """`the edge residuals of lidar` for `lidar/edge`."""
    sensor, _, kind = noise.partition("/")
    return f"the {kind} residuals of {sensor}" if kind else "the errors of the MCS poses"


def _explained_noise(suspected, solution, limits):
    """{noise: share} of the noises that are far above the configured and that it explains."""
    factors = {"mocap_noise": solution["noise"]["mocap_factor"]}
    for name, sensor in solution["sensors"].items():
        factors |= {
            f"{name}/{kind}": f["noise_factor"] for kind, f in sensor["fit_by_kind"].items()
        }
    return {
        key: share
        for key, share in sorted(suspected["explained_share"].items())
        if share > limits["warn_error_explains"]
        and factors.get(key, 0.0) > limits["warn_noise_factor_explained"]
    }


def target_mount_findings(name, target, limits):
    """Findings on a target whose place in its body was estimated, and had been stated."""
    if target is None or target["prior_sigma"] is None:
        return []
    shift, prior = np.array(target["shift"]), np.array(target["prior_sigma"])
    value = float((np.abs(shift) / prior).max())
    found = level_by_limits(value, limits, "guess_deviation_sigma")
    if found == "pass":
        return undetermined_mount_findings(name, target["undetermined"])
    limit = limits[f"{found}_guess_deviation_sigma"]
    mm, deg = np.linalg.norm(shift.reshape(2, 3), axis=1) * [MM_PER_M, DEG_PER_RAD]
    text = (
        f"{name} sits {mm:.2g} mm and {deg:.2g}° from where T_body_target says, {value:.3g} of its "
        f"alignment_sigma, {found} above {limit:.3g}; the estimate counts"
    )
    remedy = f"write T_body_target of {name} as estimated, or see what else is wrong if it is sure"
    return [make_finding("target_mount", [], found, text, remedy, value, limit)]


def undetermined_mount_findings(name, directions):
    """The finding on what nothing tells of a target's place in its body, if there is any."""
    if not directions:
        return []
    text = (
        f"nothing tells where {name} sits in its body by {', '.join(directions)}: its "
        "alignment_sigma stands in the σ of the sensors, as all placements turn alike"
    )
    remedy = f"tilt {name} by 30° or more about two other axes in some placements, and record again"
    return [make_finding("target_mount", [], "warn", text, remedy, None, None)]


def repeatability_findings(rows, limits):
    """Findings on sensors whose pose is another in one session than in the others."""
    worst_of = {}
    for row in sorted(rows, key=lambda r: r["p_value"]):
        worst_of.setdefault(row["sensor"], row)
    out = []
    for name, row in sorted(worst_of.items()):
        m, rad = np.linalg.norm(np.reshape(row["shift"], (2, 3)), axis=1)
        if row["p_value"] > limits["warn_error_p_value"] or m < limits["warn_error_moves_pose_m"]:
            continue
        grave = m > limits["fail_sigma_m"] or rad * DEG_PER_RAD > limits["fail_sigma_deg"]
        text = (
            f"{name} sits {m * MM_PER_M:.2g} mm and {rad * DEG_PER_RAD:.2g}° elsewhere in session "
            f"{row['session']} than in the others"
        )
        remedy = (
            f"see whether {name} was moved or bumped before or after {row['session']} and "
            "calibrate what comes after by itself; if all sensors moved alike, the robot's markers "
            f"did: write sessions.{row['session']}.remounted: true"
        )
        out.append(make_finding("sensor_moved", [name], "fail" if grave else "warn", text, remedy))
    return out
