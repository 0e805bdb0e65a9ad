"""What the recordings of a rig can and cannot support, before anyone waits for a solve.

Reads   log.json, mocap.parquet, frames.parquet and placements.parquet of every session
Writes  preflight.json  what each sensor may see of the targets, findings, and a verdict on them
        preflight.txt   the same for people, with the audit of the logs
Decides by the limits of judge, the sensors' fields of view, and their poses as rig or log state
them: what is out of view for certain is not seen, and of a pose that nobody states nothing is. No
payload is read. A verdict of fail says that no sensor can be calibrated.
"""

import argparse
from collections.abc import Sequence

from calib.io.atomic_files import atomic_write
from calib.io.parquet_tables import read_table
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage, write_json
from calib.io.table_schemas import FRAMES_SCHEMA, MOCAP_SCHEMA
from calib.report.page.preflight_text import PreflightRun, format_preflight
from calib.verdict.preflight_findings import (
    preflight_rig_findings,
    sensor_visibility_json,
    target_turns_json,
)
from calib.verdict.preflight_visibility import PreflightSession, assess_sensor_visibility
from calib.views.target_placements import PlacementTable


def load_preflight_session(name, audit, frames, mocap, placements, options):
    """The looks.Session of the files of one."""
    about = options["sessions"][name]
    return PreflightSession(
        audit=read_json(audit),
        frames=read_table(frames, FRAMES_SCHEMA)[0],
        poses=read_table(mocap, MOCAP_SCHEMA)[0],
        placements=PlacementTable.read(placements),
        has_remounted_markers=about["remounted"],
        sensor_names=tuple(about["sensors"]),
    )


def preflight_json(sessions, options):
    """The content of preflight.json."""
    seen = {
        sensor: {
            name: assess_sensor_visibility(session, sensor, options)
            for name, session in sessions.items()
            if sensor in session.sensor_names
        }
        for sensor in sorted(options["sensors"])
    }
    verdict, findings, levels = preflight_rig_findings(sessions, seen, options)
    about = {"rig": options["rig"], "verdict": verdict, "findings": findings, "levels": levels}
    targets = target_turns_json(sessions, options)
    return about | {"sensors": sensor_visibility_json(seen), "targets": targets}


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--audits", "log.json of each session")
    parser.add_paths("--mocap", "mocap.parquet of each session")
    parser.add_paths("--frames", "frames.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_path("--json", "preflight.json to write")
    parser.add_path("--text", "preflight.txt to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    options = args.options
    paths = zip(args.audits, args.frames, args.mocap, args.placements, strict=True)
    named = zip(sorted(options["sessions"]), paths, strict=True)
    sessions = {name: load_preflight_session(name, *of, options) for name, of in named}
    found = preflight_json(sessions, options)
    told = format_preflight(options["rig"], found, PreflightRun(options, sessions))
    with atomic_write(args.text) as part:
        part.write_text("\n".join(told) + "\n")
    write_json(args.json, found)
    logger.info("%s: %s", options["rig"], found["verdict"])


if __name__ == "__main__":
    run_stage(main)
