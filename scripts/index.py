"""All rigs and sessions on one page, written at the end of every run, whatever became of it.

Reads   calibration.json and verdict.json of every rig, its history/, log.json of its sessions; the
        page's templates
Writes  index.html, complete in itself but for its links
Decides nothing; a rig whose jobs stopped is shown with what stopped them.
"""

from calib.export import accepted_calibrations
from calib.io import atomic_files, stage_cli
from calib.io.stage_cli import logger
from calib.io.status import InputError
from calib.report.page import html_page, rigs_page


def of_rig(home, sessions, stopped):
    """What is told of the rig whose results are in a folder."""
    told = {"name": home.name, "stopped": stopped, "found": None, "links": links(home)}
    paths = home / "calibration.json", home / "verdict.json"
    if not all(path.exists() for path in paths):
        return told | {"stopped": stopped or ["not calibrated yet"]}
    calibration, verdict = (stage_cli.read_json(path) for path in paths)
    audits = {s: _audit(home / s / "log.json") for s in sessions}
    try:
        earlier = accepted_calibrations.before(home / "history", calibration)
    except InputError as error:
        earlier, told["stopped"] = [], [*stopped, str(error)]
    return told | {"found": rigs_page.of_rig(calibration, verdict, earlier, audits)}


def _audit(path):
    return stage_cli.read_json(path) if path.exists() else None


def links(home):
    """[(words, path from the page)] of what a rig has."""
    known = {"report": "report.html", "on paper": "report.pdf", "export": "export"}
    known |= {"calibration.json": "calibration.json", "history": "history"}
    return [(word, f"{home.name}/{p}") for word, p in known.items() if (home / p).exists()]


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        results="folder",
        templates="*input, Jinja2, style and scripts of the page",
        output="output",
        options="{rigs: {name: {sessions, stopped}}}",
    ).parse_args(argv)
    rigs = sorted(args.options["rigs"].items())
    told = [of_rig(args.results / n, r["sessions"], r["stopped"]) for n, r in rigs]
    page = html_page.render(args.templates, "index.html.j2", {"rigs": told})
    atomic_files.write(args.output, page)
    logger.info("%s: %d rigs", args.output, len(told))


if __name__ == "__main__":
    stage_cli.run(main)
