"""What a person must know of a calibration, as one page that opens anywhere, and on paper.

Reads   calibration.json, verdict.json, residuals.parquet, iterations.parquet; log.json,
        frames.parquet and placements.parquet of all sessions; guess.json, views.parquet and
        keypoints.parquet of all their sensors; the page's templates
Writes  report.html, complete in itself: figures, images, style and scripts inside; report.pdf, the
        same for paper; figures/*.svg, the main figures with all sensors
Decides nothing; what could not be done is shown with its reason, found, expected and remedy.
"""

from plotly.offline import get_plotlyjs

from calib.io.atomic_files import write_file
from calib.io.stage_cli import StageArgumentParser, logger, run_stage
from calib.report.data.run_loader import read_report_run
from calib.report.figures.correlation_figure import draw_correlation_matrix
from calib.report.figures.coverage_figures import draw_view_coverage
from calib.report.figures.cross_validation_figures import (
    draw_placement_influence,
    draw_sigma_by_placements,
)
from calib.report.figures.message_timing_figure import draw_message_timing
from calib.report.figures.residual_figures import draw_residual_figures, draw_session_timeline
from calib.report.figures.residual_split_figures import draw_quantile_plot, draw_rms_by_group
from calib.report.figures.rig_figure import draw_rig
from calib.report.figures.scene_3d_data import scene_3d_json
from calib.report.figures.scene_3d_still import draw_scene_still
from calib.report.figures.svg_plots import tile_drawings
from calib.report.figures.task_accuracy_figures import draw_pixel_sigma_maps
from calib.report.overlays.lidar_on_image import draw_lidar_on_images
from calib.report.overlays.overlay_selection import draw_typical_overlay, draw_worst_overlays
from calib.report.page.html_page import render_template
from calib.report.page.pdf_page import PdfImages, encode_pdf
from calib.report.sections.cross_validation import (
    tabulate_leave_one_out,
    tabulate_rejected_regions,
    tabulate_session_repeatability,
    tabulate_suspected_errors,
)
from calib.report.sections.diagnostics import tabulate_diagnostics
from calib.report.sections.extrinsics import list_sensor_pairs, summarize_sensor_pose
from calib.report.sections.frame_losses import tabulate_frame_losses
from calib.report.sections.nuisance_parameters import tabulate_nuisance_parameters
from calib.report.sections.principal_directions import tabulate_observability
from calib.report.sections.provenance import summarize_provenance, tabulate_convergence
from calib.report.sections.recording_audit import (
    list_log_notes,
    list_session_problems,
    list_unused_topics,
    tabulate_mocap_bodies,
    tabulate_sensor_streams,
)
from calib.report.sections.residual_splits import tabulate_residual_splits
from calib.report.sections.residual_tables import (
    residuals_by_kind,
    select_inlier_rows,
    summarize_rejected,
    tabulate_noise,
    tabulate_residual_kinds,
)
from calib.report.sections.task_accuracy import TASK_RANGES_M, tabulate_task_accuracy
from calib.report.sections.verdict_summary import summarize_verdict
from calib.report.sections.view_coverage import compute_view_coverage, tabulate_view_coverage

FIGURE_COLUMNS = {"extrinsics": 1, "coverage": 1, "residuals": 3}  # of the figures that are written
# Templates by name, and what they are headed by.
PAGE_SECTIONS = (
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


def build_page_context(run):
    """What the templates print, by section."""
    sessions = [build_session_context(run, name) for name in run.sessions]
    funnels = {s["name"]: s["funnel"] for s in sessions}
    shown = {
        "sections": PAGE_SECTIONS,
        "title": run.options["report"]["title"] or run.options["rig"],
        "rig": run.options["rig"],
        "body": run.options["body"],
        "verdict": summarize_verdict(run),
        "provenance": summarize_provenance(run),
        "sessions": sessions,
        "coverage": [build_coverage_context(run, n) for n in run.sensors],
        "gallery": [
            {"name": n, "kind": s["kind"], "views": draw_worst_overlays(run, n)}
            for n, s in run.sensors.items()
        ],
        "residuals": [build_residuals_context(run, n) for n in run.sensors],
        "unknowns": tabulate_nuisance_parameters(run),
        "noise": tabulate_noise(run),
        "mocap_factor": run.calibration["noise"]["mocap_factor"],
        "observability": tabulate_observability(run),
        "by_count": draw_sigma_by_placements(run),
        "overlays": draw_lidar_on_images(run),
        "typical": [
            {"name": n, "kind": s["kind"], "views": draw_typical_overlay(run, n)}
            for n, s in run.sensors.items()
        ],
        "diagnostics": tabulate_diagnostics(run, funnels),
        "suspicions": tabulate_suspected_errors(run),
        "convergence": tabulate_convergence(run),
    }
    return (
        shown
        | build_extrinsics_context(run)
        | build_pairs_context(run)
        | build_validation_context(run)
    )


def build_extrinsics_context(run):
    """Extrinsics, before and after."""
    told = [summarize_sensor_pose(run, n) for n in run.sensors]
    return {
        "extrinsics": told,
        "known": any(e["solved"] and e["error"] for e in told),
        "strangers": run.unknown_truth_sensors,
        "rig_figure": draw_rig(run),
        "scene": scene_3d_json(run),
        "scene_figure": draw_scene_still(run),
        "correlation": draw_correlation_matrix(run),
    }


def build_pairs_context(run):
    """Sensor to sensor, in poses and in what they mean for a task."""
    pairs = list_sensor_pairs(run)
    return {
        "between": pairs,
        "pairs": tabulate_task_accuracy(run, pairs),
        "ranges": [f"{r:g}" for r in TASK_RANGES_M],
        "task_figures": draw_pixel_sigma_maps(run, pairs),
    }


def build_validation_context(run):
    """Placements left out, and sessions by themselves."""
    alone = [draw_placement_influence(run, n) for n in run.sensors]
    return {
        "held_out": tabulate_leave_one_out(run),
        "influences": [drawing for drawing in alone if drawing],
        "by_session": tabulate_session_repeatability(run),
    }


def build_coverage_context(run, name):
    """Coverage of one sensor."""
    found = compute_view_coverage(run, name)
    drawing = draw_view_coverage(run, name, found) if found else None
    return {"row": tabulate_view_coverage(run, name, found), "drawing": drawing}


def build_residuals_context(run, name):
    """Residuals of one sensor."""
    rows = tabulate_residual_splits(run, name)
    kinds = {k: select_inlier_rows(c) for k, c in residuals_by_kind(run, name).items()}
    kinds = {k: c for k, c in kinds.items() if len(c["weight"])}
    more = (
        draw_quantile_plot(name, kinds),
        draw_rms_by_group(name, rows),
    )
    return {
        "name": name,
        "kind": run.sensors[name]["kind"],
        "rows": tabulate_residual_kinds(run, name),
        "rejected": summarize_rejected(run, name),
        "left_out": tabulate_rejected_regions(run, name),
        "splits": rows,
        "figures": draw_residual_figures(run, name) + [f for f in more if f],
    }


def build_session_context(run, name):
    """Audit and funnel of one session."""
    return {
        "name": name,
        "streams": tabulate_sensor_streams(run, name),
        "bodies": tabulate_mocap_bodies(run, name),
        "heard": list_log_notes(run, name),
        "unused": list_unused_topics(run, name),
        "problems": list_session_problems(run, name),
        "intake": draw_message_timing(run, name),
        "funnel": tabulate_frame_losses(run, name),
        "timeline": draw_session_timeline(run, name),
    }


def parse_report_arguments(argv):
    """The parsed command line."""
    parser = StageArgumentParser(__doc__)
    parser.add_path("--calibration", "calibration.json")
    parser.add_path("--verdict", "verdict.json")
    parser.add_path("--residuals", "residuals.parquet")
    parser.add_path("--iterations", "iterations.parquet")
    parser.add_paths("--audits", "log.json of each session")
    parser.add_paths("--frames", "frames.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_paths("--guesses", "guess.json of each session and sensor")
    parser.add_paths("--views", "views.parquet of each session and sensor")
    parser.add_paths("--keypoints", "keypoints.parquet of each session and sensor")
    parser.add_paths("--templates", "Jinja2 templates, style and scripts of the page")
    parser.add_path("--html", "report.html to write")
    parser.add_path("--pdf", "report.pdf to write")
    parser.add_paths("--figures", "figures to write, each named by its content")
    return parser.parse_args(argv)


def render_html_report(templates, context):
    """report.html."""
    more = {"on_paper": False, "plotly": get_plotlyjs()}
    return render_template(templates, "report.html.j2", context | more)


def render_pdf_report(templates, context):
    """report.pdf, of a page that finds its images by name."""
    images = PdfImages()
    more = {"on_paper": True, "plotly": ""}
    page = render_template(templates, "report.html.j2", context | more, images.add_drawing)
    return encode_pdf(page, images)


def write_figure_files(paths, context):
    """The main figures, each with all sensors, as files."""
    drawn = {
        "extrinsics": [context["rig_figure"]],
        "coverage": [c["drawing"] for c in context["coverage"]],
        "residuals": [f for r in context["residuals"] for f in r["figures"]],
    }
    for path in paths:
        parts = [d for d in drawn[path.stem] if d]
        write_file(path, tile_drawings(parts, FIGURE_COLUMNS[path.stem]))


def main(argv=None):
    args = parse_report_arguments(argv)
    run = read_report_run(args)
    shown = build_page_context(run)
    write_file(args.html, render_html_report(args.templates, shown))
    write_file(args.pdf, render_pdf_report(args.templates, shown))
    write_figure_files(args.figures, shown)
    sizes = args.html.stat().st_size, args.pdf.stat().st_size
    logger.info("%s: %s, %d and %d bytes", run.options["rig"], run.verdict["verdict"], *sizes)


if __name__ == "__main__":
    run_stage(main)
