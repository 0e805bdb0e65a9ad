"""Findings on the noise of measurements and motion capture: how large it is, and what causes it.

Noise is judged by absolute limits and, through σ, by what it does to the poses. How many times it
is above what an ideal measurement would allow is said in words only.
"""

from typing import Any

from calib.geometry.units import DEG_PER_RAD, MM_PER_M, SHARE_TO_PERCENT
from calib.io.config_change import ConfigChange, pipeline_change
from calib.verdict.findings import Finding, Limits, check_limit, level_by_limits, make_finding
from calib.verdict.limit_checks import (
    MOCAP_FACTOR,
    MOCAP_NOISE_DEG,
    MOCAP_NOISE_M,
    NOISE_CHECK_BY_KIND,
    SYSTEMATIC_RESIDUALS,
    TAIL_SHARE,
    LimitCheck,
    limit_check_of_kind,
)

MOCAP_NOISE = "mocap_noise"  # among the explained shares of a suspected error
DISPLAY_UNITS = {"px": (" px", 1.0), "m": (" mm", MM_PER_M), "rad": ("°", DEG_PER_RAD)}
MIN_TOLD_RATIO = 2.0  # of the noise over the ideal one, from which it is said
CAUSE_FIRST_REMEDY = (
    "Correct the findings above first: what they describe looks like errors of the MCS poses. "
    "A larger σ of the MCS would only hide it."
)
LENS_REMEDY = (
    "Set solve.estimate.intrinsics: true, or calibrate the lens of {sensor} again, at the focus "
    "and image size of the recording."
)
LENS_MODEL_REMEDY = (
    "The lens of {sensor} is estimated, but its model does not fit: set a model with more "
    "parameters, for example radtan with k3, or rational."
)
BOARD_REMEDY = "Check with a straightedge whether the board is flat, and measure its print."


def fit_findings(name: str, kind: str, fit: dict[str, Any], limits: Limits) -> list[Finding]:
    """Return the findings on the residuals of one kind of measurement."""
    out = []
    for check, value in _kind_checks(kind, fit):
        out += check_limit(limit_check_of_kind(check, kind), value, limits, sensor=name)
    for finding in out:
        finding["text"] += f"; {describe_scatter(kind, fit)}"
    return out


def _kind_checks(kind: str, fit: dict[str, Any]) -> list[tuple[LimitCheck, float]]:
    """Return the checks of a kind of measurement with their values, in the units of the limits."""
    checks = [(TAIL_SHARE, fit["tail_share"]), (SYSTEMATIC_RESIDUALS, fit["systematic_ratio"])]
    if kind in NOISE_CHECK_BY_KIND:
        factor = DEG_PER_RAD if fit["unit"] == "rad" else 1.0
        checks.append((NOISE_CHECK_BY_KIND[kind], fit["sigma"] * factor))
    return checks


def find_noises_beyond_limits(solution: dict[str, Any], limits: Limits) -> set[str]:
    """Return the noises above a warn limit: `sensor/kind`, or MOCAP_NOISE."""
    out = {
        f"{name}/{kind}"
        for name, sensor in solution["sensors"].items()
        for kind, fit in sensor["fit_by_kind"].items()
        if any(level_by_limits(v, limits, c.key) != "pass" for c, v in _kind_checks(kind, fit))
    }
    factor = solution["noise"]["mocap_factor"]
    is_beyond = level_by_limits(factor, limits, MOCAP_FACTOR.key) != "pass"
    return out | {MOCAP_NOISE} if is_beyond else out


def describe_scatter(kind: str, fit: dict[str, Any]) -> str:
    """Describe the noise of a kind of measurement against the ideal one, and its cause."""
    unit, factor = DISPLAY_UNITS[fit["unit"]]
    words = f"{kind.replace('_', ' ')} measurements scatter by {fit['sigma'] * factor:.2g}{unit}"
    if fit["sigma"] > MIN_TOLD_RATIO * fit["ideal_sigma"]:
        ideal = f"{fit['ideal_sigma'] * factor:.2g}{unit}"
        allows = "these images" if fit["unit"] == "px" else "the configured noise"
        words += f" where {allows} would allow {ideal}"
        if fit["repeated"]:
            words += f": {describe_cause(fit['repeated'])}"
    return words


def describe_cause(repeated: dict[str, float]) -> str:
    """Describe the cause of the scatter of corners, by what of it repeats; see repeated_shares."""
    causes = []
    if repeated["image"]:
        share = f"{repeated['image'] * SHARE_TO_PERCENT:.0f} %"
        causes.append(f"{share} repeats at the same place of the image in all placements (lens)")
    if repeated["target"]:
        share = f"{repeated['target'] * SHARE_TO_PERCENT:.0f} %"
        causes.append(f"{share} repeats at the same corners (board not flat, or its print)")
    if repeated["views"]:
        causes.append("it differs between placements (blur, motion or distance)")
    return " and ".join(causes) or "nothing of it repeats (blur, focus or compression)"


def scatter_cause_findings(
    name: str, sensor: dict[str, Any], suspected: list[dict[str, Any]]
) -> list[Finding]:
    """Return [finding] on what repeats in the corner residuals of a camera, if no other says it.

    For a camera with other findings. suspected: the errors of solution.json that are told.
    """
    for kind, fit in sorted(sensor["fit_by_kind"].items()):
        repeated, noise = fit["repeated"], f"{name}/{kind}"
        is_told = any(noise in e["explained_share"] or e["subject"] == name for e in suspected)
        if not repeated or is_told or not max(repeated["image"], repeated["target"]):
            continue
        text = f"{name}: {describe_scatter(kind, fit)}"
        remedy, change = _scatter_advice(name, sensor, repeated)
        return [
            make_finding("scatter_cause", [name], "warn", text=text, remedy=remedy, change=change)
        ]
    return []


def _scatter_advice(
    name: str, sensor: dict[str, Any], repeated: dict[str, float]
) -> tuple[str, ConfigChange | None]:
    """Return (remedy, change) for what repeats most."""
    if repeated["target"] > repeated["image"]:
        return BOARD_REMEDY, None
    if sensor["intrinsics"] is not None:
        return LENS_MODEL_REMEDY.format(sensor=name), None
    return LENS_REMEDY.format(sensor=name), pipeline_change("solve.estimate.intrinsics", True)


def mocap_findings(solution: dict[str, Any], limits: Limits, has_systematic: bool) -> list[Finding]:
    """Return the findings on the errors of the MCS poses.

    has_systematic: an error that is not estimated is told beside; a larger σ would hide it.
    """
    scatter, remedy = solution["noise"]["mocap_scatter"], CAUSE_FIRST_REMEDY
    if not has_systematic:
        remedy = MOCAP_FACTOR.remedy + (_pose_bias_remedy(scatter["estimated"]) if scatter else "")
    out = check_limit(MOCAP_FACTOR, solution["noise"]["mocap_factor"], limits, remedy=remedy)
    if scatter:
        configured, estimated = (_format_sigma(scatter[k]) for k in ("configured", "estimated"))
        for finding in out:
            finding["text"] += f"; they scatter by {estimated}, and the config states {configured}"
        for check, key, unit in ((MOCAP_NOISE_M, "m", 1.0), (MOCAP_NOISE_DEG, "rad", DEG_PER_RAD)):
            out += check_limit(check, scatter["estimated"][key] * unit, limits)
    return out


def _format_sigma(sigma: dict[str, float]) -> str:
    return f"{sigma['m'] * MM_PER_M:.2g} mm, {sigma['rad'] * DEG_PER_RAD:.2g}°"


def _pose_bias_remedy(sigma: dict[str, float]) -> str:
    """Return which σ to write, if the motion capture itself is that noisy."""
    return (
        " Only if the MCS scatters so while nothing moves, set mocap.pose_bias_sigma: "
        f"{{xyz_m: {sigma['m']:.2g}, rpy_deg: {sigma['rad'] * DEG_PER_RAD:.2g}}}."
    )
