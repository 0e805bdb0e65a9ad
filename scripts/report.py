"""What a person must know of a calibration, as one page that opens anywhere, and on paper.

Reads   calibration.json, verdict.json, residuals.parquet, iterations.parquet; log.json,
        frames.parquet and placements.parquet of all sessions; guess.json, views.parquet and
        keypoints.parquet of all their sensors; the page's templates
Writes  report.html, complete in itself: figures, images, style and scripts inside; report.pdf, the
        same for paper; figures/*.svg, the main figures with all sensors
Decides nothing; what could not be done is shown with its reason, found, expected and remedy.
"""

from plotly.offline import get_plotlyjs

from calib.io import atomic_files, stage_cli
from calib.io.stage_cli import logger
from calib.report.data.load_run import read_run
from calib.report.figures import (
    correlation_figure,
    coverage_figures,
    cross_validation_figures,
    message_timing_figure,
    residual_figures,
    residual_split_figures,
    rig_figure,
    scene_3d_data,
    scene_3d_still,
    svg_plots,
    task_accuracy_figures,
)
from calib.report.overlays import lidar_on_image, overlay_selection
from calib.report.page import html_page, pdf_page
from calib.report.sections import (
    cross_validation,
    diagnostics,
    extrinsics,
    frame_losses,
    nuisance_parameters,
    principal_directions,
    provenance,
    recording_audit,
    residual_splits,
    residual_tables,
    task_accuracy,
    verdict_summary,
    view_coverage,
)

COLUMNS = {"extrinsics": 1, "coverage": 1, "residuals": 3}  # of the figures that are written
# Templates by name, and what they are headed by.
SECTIONS = (
    ("verdict", "Verdict"),
    ("provenance", "Provenance"),
    ("intake", "Intake"),
    ("funnel", "From recording to solve"),
    ("coverage", "Coverage"),
    ("gallery", "Extraction"),
    ("residuals", "Residuals"),
    ("extrinsics", "Extrinsics"),
    ("nuisance", "Clocks, mounts, noise"),
    ("observability", "Observability"),
    ("between", "Sensor to sensor"),
    ("validation", "Cross-validation"),
    ("overlays", "Overlays"),
    ("diagnostics", "Diagnostics"),
    ("appendix", "Appendix"),
)


def content(run):
    """What the templates print, by section."""
    sessions = [session(run, name) for name in run.sessions]
    funnels = {s["name"]: s["funnel"] for s in sessions}
    shown = {
        "sections": SECTIONS,
        "title": run.options["report"]["title"] or run.options["rig"],
        "rig": run.options["rig"],
        "body": run.options["body"],
        "verdict": verdict_summary.verdict(run),
        "provenance": provenance.provenance(run),
        "sessions": sessions,
        "coverage": [covered(run, n) for n in run.sensors],
        "gallery": [
            {"name": n, "kind": s["kind"], "views": overlay_selection.of_sensor(run, n)}
            for n, s in run.sensors.items()
        ],
        "residuals": [left_over(run, n) for n in run.sensors],
        "unknowns": nuisance_parameters.other_unknowns(run),
        "noise": residual_tables.noise(run),
        "mocap_factor": run.calibration["noise"]["mocap_factor"],
        "observability": principal_directions.rows(run),
        "by_count": cross_validation_figures.sigma_by_count(run),
        "overlays": lidar_on_image.draw(run),
        "typical": [
            {"name": n, "kind": s["kind"], "views": overlay_selection.typical(run, n)}
            for n, s in run.sensors.items()
        ],
        "diagnostics": diagnostics.rows(run, funnels),
        "suspicions": cross_validation.suspicions(run),
        "convergence": provenance.convergence(run),
    }
    return shown | poses(run) | between(run) | validation(run)


def poses(run):
    """Extrinsics, before and after."""
    told = [extrinsics.of_sensor(run, n) for n in run.sensors]
    return {
        "extrinsics": told,
        "known": any(e["solved"] and e["error"] for e in told),
        "strangers": run.strangers,
        "rig_figure": rig_figure.draw(run),
        "scene": scene_3d_data.content(run),
        "scene_figure": scene_3d_still.draw(run),
        "correlation": correlation_figure.draw(run),
    }


def between(run):
    """Sensor to sensor, in poses and in what they mean for a task."""
    pairs = extrinsics.between(run)
    return {
        "between": pairs,
        "pairs": task_accuracy.rows(run, pairs),
        "ranges": [f"{r:g}" for r in task_accuracy.RANGES],
        "task_figures": task_accuracy_figures.draw(run, pairs),
    }


def validation(run):
    """Placements left out, and sessions by themselves."""
    alone = [cross_validation_figures.influence(run, n) for n in run.sensors]
    return {
        "held_out": cross_validation.held_out(run),
        "influences": [drawing for drawing in alone if drawing],
        "by_session": cross_validation.sessions(run),
    }


def covered(run, name):
    """Coverage of one sensor."""
    found = view_coverage.of_sensor(run, name)
    drawing = coverage_figures.draw(run, name, found) if found else None
    return {"row": view_coverage.row(run, name, found), "drawing": drawing}


def left_over(run, name):
    """Residuals of one sensor."""
    rows = residual_splits.of_sensor(run, name)
    kinds = {k: residual_tables.members(c) for k, c in residual_tables.of(run, name).items()}
    kinds = {k: c for k, c in kinds.items() if len(c["weight"])}
    more = (
        residual_split_figures.quantiles(name, kinds),
        residual_split_figures.by_group(name, rows),
    )
    return {
        "name": name,
        "kind": run.sensors[name]["kind"],
        "rows": residual_tables.overview(run, name),
        "rejected": residual_tables.rejected(run, name),
        "left_out": cross_validation.left_out(run, name),
        "splits": rows,
        "figures": residual_figures.of_sensor(run, name) + [f for f in more if f],
    }


def session(run, name):
    """Audit and funnel of one session."""
    return {
        "name": name,
        "streams": recording_audit.streams(run, name),
        "bodies": recording_audit.bodies(run, name),
        "heard": recording_audit.heard(run, name),
        "unused": recording_audit.unused_topics(run, name),
        "problems": recording_audit.problems(run, name),
        "intake": message_timing_figure.draw(run, name),
        "funnel": frame_losses.table(run, name),
        "timeline": residual_figures.timeline(run, name),
    }


def arguments(argv):
    """The parsed command line."""
    return stage_cli.parser(
        __doc__,
        calibration="input",
        verdict="input",
        residuals="input",
        iterations="input",
        audits="*input log.json, one per session",
        frames="*input, one per session",
        placements="*input, one per session",
        guesses="*input, one per session and sensor",
        views="*input, one per session and sensor",
        keypoints="*input, one per session and sensor",
        templates="*input, Jinja2, style and scripts of the page",
        html="output",
        pdf="output",
        figures="*output, named after what they show",
        options="slice of the config",
    ).parse_args(argv)


def on_screen(templates, shown):
    """report.html."""
    more = {"on_paper": False, "plotly": get_plotlyjs()}
    return html_page.render(templates, "report.html.j2", shown | more)


def on_paper(templates, shown):
    """report.pdf, of a page that finds its images by name."""
    images = pdf_page.Images()
    more = {"on_paper": True, "plotly": ""}
    page = html_page.render(templates, "report.html.j2", shown | more, images.tag)
    return pdf_page.to_pdf(page, images)


def write_figures(paths, shown):
    """The main figures, each with all sensors, as files."""
    drawn = {
        "extrinsics": [shown["rig_figure"]],
        "coverage": [c["drawing"] for c in shown["coverage"]],
        "residuals": [f for r in shown["residuals"] for f in r["figures"]],
    }
    for path in paths:
        parts = [d for d in drawn[path.stem] if d]
        atomic_files.write(path, svg_plots.sheet(parts, COLUMNS[path.stem]))


def main(argv=None):
    args = arguments(argv)
    run = read_run(args)
    shown = content(run)
    atomic_files.write(args.html, on_screen(args.templates, shown))
    atomic_files.write(args.pdf, on_paper(args.templates, shown))
    write_figures(args.figures, shown)
    sizes = args.html.stat().st_size, args.pdf.stat().st_size
    logger.info("%s: %s, %d and %d bytes", run.options["rig"], run.verdict["verdict"], *sizes)


if __name__ == "__main__":
    stage_cli.run(main)
