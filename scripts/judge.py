"""Pass, warn or fail, per sensor and for the rig, from the limits in the config.

Reads   solution.json
Writes  calibration.json  the results as robots and people read them
        verdict.json      the verdict, its reasons, the limits it was judged by
"""

import argparse
from collections.abc import Sequence

from calib.io.config import validate_and_complete
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage, write_json
from calib.verdict.rig_verdict import rig_findings

CALIBRATION_SCHEMA_VERSION = 1


def calibration_json(solution, overall, reasons, levels):
    """The content of calibration.json."""
    keep = ("kind", "frame", "status", "guess", "T_robot_sensor", "covariance", "least_certain")
    keep += ("placements", "observations", "points", "rejected_share", "residual", "undetermined")
    keep += (
        "recording_advice",
        "next_view",
        "rejected_by_region",
        "fit_by_kind",
        "leave_one_out",
        "sigma_by_placements",
        "corrections",
        "common_range_sigma_m",
    )
    keep += ("time_offset_s", "time_offset_note", "clock_drift", "intrinsics", "intrinsics_note")
    sensors = {
        name: {k: sensor[k] for k in keep} | {"verdict": levels[name]}
        for name, sensor in solution["sensors"].items()
    }
    return {
        "schema_version": CALIBRATION_SCHEMA_VERSION,
        "rig": solution["rig"],
        "verdict": overall,
        "reasons": reasons,
        "sensors": sensors,
        "joint_covariance": solution["joint_covariance"],
        "pairs": solution["pairs"],
        "suspected_errors": solution["suspected_errors"],
        "mocap_offsets_s": solution["mocap_offsets_s"],
        "influences": solution["influences"],
        "targets": solution["targets"],
        "repeatability": solution["repeatability"],
        "sessions": solution["sessions"],
        "noise": solution["noise"],
        "provenance": solution["provenance"],
    }


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--solution", "solution.json")
    parser.add_path("--calibration", "calibration.json to write")
    parser.add_path("--verdict", "verdict.json to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    limits = args.options["judge"]
    solution = read_json(args.solution)
    overall, findings, levels = rig_findings(solution, limits)
    reasons = [f["text"] for f in findings]
    result = calibration_json(solution, overall, reasons, levels)
    write_json(args.calibration, validate_and_complete("calibration", result, args.calibration))
    judged = {"verdict": overall, "reasons": reasons, "findings": findings}
    judged |= {"sensors": levels, "limits": limits}
    write_json(args.verdict, validate_and_complete("verdict", judged, args.verdict))
    logger.info("%s: %s", solution["rig"], overall)
    for f in findings:
        logger.info("%s: %s; %s", f["level"], f["text"], f["remedy"])


if __name__ == "__main__":
    run_stage(main)
