"""Checks what the recordings of a rig support, before anything is solved. Reads no payloads.

Reads   log.json, mocap.parquet, frames.parquet and placements.parquet of every session
Writes  preflight.json  what each sensor may see of the targets, findings and a verdict
        preflight.txt   the same as text, with the audit of the logs

Uses the limits of judge, the sensors' fields of view, and their poses from rig or log. Only what is
certainly out of view counts as not visible; without a stated pose, everything may be visible. The
verdict is fail if no sensor can be calibrated.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from calib.io.atomic_files import atomic_write
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage, write_json
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA
from calib.report.page.preflight_text import format_preflight
from calib.verdict.preflight_findings import preflight_rig_findings, reject_floating_sensors
from calib.verdict.preflight_guess import PreflightSession
from calib.verdict.preflight_json import sensor_visibility_json, target_turns_json
from calib.verdict.preflight_visibility import assess_rig_visibility
from calib.views.target_placements import PlacementTable


class SessionFiles(NamedTuple):
    """Paths of the files of one session."""

    audit: Path
    frames: Path
    mocap: Path
    placements: Path


def load_preflight_session(
    name: str, files: SessionFiles, options: dict[str, Any]
) -> PreflightSession:
    """Read one session. name: of the session in options["sessions"]."""
    session = options["sessions"][name]
    return PreflightSession(
        audit=read_json(files.audit),
        frames=read_table(files.frames, FRAMES_SCHEMA)[0],
        poses=read_table(files.mocap, MOCAP_SCHEMA)[0],
        placements=PlacementTable.read(files.placements),
        has_remounted_markers=session["remounted"],
        streams=tuple(session["sensors"]),
    )


def preflight_json(
    sessions: dict[str, PreflightSession], options: dict[str, Any]
) -> dict[str, Any]:
    """Return the content of preflight.json."""
    visibility = assess_rig_visibility(sessions, options)
    visibility = reject_floating_sensors(visibility, sessions, options)
    verdict = preflight_rig_findings(sessions, visibility, options)
    return {
        "rig": options["rig"],
        "verdict": verdict.level,
        "findings": verdict.findings,
        "levels": verdict.levels,
        "sensors": sensor_visibility_json(visibility),
        "targets": target_turns_json(sessions, options),
    }


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--audits", "log.json of each session")
    parser.add_paths("--mocap", "mocap.parquet of each session")
    parser.add_paths("--frames", "frames.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_path("--json", "preflight.json to write")
    parser.add_path("--text", "preflight.txt to write")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    options = args.options
    files = zip(args.audits, args.frames, args.mocap, args.placements, strict=True)
    sessions = {
        name: load_preflight_session(name, SessionFiles(*paths), options)
        for name, paths in zip(sorted(options["sessions"]), files, strict=True)
    }
    content = preflight_json(sessions, options)
    lines = format_preflight(options["rig"], content, sessions, options)
    with atomic_write(args.text) as part:
        part.write_text("\n".join(lines) + "\n")
    write_json(args.json, content)
    logger.info("%s: %s", options["rig"], content["verdict"])


if __name__ == "__main__":
    run_stage(main)
