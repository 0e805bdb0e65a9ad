"""What stands in a verdict: one finding per limit that is not kept, in words and numbers."""

VERDICT_LEVELS = ("pass", "warn", "fail")
REMEDY_BY_CHECK = {
    "rejected": "see what was left out and where (Residuals): a stand, a hand, a wrong size or "
    "mount of a target, or wrong lens parameters",
    "rejected edge": "measure outline_m, and see where the crossings lie (Residuals)",
    "rejected corner": "measure square_m and T_body_target; if they are right, the lens parameters "
    "or single views are wrong (Residuals, Extraction)",
    "mocap_factor": "state mocap.pose_sigma and pose_bias_sigma as they are; if they are, look for "
    "a wrong size or T_body_target of a target, wrong lens parameters, or a clock that is off",
    "noise_factor": "see Residuals for what the noise stands for; state the "
    "sensor's own noise if it is what it is",
    "tail_share": "see the overlays of the worst views for what does not belong to the target",
    "systematic": "see the residuals by ring or over the image: an error of single beams, of the "
    "lens or of the printed pattern repeats itself",
    "leave_one_out": "see the most influential placements (Cross-validation): one may not have been "
    "still, or something that nobody estimates is wrong",
    "placements": "hold targets still in more places that it sees, and see where the others were "
    "lost, and why",
    "guess_deviation_sigma": "check the first guess and its sigma; if both are sure, the result is not",
    "convergence": "see the rounds in the Appendix, and mend what else is wrong first",
}


def worst_level(levels):
    """The gravest of some levels; pass of none."""
    return max(levels, key=VERDICT_LEVELS.index, default="pass")


def level_by_limits(value, limits, key, is_large_bad=True):
    """What a value is by the limits warn_<key> and fail_<key>; one that is no number fails."""
    for grave in ("fail", "warn"):
        limit = limits[f"{grave}_{key}"]
        if not (value <= limit if is_large_bad else value >= limit):
            return grave
    return "pass"


def make_finding(check, sensors, level, text, remedy, value=None, limit=None):
    """One entry of the verdict; sensors: names of those whose level it concerns."""
    return {
        "check": check,
        "sensor": sensors[0] if len(sensors) == 1 else None,
        "sensors": sensors,
        "level": level,
        "value": value,
        "limit": limit,
        "text": text,
        "remedy": remedy,
    }


def check_limit(
    name,
    value,
    limits,
    check,
    description,
    display_factor=1.0,
    unit="",
    is_large_bad=True,
    remedy=None,
):
    """[finding] of a value that is beyond its limits, else []."""
    found = level_by_limits(value, limits, check, is_large_bad)
    if found == "pass":
        return []
    limit = limits[f"{found}_{check}"]
    side = "above" if is_large_bad else "below"
    shown, most = (f"{v * display_factor:.3g}{unit}" for v in (value, limit))
    text = f"{description} {shown}, {found} {side} {most}"
    text = f"{name}: {text}" if name else text
    remedy = REMEDY_BY_CHECK[check] if remedy is None else remedy
    return [make_finding(check, [name] if name else [], found, text, remedy, value, limit)]
