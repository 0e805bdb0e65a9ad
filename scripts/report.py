"""What a person must know of a calibration, as one page that opens anywhere, and on paper.

Reads   calibration.json, verdict.json, residuals.parquet, iterations.parquet; log.json and
        placements.parquet of all sessions; guess.json, views.parquet and keypoints.parquet of all
        their sensors; the page's template
Writes  report.html, complete in itself: figures, images and style inside; report.pdf, the same for
        paper; figures/*.svg, the main figures with all sensors
Decides nothing; what could not be done is shown with its reason, found, expected and remedy.
"""

import jinja2
from markupsafe import Markup

from calib import stage
from calib.report import (
    coverage,
    coverage_figures,
    evidence,
    evidence_figures,
    extrinsics,
    figures,
    funnel,
    overlays,
    paper,
    plots,
    residuals,
    rig_figure,
    summary,
)
from calib.report.inputs import read_run
from calib.stage import logger

COLUMNS = {"extrinsics": 1, "coverage": 1, "residuals": 3}  # of the figures that are written


def content(run):
    """What the template prints, by section."""
    return {
        "title": run.options["report"]["title"] or run.options["rig"],
        "rig": run.options["rig"],
        "body": run.options["body"],
        "verdict": summary.verdict(run),
        "extrinsics": [extrinsics.of_sensor(run, n) for n in run.sensors],
        "strangers": run.strangers,
        "rig_figure": rig_figure.draw(run),
        "between": extrinsics.between(run),
        "by_count": evidence_figures.sigma_by_count(run),
        "suspicions": evidence.suspicions(run),
        "by_session": evidence.sessions(run),
        "held_out": evidence.held_out(run),
        "unknowns": summary.other_unknowns(run),
        "sessions": [session(run, name) for name in run.sessions],
        "coverage": [covered(run, n) for n in run.sensors],
        "residuals": [left_over(run, n) for n in run.sensors],
        "noise": residuals.noise(run),
        "mocap_factor": run.calibration["noise"]["mocap_factor"],
        "overlays": [
            {"name": n, "kind": s["kind"], "views": overlays.of_sensor(run, n)}
            for n, s in run.sensors.items()
        ],
        "convergence": summary.convergence(run),
        "provenance": summary.provenance(run),
    }


def covered(run, name):
    """Coverage of one sensor."""
    found = coverage.of_sensor(run, name)
    drawing = coverage_figures.draw(run, name, found) if found else None
    told = {"row": coverage.row(run, name, found), "kind": run.sensors[name]["kind"]}
    return told | {"drawing": drawing}


def left_over(run, name):
    """Residuals of one sensor."""
    plotted = figures.of_sensor(run, name)
    alone = evidence_figures.influence(run, name) if plotted else None
    return {
        "name": name,
        "kind": run.sensors[name]["kind"],
        "rows": residuals.overview(run, name),
        "rejected": residuals.rejected(run, name),
        "left_out": evidence.left_out(run, name),
        "figures": plotted + ([alone] if alone else []),
    }


def session(run, name):
    """Audit and funnel of one session."""
    return {
        "name": name,
        "streams": funnel.streams(run, name),
        "bodies": funnel.bodies(run, name),
        "heard": funnel.heard(run, name),
        "unused": funnel.unused_topics(run, name),
        "problems": funnel.problems(run, name),
        "funnel": funnel.table(run, name),
        "timeline": figures.timeline(run, name),
    }


def arguments(argv):
    """The parsed command line."""
    return stage.parser(
        __doc__,
        calibration="input",
        verdict="input",
        residuals="input",
        iterations="input",
        audits="*input log.json, one per session",
        placements="*input, one per session",
        guesses="*input, one per session and sensor",
        views="*input, one per session and sensor",
        keypoints="*input, one per session and sensor",
        template="input, Jinja2",
        html="output",
        pdf="output",
        figures="*output, named after what they show",
        options="slice of the config",
    ).parse_args(argv)


def page(template, shown, images=None):
    """The page for the screen, or for paper, which finds its Images by name."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["drawn"] = images.tag if images else lambda d: Markup(d.svg)
    return environment.from_string(template).render(shown, on_paper=images is not None)


def write_figures(paths, shown):
    """The main figures, each with all sensors, as files."""
    drawn = {
        "extrinsics": [shown["rig_figure"]],
        "coverage": [c["drawing"] for c in shown["coverage"]],
        "residuals": [f for r in shown["residuals"] for f in r["figures"]],
    }
    for path in paths:
        parts = [d for d in drawn[path.stem] if d]
        path.write_text(plots.sheet(parts, COLUMNS[path.stem]))


def main(argv=None):
    args = arguments(argv)
    run, images = read_run(args), paper.Images()
    shown, template = content(run), args.template.read_text()
    args.html.write_text(page(template, shown))
    args.pdf.write_bytes(paper.to_pdf(page(template, shown, images), images))
    write_figures(args.figures, shown)
    sizes = args.html.stat().st_size, args.pdf.stat().st_size
    logger.info("%s: %s, %d and %d bytes", run.options["rig"], run.verdict["verdict"], *sizes)


if __name__ == "__main__":
    stage.run(main)
