"""Write the page of all rigs and sessions, at the end of each run, also of a run that failed.

Reads   calibration.json, verdict.json and history/ of each rig, log.json of its sessions; the
        templates of the page
Writes  index.html, which needs no other files except for its links
Decides nothing; a rig whose jobs stopped is shown with the errors that stopped them.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib.export.accepted_calibrations import read_earlier_calibrations
from calib.io.atomic_files import write_file
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import InputError
from calib.report.page.html_page import render_template
from calib.report.page.rigs_page import build_rig_overview

LINKED_FILES = {
    "report": "report.html",
    "PDF": "report.pdf",
    "export": "export",
    "calibration.json": "calibration.json",
    "history": "history",
}


def collect_rig_summary(
    rig_folder: Path, sessions: list[str], job_errors: list[str]
) -> dict[str, Any]:
    """Return the context of one rig; overview is None if it was never calibrated."""
    summary = {"name": rig_folder.name, "links": rig_page_links(rig_folder)}
    paths = rig_folder / "calibration.json", rig_folder / "verdict.json"
    if not all(path.exists() for path in paths):
        return summary | {"errors": job_errors or ["not calibrated yet"], "overview": None}
    calibration, verdict = (read_json(path) for path in paths)
    audits = {s: _read_audit_if_present(rig_folder / s / "log.json") for s in sessions}
    try:
        accepted = read_earlier_calibrations(rig_folder / "history", calibration)
    except InputError as error:
        accepted, job_errors = [], [*job_errors, str(error)]
    overview = build_rig_overview(calibration, verdict, accepted, audits)
    return summary | {"errors": job_errors, "overview": overview}


def _read_audit_if_present(path: Path) -> dict[str, Any] | None:
    return read_json(path) if path.exists() else None


def rig_page_links(rig_folder: Path) -> list[tuple[str, str]]:
    """Return (text, path from the page) of the results of a rig that exist."""
    return [
        (text, f"{rig_folder.name}/{name}")
        for text, name in LINKED_FILES.items()
        if (rig_folder / name).exists()
    ]


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(
        __doc__, options_help="{rigs: {name: {sessions, stopped}}}, as JSON"
    )
    parser.add_path("--results", "folder of all results")
    parser.add_paths("--templates", "Jinja2 templates, style and scripts of the page")
    parser.add_path("--output", "index.html to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Write the page."""
    args = _parse_arguments(argv)
    rigs = [
        collect_rig_summary(args.results / name, rig["sessions"], rig["stopped"])
        for name, rig in sorted(args.options["rigs"].items())
    ]
    write_file(args.output, render_template(args.templates, "index.html.j2", {"rigs": rigs}))
    logger.info("%s: %d rigs", args.output, len(rigs))


if __name__ == "__main__":
    run_stage(main)
