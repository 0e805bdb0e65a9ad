"""The matrix as a section of docs/faults.md."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten

import numpy as np

from benchmarking.fault_matrix.draw_outcome import DrawOutcome
from benchmarking.fault_matrix.matrix_goals import (
    CONFIDENCE,
    MOVED_SIGMAS,
    WRONG_SIGMAS,
    check_goals,
)
from benchmarking.fault_matrix.row_measurement import RowResult
from benchmarking.page.markdown import (
    format_markdown_table,
    format_mm_deg,
    format_two_digits,
    render_markdown,
)

PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")
MATRIX_HEADING = "## Fault matrix"
MAX_CELL_LETTERS = 110  # of a finding that a cell shows
COLUMNS = (
    "fault", "size", "draws", "pass / warn / fail", "cause named first", "worst error, median",
    "said first", "first advice", "after it", "worst error then",
)  # fmt: skip
CLEAN_COLUMNS = ("rig", "draws", "pass / warn / fail", "worst error, median", "said first")
LEVELS = ("pass", "warn", "fail")


def split_page(text: str) -> tuple[str, str]:
    """Return what comes before the matrix in the page, and the matrix."""
    heading = f"\n{MATRIX_HEADING}\n"
    head, found, matrix = text.partition(heading)
    return head, found + matrix


def write_matrix_section(
    path: Path, clean: list[RowResult], faulty: list[RowResult], n_missing: int
) -> str:
    """Write the matrix into the page, in place of an earlier one; return it.

    n_missing: rows that were not measured.
    """
    section = render_matrix(clean, faulty, n_missing)
    path.write_text(split_page(path.read_text())[0] + section)
    return section


def render_matrix(clean: list[RowResult], faulty: list[RowResult], n_missing: int) -> str:
    """Return the section."""
    return render_markdown(
        PAGE_TEMPLATE,
        heading=MATRIX_HEADING,
        goals=check_goals(clean, faulty),
        clean_table=format_markdown_table(CLEAN_COLUMNS, [_clean_cells(r) for r in clean]),
        table=format_markdown_table(COLUMNS, [_fault_cells(r) for r in faulty]),
        n_rows=len(faulty),
        n_missing=n_missing,
        n_draws=sum(len(r.before) for r in faulty),
        n_clean_draws=sum(len(r.before) for r in clean),
        moved=MOVED_SIGMAS,
        wrong=WRONG_SIGMAS,
        confidence=round(100 * CONFIDENCE),
    )


def _clean_cells(row: RowResult) -> list[str]:
    n = str(len(row.before))
    return [row.size, n, _levels(row.before), _median_error(row.before), _said(row.before)]


def _fault_cells(row: RowResult) -> list[str]:
    if row.stopped:
        return [row.name, row.size, "–", "stopped", "–", "–", _cell(row.stopped), "–", "–", "–"]
    after = [d for d in row.after if d]
    named = f"{sum(d.names(row.causes) for d in row.before)} of {len(row.before)}"
    return [
        row.name,
        row.size,
        str(len(row.before)),
        _levels(row.before),
        named if row.causes and any(d.first for d in row.before) else "–",
        _median_error(row.before),
        _said(row.before),
        _advice(row.before),
        _levels(after) if after else "–",
        _median_error(after),
    ]


def _levels(draws: Sequence[DrawOutcome]) -> str:
    counts = Counter(d.level for d in draws)
    return " / ".join(str(counts[level]) for level in LEVELS)


def _median_error(draws: Sequence[DrawOutcome]) -> str:
    """Return mm, ° and σ of the draw in the middle, of the sensor that errs by most σ."""
    errors = sorted(
        (max(d.errors.values(), key=lambda e: e[2]) for d in draws if d.errors), key=lambda e: e[2]
    )
    if not errors:
        return "–"
    mm, deg, sigmas = errors[int(np.ceil(len(errors) / 2)) - 1]
    return f"{format_mm_deg((mm, deg))}, {format_two_digits(sigmas)} σ"


def _said(draws: Sequence[DrawOutcome]) -> str:
    """Return the first finding of the first draw that has one."""
    return next((_cell(d.first) for d in draws if d.first), "–")


def _cell(text: str) -> str:
    words = shorten(text, MAX_CELL_LETTERS, placeholder=" …")
    return words.replace("|", "\\|").replace("<", "&lt;")


def _advice(draws: Sequence[DrawOutcome]) -> str:
    """Return the key that the first advice changes, of the most draws."""
    keys = Counter(f"`{d.change['key']}`" if d.change else "a person's" for d in draws if d.first)
    return keys.most_common(1)[0][0] if keys else "–"
