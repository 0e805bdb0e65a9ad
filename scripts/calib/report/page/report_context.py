"""Context of the templates of the report: one function per section with more than one table."""

from typing import Any

from calib.report.data.run_data import ReportRun
from calib.report.figures.correlation_figure import draw_correlation_matrix
from calib.report.figures.coverage_figures import draw_view_coverage
from calib.report.figures.cross_validation_figures import (
    draw_placement_influence,
    draw_sigma_by_placements,
)
from calib.report.figures.message_timing_figure import draw_message_timing
from calib.report.figures.pair_figures import draw_pixel_sigma_maps
from calib.report.figures.residual_figures import draw_residual_figures
from calib.report.figures.residual_split_figures import draw_quantile_plot, draw_rms_by_group
from calib.report.figures.rig_figure import draw_rig
from calib.report.figures.scene_3d_data import scene_3d_json
from calib.report.figures.scene_3d_still import draw_scene_still
from calib.report.figures.session_timeline_figure import draw_session_timeline
from calib.report.overlays.lidar_on_image import draw_lidar_on_images
from calib.report.overlays.overlay_selection import draw_typical_overlay, draw_worst_overlays
from calib.report.sections.coverage import compute_view_coverage, tabulate_view_coverage
from calib.report.sections.cross_validation import (
    tabulate_leave_one_out,
    tabulate_rejected_regions,
    tabulate_session_repeatability,
    tabulate_split_halves,
    tabulate_suspected_errors,
)
from calib.report.sections.diagnostics import tabulate_diagnostics
from calib.report.sections.extrinsics import summarize_sensor_pose
from calib.report.sections.frames import tabulate_frame_losses
from calib.report.sections.observability import tabulate_observability
from calib.report.sections.pairs import TASK_RANGES_M, list_sensor_pairs, tabulate_task_accuracy
from calib.report.sections.parameters import tabulate_nuisance_parameters
from calib.report.sections.provenance import summarize_provenance, tabulate_convergence
from calib.report.sections.recordings import (
    list_log_notes,
    list_session_problems,
    list_unused_topics,
    tabulate_mocap_bodies,
    tabulate_sensor_streams,
)
from calib.report.sections.residual_splits import tabulate_residual_splits
from calib.report.sections.residuals import (
    inliers_by_kind,
    summarize_rejected,
    tabulate_noise,
    tabulate_residual_kinds,
)
from calib.report.sections.verdict import summarize_verdict

Context = dict[str, Any]

# A section is a template workflow/report/sections/<name>.html.j2, an anchor #<name> and a heading.
PAGE_SECTIONS = (
    "verdict",
    "provenance",
    "recordings",
    "frames",
    "coverage",
    "extraction",
    "residuals",
    "extrinsics",
    "parameters",
    "observability",
    "pairs",
    "cross-validation",
    "overlays",
    "diagnostics",
    "appendix",
)


def build_page_context(run: ReportRun) -> Context:
    """Compute all tables and figures of the report, by the names that the templates use."""
    sessions = [build_session_context(run, name) for name in run.sessions]
    losses_by_session = {s["name"]: s["frame_losses"] for s in sessions}
    return {
        "sections": PAGE_SECTIONS,
        "title": run.options["report"]["title"] or run.options["rig"],
        "rig": run.options["rig"],
        "body": run.options["body"],
        "verdict": summarize_verdict(run),
        "provenance": summarize_provenance(run),
        "sessions": sessions,
        "coverage": [build_coverage_context(run, n) for n in run.sensors],
        "residuals": [build_residuals_context(run, n) for n in run.sensors],
        "nuisance_parameters": tabulate_nuisance_parameters(run),
        "noise": tabulate_noise(run),
        "mocap_noise_factor": run.calibration["noise"]["mocap_factor"],
        "observability": tabulate_observability(run),
        "sigma_by_placements": draw_sigma_by_placements(run),
        "diagnostics": tabulate_diagnostics(run, losses_by_session),
        "suspected_errors": tabulate_suspected_errors(run),
        "convergence": tabulate_convergence(run),
        **build_extrinsics_context(run),
        **build_pairs_context(run),
        **build_cross_validation_context(run),
        **build_overlays_context(run),
    }


def build_session_context(run: ReportRun, name: str) -> Context:
    """Compute the sections Recordings and Frames of one session."""
    session = run.sessions[name]
    sensors = {n: run.options["sensors"][n] for n in session.streams}
    return {
        "name": name,
        "streams": tabulate_sensor_streams(session.audit, session.frames, sensors),
        "bodies": tabulate_mocap_bodies(session.audit, run.options),
        "log_notes": list_log_notes(session.audit, session.mocap_notes),
        "unused_topics": list_unused_topics(session.audit, sensors),
        "problems": list_session_problems(session),
        "message_timing_figure": draw_message_timing(run, name),
        "frame_losses": tabulate_frame_losses(run, name),
        "timeline_figure": draw_session_timeline(run, name),
    }


def build_coverage_context(run: ReportRun, name: str) -> Context:
    """Compute the section Coverage of one sensor."""
    coverage = compute_view_coverage(run, name)
    return {
        "row": tabulate_view_coverage(run, name, coverage),
        "figure": draw_view_coverage(run, name, coverage) if coverage else None,
    }


def build_residuals_context(run: ReportRun, name: str) -> Context:
    """Compute the section Residuals of one sensor."""
    splits = tabulate_residual_splits(run, name)
    figures = [
        *draw_residual_figures(run, name),
        draw_quantile_plot(name, inliers_by_kind(run, name)),
        draw_rms_by_group(name, splits),
    ]
    return {
        "name": name,
        "kind": run.sensors[name]["kind"],
        "rows": tabulate_residual_kinds(run, name),
        "rejected": summarize_rejected(run, name),
        "rejected_by_region": tabulate_rejected_regions(run, name),
        "splits": splits,
        "figures": [f for f in figures if f],
    }


def build_extrinsics_context(run: ReportRun) -> Context:
    """Compute the section Extrinsics."""
    cards = [summarize_sensor_pose(run, n) for n in run.sensors]
    return {
        "extrinsics": cards,
        "has_truth": any(card["has_pose"] and card["error"] for card in cards),
        "unknown_truth_sensors": run.unknown_truth_sensors,
        "rig_figure": draw_rig(run),
        "scene_3d": scene_3d_json(run),
        "scene_still": draw_scene_still(run),
        "correlation_figure": draw_correlation_matrix(run),
    }


def build_pairs_context(run: ReportRun) -> Context:
    """Compute the section Pairs."""
    pairs = list_sensor_pairs(run)
    return {
        "sensor_pairs": pairs,
        "task_accuracy": tabulate_task_accuracy(run, pairs),
        "task_ranges": [f"{r:g}" for r in TASK_RANGES_M],
        "pair_figures": draw_pixel_sigma_maps(run, pairs),
    }


def build_cross_validation_context(run: ReportRun) -> Context:
    """Compute the section Cross-validation."""
    figures = [draw_placement_influence(run, n) for n in run.sensors]
    return {
        "leave_one_out": tabulate_leave_one_out(run),
        "influence_figures": [figure for figure in figures if figure],
        "split_halves": tabulate_split_halves(run),
        "session_repeatability": tabulate_session_repeatability(run),
    }


def build_overlays_context(run: ReportRun) -> Context:
    """Compute the sections Extraction and Overlays."""
    kinds = {n: s["kind"] for n, s in run.sensors.items()}
    return {
        "worst_overlays": [
            {"name": n, "kind": kind, "views": draw_worst_overlays(run, n)}
            for n, kind in kinds.items()
        ],
        "typical_overlays": [{"name": n, "views": draw_typical_overlay(run, n)} for n in kinds],
        "lidar_on_image_overlays": draw_lidar_on_images(run),
    }
