"""Judges a solution by the limits of the config: pass, warn or fail, per sensor and for the rig.

Reads   solution.json; log.json of all sessions: steps of clocks
Writes  calibration.json  the results, for robots and people
        verdict.json      the verdict, its findings and the limits
"""

import argparse
from collections.abc import Sequence
from typing import Any

from calib.io.config import validate_and_complete
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage, write_json
from calib.verdict.rig_verdict import Verdict, rig_findings

CALIBRATION_SCHEMA_VERSION = 1
# Keys of solution.json that only this stage reads.
JUDGED_KEYS = {"has_converged", "ipopt_status"}
JUDGED_SENSOR_KEYS = {"direction_spread_deg", "guess_deviation_in_sigma"}


def calibration_json(solution: dict[str, Any], verdict: Verdict) -> dict[str, Any]:
    """Return the content of calibration.json: the solution with its verdict."""
    sensors = {
        name: {k: v for k, v in sensor.items() if k not in JUDGED_SENSOR_KEYS}
        | {"verdict": verdict.levels[name]}
        for name, sensor in solution["sensors"].items()
    }
    return {k: v for k, v in solution.items() if k not in JUDGED_KEYS} | {
        "schema_version": CALIBRATION_SCHEMA_VERSION,
        "verdict": verdict.level,
        "reasons": [f["text"] for f in verdict.findings],
        "sensors": sensors,
    }


def verdict_json(verdict: Verdict, limits: dict[str, float]) -> dict[str, Any]:
    """Return the content of verdict.json."""
    return {
        "verdict": verdict.level,
        "reasons": [f["text"] for f in verdict.findings],
        "findings": verdict.findings,
        "sensors": verdict.levels,
        "limits": limits,
    }


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--solution", "solution.json")
    parser.add_paths("--audits", "log.json of each session")
    parser.add_path("--calibration", "calibration.json to write")
    parser.add_path("--verdict", "verdict.json to write")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    solution, limits = read_json(args.solution), args.options["judge"]
    audits = dict(zip(args.options["sessions"], map(read_json, args.audits), strict=True))
    verdict = rig_findings(solution, limits, audits)
    calibration = calibration_json(solution, verdict)
    validate_and_complete("calibration", calibration, args.calibration)
    write_json(args.calibration, calibration)
    judgement = verdict_json(verdict, limits)
    write_json(args.verdict, validate_and_complete("verdict", judgement, args.verdict))
    logger.info("%s: %s", solution["rig"], verdict.level)
    for finding in verdict.findings:
        logger.info("%(level)s: %(text)s. %(remedy)s", finding)


if __name__ == "__main__":
    run_stage(main)
