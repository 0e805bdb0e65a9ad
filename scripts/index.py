"""All rigs and sessions on one page, written at the end of every run, whatever became of it.

Reads   calibration.json and verdict.json of every rig, its history/, log.json of its sessions; the
        page's templates
Writes  index.html, complete in itself but for its links
Decides nothing; a rig whose jobs stopped is shown with what stopped them.
"""

import argparse
from collections.abc import Sequence

from calib.export.accepted_calibrations import read_earlier_calibrations
from calib.io.atomic_files import write_file
from calib.io.stage_cli import StageArgumentParser, logger, read_json, run_stage
from calib.io.status import InputError
from calib.report.page.html_page import render_template
from calib.report.page.rigs_page import build_rig_overview


def collect_rig_summary(rig_folder, sessions, job_errors):
    """What is told of the rig whose results are in a folder."""
    told = {
        "name": rig_folder.name,
        "stopped": job_errors,
        "found": None,
        "links": rig_page_links(rig_folder),
    }
    paths = rig_folder / "calibration.json", rig_folder / "verdict.json"
    if not all(path.exists() for path in paths):
        return told | {"stopped": job_errors or ["not calibrated yet"]}
    calibration, verdict = (read_json(path) for path in paths)
    audits = {s: _read_audit_if_present(rig_folder / s / "log.json") for s in sessions}
    try:
        earlier = read_earlier_calibrations(rig_folder / "history", calibration)
    except InputError as error:
        earlier, told["stopped"] = [], [*job_errors, str(error)]
    return told | {"found": build_rig_overview(calibration, verdict, earlier, audits)}


def _read_audit_if_present(path):
    return read_json(path) if path.exists() else None


def rig_page_links(rig_folder):
    """[(words, path from the page)] of what a rig has."""
    known = {"report": "report.html", "on paper": "report.pdf", "export": "export"}
    known |= {"calibration.json": "calibration.json", "history": "history"}
    return [
        (word, f"{rig_folder.name}/{p}") for word, p in known.items() if (rig_folder / p).exists()
    ]


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(
        __doc__, options_help="{rigs: {name: {sessions, stopped}}}, as JSON"
    )
    parser.add_path("--results", "folder of all results")
    parser.add_paths("--templates", "Jinja2 templates, style and scripts of the page")
    parser.add_path("--output", "index.html to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    rigs = sorted(args.options["rigs"].items())
    told = [collect_rig_summary(args.results / n, r["sessions"], r["stopped"]) for n, r in rigs]
    page = render_template(args.templates, "index.html.j2", {"rigs": told})
    write_file(args.output, page)
    logger.info("%s: %d rigs", args.output, len(told))


if __name__ == "__main__":
    run_stage(main)
