"""Findings on errors of a recording or its config: suspected errors, target mounts, sessions."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.estimation.corrections.clock_offset import TIME_OFFSET
from calib.geometry.units import DEG_PER_RAD, MM_PER_M, MS_PER_S, SHARE_TO_PERCENT
from calib.verdict.findings import Finding, Limits, level_by_limits, make_finding, with_limit


def suspected_error_findings(
    error: dict[str, Any], solution: dict[str, Any], limits: Limits
) -> list[Finding]:
    """Return [finding] on a suspected error of solution.json that is significant and matters."""
    if error["p_value"] > limits["warn_error_p_value"]:
        return []
    if error["name"] == TIME_OFFSET:
        return _fixed_time_offset_findings(error, limits)
    moved = {
        name: shift
        for name, shift in sorted(error["pose_shift"].items())
        if shift["sigmas"] > limits["warn_error_moves_pose_sigma"]
        and shift["m"] > limits["warn_error_moves_pose_m"]
    }
    explained = _explained_noise(error, solution, limits)
    if not moved and not explained:
        return []
    failed = [
        n for n, shift in moved.items() if _is_failing_shift(shift["m"], shift["rad"], limits)
    ]
    noisy = {noise.split("/")[0] for noise in explained if "/" in noise}
    return [
        make_finding(
            "suspected_error",
            sorted(failed or set(moved) | noisy),
            "fail" if failed else "warn",
            text=_describe_suspected_error(error, moved, explained),
            remedy="; ".join(
                dict.fromkeys([error["remedy"], *(e["remedy"] for e in error["alternatives"])])
            ),
        )
    ]


def _is_failing_shift(m: float, rad: float, limits: Limits) -> bool:
    return m > limits["fail_sigma_m"] or rad * DEG_PER_RAD > limits["fail_sigma_deg"]


def _describe_suspected_error(
    error: dict[str, Any], moved: dict[str, Any], explained: dict[str, float]
) -> str:
    effects = [
        f"moves {name} by {_format_shift(shift['m'], shift['rad'])}"
        for name, shift in moved.items()
    ]
    effects += [
        f"explains {share * SHARE_TO_PERCENT:.0f} % of {_describe_noise(noise)}"
        for noise, share in explained.items()
    ]
    text = f"likely error: {error['description']}; correcting it {' and '.join(effects)}"
    return text + "".join(f"; or {other['description']}" for other in error["alternatives"])


def _format_shift(m: float, rad: float) -> str:
    return f"{m * MM_PER_M:.2g} mm and {rad * DEG_PER_RAD:.2g}°"


def _describe_noise(noise: str) -> str:
    """Return `the board outline residuals of lidar` for `lidar/board_outline`."""
    sensor, _, kind = noise.partition("/")
    if not kind:
        return "the errors of the MCS poses"
    return f"the {kind.replace('_', ' ')} residuals of {sensor}"


def _explained_noise(
    error: dict[str, Any], solution: dict[str, Any], limits: Limits
) -> dict[str, float]:
    """Return {noise: share} of the noises far above the configured that the error explains."""
    factors = {"mocap_noise": solution["noise"]["mocap_factor"]}
    for name, sensor in solution["sensors"].items():
        factors |= {f"{name}/{k}": fit["noise_factor"] for k, fit in sensor["fit_by_kind"].items()}
    return {
        noise: share
        for noise, share in sorted(error["explained_share"].items())
        if share > limits["warn_error_explains"]
        and factors.get(noise, 0.0) > limits["warn_noise_factor_explained"]
    }


def _fixed_time_offset_findings(error: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return [finding] on a time offset that is wrong by much and is not estimated."""
    (offset_s,) = error["estimate"]
    limit_s = limits["warn_fixed_time_offset_s"]
    if abs(offset_s) < limit_s:
        return []
    text = (
        f"{error['description']}, and solve.estimate.time_offset is false: poses from still "
        "placements are hardly affected, but scans and images in motion are, "
        f"warn above {limit_s * MS_PER_S:.3g} ms"
    )
    finding = make_finding(
        "time_offset_s", [error["subject"]], "warn", text=text, remedy=error["remedy"]
    )
    return [with_limit(finding, abs(offset_s), limit_s)]


def target_mount_findings(
    name: str, target: dict[str, Any] | None, limits: Limits
) -> list[Finding]:
    """Return the findings on a configured T_body_target that was estimated."""
    if target is None or target["prior_sigma"] is None:
        return []
    shift, prior = np.array(target["shift"]), np.array(target["prior_sigma"])
    value = float((np.abs(shift) / prior).max())
    level = level_by_limits(value, limits, "guess_deviation_sigma")
    if level == "pass":
        return undetermined_mount_findings(name, target["undetermined"])
    limit = limits[f"{level}_guess_deviation_sigma"]
    m, rad = np.linalg.norm(shift.reshape(2, 3), axis=1)
    text = (
        f"T_body_target of {name} differs from the config by {_format_shift(m, rad)}, which is "
        f"{value:.3g} times its alignment_sigma, {level} above {limit:.3g}; the estimate is used"
    )
    remedy = (
        f"Set T_body_target of {name} to the estimate. If the configured value is certain, check "
        "the other findings."
    )
    return [
        with_limit(make_finding("target_mount", [], level, text=text, remedy=remedy), value, limit)
    ]


def undetermined_mount_findings(name: str, directions: Sequence[str]) -> list[Finding]:
    """Return [finding] on directions of T_body_target that the data do not determine, if any."""
    if not directions:
        return []
    text = (
        f"T_body_target of {name} is undetermined in {', '.join(directions)}, as all placements "
        "rotate about the same axis; its alignment_sigma is included in the σ of the sensors"
    )
    remedy = (
        f"Tilt {name} by 30° or more about two other axes in some placements, and record again."
    )
    return [make_finding("target_mount", [], "warn", text=text, remedy=remedy)]


def repeatability_findings(rows: list[dict[str, Any]], limits: Limits) -> list[Finding]:
    """Return one finding for each sensor whose pose differs between sessions."""
    most_significant: dict[str, dict[str, Any]] = {}
    for row in sorted(rows, key=lambda r: r["p_value"]):
        most_significant.setdefault(row["sensor"], row)
    out = []
    for name, row in sorted(most_significant.items()):
        m, rad = np.linalg.norm(np.reshape(row["shift"], (2, 3)), axis=1)
        is_significant = row["p_value"] <= limits["warn_error_p_value"]
        if is_significant and m >= limits["warn_error_moves_pose_m"]:
            level = "fail" if _is_failing_shift(m, rad, limits) else "warn"
            out.append(_session_shift_finding(name, row["session"], level, _format_shift(m, rad)))
    return out


def _session_shift_finding(name: str, session: str, level: str, shift: str) -> Finding:
    return make_finding(
        "sensor_moved",
        [name],
        level,
        text=f"{name}: its pose in session {session} differs by {shift} from the other sessions",
        remedy=(
            f"Check whether {name} was moved or bumped before or after {session}, and calibrate "
            "the later sessions separately. If all sensors moved alike, the robot's markers moved: "
            f"set sessions.{session}.remounted: true."
        ),
    )
