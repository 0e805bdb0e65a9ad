"""Findings on errors of a recording or its config: suspected errors, clocks, mounts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.estimation.corrections.clock_offset import TIME_OFFSET
from calib.geometry.units import DEG_PER_RAD, MM_PER_M, MS_PER_S, SHARE_TO_PERCENT
from calib.io.config_change import ConfigChange, rig_change, target_change
from calib.verdict.findings import (
    Finding,
    Limits,
    check_limit,
    level_by_limits,
    make_finding,
    with_limit,
)
from calib.verdict.limit_checks import MOCAP_SCALE, TIME_OFFSET_CHANGE

ESTIMATE_KEYS = "solve.estimate."
MIN_SCALE_SIGMAS = 3.0  # an error of the scale below this many σ is not told


def suspected_error_findings(
    error: dict[str, Any], noisy: Collection[str], limits: Limits
) -> list[Finding]:
    """Return [finding] on a suspected error of solution.json that is significant and matters.

    noisy: the noises above their limits, see find_noises_beyond_limits.
    """
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
    explained = {
        noise: share
        for noise, share in sorted(error["explained_share"].items())
        if share > limits["warn_error_explains"] and noise in noisy
    }
    if not moved and not explained:
        return []
    failed = [n for n, shift in moved.items() if is_failing_shift(shift["m"], shift["rad"], limits)]
    blurred = {noise.split("/")[0] for noise in explained if "/" in noise}
    return [
        make_finding(
            "suspected_error",
            sorted(failed or set(moved) | blurred),
            "fail" if failed else "warn",
            text=_describe_suspected_error(error, moved, explained),
            remedy=_describe_remedies(error),
            change=_undisputed_change(error),
        )
    ]


def _undisputed_change(error: dict[str, Any]) -> ConfigChange | None:
    """Return the change that corrects an error; None for a value that a rival would make wrong.

    To let the data decide, by a key of solve.estimate, is right with rivals, too.
    """
    change: ConfigChange | None = error["change"]
    if change and error["alternatives"] and not change["key"].startswith(ESTIMATE_KEYS):
        return None
    return change


def _describe_remedies(error: dict[str, Any]) -> str:
    """Return what to do about an error, and then what tells it from its alternatives."""
    every = [error["remedy"], *(e["remedy"] for e in error["alternatives"])]
    first, *others = (f"{r[:1].upper()}{r[1:]}" for r in dict.fromkeys(every))
    return first + "".join(f". If that is right: {r[:1].lower()}{r[1:]}" for r in others)


def is_failing_shift(m: float, rad: float, limits: Limits) -> bool:
    """Return whether a pose that shifts by so much cannot be used."""
    degrees = rad * DEG_PER_RAD
    return m > limits["fail_error_moves_pose_m"] or degrees > limits["fail_error_moves_pose_deg"]


def _describe_suspected_error(
    error: dict[str, Any], moved: dict[str, Any], explained: dict[str, float]
) -> str:
    effects = [
        f"moves {name} by {format_shift(shift['m'], shift['rad'])}" for name, shift in moved.items()
    ]
    effects += [
        f"explains {share * SHARE_TO_PERCENT:.0f} % of {_describe_noise(noise)}"
        for noise, share in explained.items()
    ]
    text = f"likely error: {error['description']}; correcting it {' and '.join(effects)}"
    rivals = "".join(f"; or else {other['description']}" for other in error["alternatives"])
    return text + rivals + (" (only one of them is true)" if rivals else "")


def format_shift(m: float, rad: float) -> str:
    """Format a shift of a pose as `3 mm and 0.2°`."""
    return f"{m * MM_PER_M:.2g} mm and {rad * DEG_PER_RAD:.2g}°"


def _describe_noise(noise: str) -> str:
    """Return `the board outline residuals of lidar` for `lidar/board_outline`."""
    sensor, _, kind = noise.partition("/")
    if not kind:
        return "the errors of the MCS poses"
    return f"the {kind.replace('_', ' ')} residuals of {sensor}"


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
        "time_offset_s",
        [error["subject"]],
        "warn",
        text=text,
        remedy=error["remedy"],
        change=error["change"],
    )
    return [with_limit(finding, abs(offset_s), limit_s)]


def clock_step_findings(audits: Mapping[str, dict[str, Any]]) -> list[Finding]:
    """Return one finding for each step of a clock within a recording. audits: log.json by session.

    Stamps are corrected for the step, to some ms: placements near it may not be.
    """
    return [
        make_finding(
            "clock_step", [], "warn", text=f"{name}: {step['text']}", remedy=step["remedy"]
        )
        for name, audit in audits.items()
        for step in audit.get("clock_steps", [])
    ]


def time_offset_findings(solution: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on estimated time offsets that are far from their initial guess."""
    out = []
    for name, sensor in sorted(solution["sensors"].items()):
        if sensor["time_offset_s"] and sensor["status"]["ok"]:
            offset_s = sensor["time_offset_s"]["value"]
            change_s = abs(offset_s - sensor["guess"]["time_offset_s"]["value"])
            key, value = f"sensors.{name}.time_offset_s", round(offset_s, 4)
            remedy = f"Set {key}: {value:.4f}, so that frames are assigned to the right placements."
            change = rig_change(solution["rig"], key, value)
            check = TIME_OFFSET_CHANGE
            out += check_limit(check, change_s, limits, sensor=name, remedy=remedy, change=change)
    return out


def mocap_scale_findings(scales: dict[str, dict[str, float]], limits: Limits) -> list[Finding]:
    """Return the findings on errors of the motion capture's scale that were estimated.

    scales: {value, sigma} by session.
    """
    out = []
    for session, scale in sorted(scales.items()):
        value, sigma = abs(scale["value"]), scale["sigma"]
        if value > MIN_SCALE_SIGMAS * sigma:
            text = MOCAP_SCALE.text.format(session=session, sigma=MOCAP_SCALE.format(sigma))
            out += check_limit(replace(MOCAP_SCALE, text=text), value, limits)
    return out


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
        f"T_body_target of {name} differs from the config by {format_shift(m, rad)}, which is "
        f"{value:.3g} times its alignment_sigma, {level} above {limit:.3g}; the estimate is used"
    )
    remedy = (
        f"Set T_body_target of {name} to the estimate. If the configured value is certain, check "
        "the other findings."
    )
    pose = target["T_body_target"]
    estimate = {k: pose[k] for k in ("xyz_m", "quat_xyzw")}
    change = target_change(name, "T_body_target", estimate)
    finding = make_finding("target_mount", [], level, text=text, remedy=remedy, change=change)
    return [with_limit(finding, value, limit)]


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
