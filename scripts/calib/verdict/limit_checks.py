"""The checks with limits in the judge block of the config: their texts, units and remedies."""

from dataclasses import replace

from calib.geometry.units import MM_PER_M, MS_PER_S, SHARE_TO_PERCENT
from calib.verdict.findings import LimitCheck

# The cause of a finding comes before its effects.
CHECKS_BY_IMPORTANCE = (
    "status", "clock_step", "sensor_moved", "suspected_error", "scatter_cause",
    "outline_vs_surface", "mocap_scale", "target_mount", "time_offset_s", "tilt_deg", "rejected",
    "systematic", "tail_share", "leave_one_out", "split_half", "corner_noise_px",
    "limb_noise_px", "range_noise_m", "outline_noise_deg", "mocap_noise_m", "mocap_noise_deg",
    "mocap_factor", "placements", "sigma_m", "sigma_deg", "guess_deviation_sigma", "convergence",
)  # fmt: skip
# Errors that are not estimated; they explain misfits, and a larger σ would hide them.
CAUSE_CHECKS = {
    "sensor_moved",
    "suspected_error",
    "scatter_cause",
    "outline_vs_surface",
    "target_mount",
}
SYSTEMATIC_CHECKS = {"systematic", "rejected", *CAUSE_CHECKS}
NOISE_CHECKS = {"corner_noise_px", "limb_noise_px", "range_noise_m", "outline_noise_deg"}
# Measurements and model disagree, which increases σ.
MISFIT_CHECKS = {
    "suspected_error",
    "scatter_cause",
    "rejected",
    "mocap_factor",
    "mocap_noise_m",
    "mocap_noise_deg",
    "tail_share",
    "systematic",
    "leave_one_out",
    "split_half",
    "outline_vs_surface",
    *NOISE_CHECKS,
}
# What a cause may explain.
EFFECT_CHECKS = {*MISFIT_CHECKS, "sigma_m", "sigma_deg", "convergence"} - CAUSE_CHECKS
CONVERGENCE_REMEDY = (
    "Check the iterations in the report (Appendix), and correct the other findings first."
)
REJECTION_REMEDY = (
    "Check where the rejected measurements lie in the report (Residuals). Typical causes are a "
    "stand or a hand beside the target, a wrong size or mount of a target, or wrong intrinsics."
)
REJECTION_REMEDY_BY_KIND = {
    "board_outline": "Measure outline_m, and check where the outline points lie in the report "
    "(Residuals).",
    "pattern_corner": "Measure square_m and T_body_target. If they are right, the intrinsics or "
    "single views are wrong: check Residuals and Extraction in the report.",
}

REJECTED_SHARE = LimitCheck(
    "rejected",
    "{} of the measurements are rejected",
    REJECTION_REMEDY,
    unit=" %",
    display_factor=SHARE_TO_PERCENT,
)
LEAVE_ONE_OUT = LimitCheck(
    "leave_one_out",
    "leave-one-out error is {} times its predicted σ",
    "Check the most influential placements in the report (Cross-validation): a target may not "
    "have been still, or an error is not estimated.",
)
TIME_OFFSET_CHANGE = LimitCheck(
    "time_offset_s",
    "time offset differs from its initial guess by {}",
    unit=" ms",
    display_factor=MS_PER_S,
)
GUESS_DEVIATION = LimitCheck(
    "guess_deviation_sigma",
    "pose differs from the initial guess by {} times its σ",
    "Check the initial guess and its σ (T_robot_sensor and guess_sigma in the rig file). If both "
    "are right, the result is wrong.",
)
PLACEMENTS = LimitCheck(
    "placements",
    "placements {}",
    "Hold targets still in more places in view of the sensor. Check in the report where and why "
    "the other placements were lost.",
    is_upper_limit=False,
)
MOCAP_FACTOR = LimitCheck(
    "mocap_factor",
    "errors of the MCS poses are {} times the configured σ",
    "Look for a wrong size or T_body_target of a target, a wrong lens, a wrong scale of the MCS, "
    "or markers that moved.",
)
MOCAP_NOISE_M = LimitCheck(
    "mocap_noise_m",
    "errors of the MCS poses scatter by {}",
    MOCAP_FACTOR.remedy,
    unit=" mm",
    display_factor=MM_PER_M,
)
MOCAP_NOISE_DEG = replace(MOCAP_NOISE_M, key="mocap_noise_deg", unit="°", display_factor=1.0)
MOCAP_SCALE = LimitCheck(
    "mocap_scale",
    "distances of the motion capture in session {session} err by {{}} (± {sigma}), and the poses "
    "are corrected for it",
    "Calibrate the motion capture again with a wand of known length. Other users of its poses have "
    "the same error.",
    unit=" %",
    display_factor=SHARE_TO_PERCENT,
)
POSITION_SIGMA = LimitCheck("sigma_m", "position σ {}", unit=" mm", display_factor=MM_PER_M)
ROTATION_SIGMA = LimitCheck("sigma_deg", "rotation σ {}", unit="°")
CORNER_NOISE = LimitCheck(
    "corner_noise_px",
    "corners scatter by {{}}",
    "Look at the worst views in the report (Overlays): focus the lens, light the board better, and "
    "hold it still and nearer.",
    unit=" px",
)
LIMB_NOISE = LimitCheck(
    "limb_noise_px",
    "contours scatter by {{}}",
    "Look at the worst views in the report (Overlays): hold the target before a background of "
    "another colour, and set its color.",
    unit=" px",
)
RANGE_NOISE = LimitCheck(
    "range_noise_m",
    "ranges on {kind} scatter by {{}}",
    "Look at the residuals by ring and incidence in the report (Residuals): nearer targets, and "
    "surfaces that are neither glossy nor dark, scatter less.",
    unit=" mm",
    display_factor=MM_PER_M,
)
OUTLINE_NOISE = LimitCheck(
    "outline_noise_deg",
    "outline crossings scatter by {{}}",
    "Look where the outline points lie in the report (Residuals): keep stands and hands away from "
    "the outline, and record nearer targets.",
    unit="°",
)
# By kind of measurement; the others have no limit of their own.
NOISE_CHECK_BY_KIND = {
    "pattern_corner": CORNER_NOISE,
    "cylinder_limb": LIMB_NOISE,
    "target_surface": RANGE_NOISE,
    "cylinder_cap": RANGE_NOISE,
    "board_outline": OUTLINE_NOISE,
}
TAIL_SHARE = LimitCheck(
    "tail_share",
    "{{}} of the {kind} residuals exceed 3 σ",
    "Check the overlays of the worst views in the report for measurements that do not belong to "
    "the target.",
    unit=" %",
    display_factor=SHARE_TO_PERCENT,
)
SYSTEMATIC_RESIDUALS = LimitCheck(
    "systematic",
    "mean {kind} residuals over all placements are {{}} times their σ",
    "Check the residuals by ring or over the image in the report: errors of single beams, of the "
    "intrinsics or of the printed pattern repeat in all placements.",
)
BOARD_TILT = LimitCheck(
    "tilt_deg", "normals of the boards differ by at most {}", unit="°", is_upper_limit=False
)
CYLINDER_TILT = replace(BOARD_TILT, text="axes of the cylinders differ by at most {}")


def limit_check_of_kind(check: LimitCheck, kind: str) -> LimitCheck:
    """Return a check with the kind of measurement in its text."""
    return replace(check, text=check.text.format(kind=kind.replace("_", " ")))
