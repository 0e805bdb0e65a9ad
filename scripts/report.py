"""Write the report of a calibration: a page that needs no other files, a PDF, and figures.

Reads   calibration.json, verdict.json, residuals.parquet, iterations.parquet; log.json,
        frames.parquet and placements.parquet of each session; guess.json, views.parquet and
        keypoints.parquet of each session and sensor; the templates of the page
Writes  report.html with all figures, images, style and scripts inside; report.pdf, the same on
        paper; figures/*.svg, the main figures with all sensors
Decides nothing; what failed is shown with its reason, found, expected and remedy.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from plotly.offline import get_plotlyjs

from calib.io.atomic_files import write_file
from calib.io.stage_cli import StageArgumentParser, logger, run_stage
from calib.report.data.run_loader import read_report_run
from calib.report.figures.figure_encoding import tile_drawings
from calib.report.page.html_page import render_template
from calib.report.page.pdf_page import PdfImages, encode_pdf
from calib.report.page.report_context import Context, build_page_context

FIGURE_COLUMNS = {"extrinsics": 1, "coverage": 1, "residuals": 3}  # of figures/<name>.svg


def parse_report_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
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


def render_html_report(templates: Iterable[Path], context: Context) -> str:
    """Render report.html."""
    screen = {"is_paper": False, "plotly": get_plotlyjs()}
    return render_template(templates, "report.html.j2", context | screen)


def render_pdf_report(templates: Iterable[Path], context: Context) -> bytes:
    """Render report.pdf."""
    images = PdfImages()
    paper = {"is_paper": True, "plotly": ""}
    page = render_template(templates, "report.html.j2", context | paper, images.add_drawing)
    return encode_pdf(page, images)


def write_figure_files(paths: Iterable[Path], context: Context) -> None:
    """Write the main figures, each with all sensors."""
    drawings = {
        "extrinsics": [context["rig_figure"]],
        "coverage": [row["figure"] for row in context["coverage"]],
        "residuals": [figure for row in context["residuals"] for figure in row["figures"]],
    }
    for path in paths:
        figures = [d for d in drawings[path.stem] if d]
        write_file(path, tile_drawings(figures, FIGURE_COLUMNS[path.stem]))


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = parse_report_arguments(argv)
    run = read_report_run(args)
    context = build_page_context(run)
    write_file(args.html, render_html_report(args.templates, context))
    write_file(args.pdf, render_pdf_report(args.templates, context))
    write_figure_files(args.figures, context)
    sizes = args.html.stat().st_size, args.pdf.stat().st_size
    logger.info("%s: %s, %d and %d bytes", run.options["rig"], run.verdict["verdict"], *sizes)


if __name__ == "__main__":
    run_stage(main)
