"""The section of the benchmark page on damaged and hostile input."""

from collections import Counter
from pathlib import Path

from benchmarking.fuzzing import case_runner
from benchmarking.fuzzing.case_runner import CASE_ENDS, CASE_KINDS, FuzzOutcome
from benchmarking.fuzzing.small_recordings import FUZZ_CONTAINERS
from benchmarking.page.markdown import PageSection, format_markdown_table, render_markdown

MAX_MEMORY_MB = 500  # goal

PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")


def build_fuzz_section(outcomes: list[FuzzOutcome]) -> PageSection:
    """Return the section of the page on damaged input."""
    ends = Counter((o.kind, o.end) for o in outcomes)
    rows = [
        [
            kind,
            str(sum(ends[kind, e] for e in CASE_ENDS)),
            *(str(ends[kind, e]) for e in CASE_ENDS),
        ]
        for kind in CASE_KINDS
    ]
    text = render_markdown(
        PAGE_TEMPLATE,
        count=len(outcomes),
        containers=len(FUZZ_CONTAINERS),
        table=format_markdown_table(("input", "cases", *CASE_ENDS), rows),
        timeout=case_runner.MAX_CASE_SECONDS,
        slowest=max(o.seconds for o in outcomes),
        memory=max(o.peak_memory_mb for o in outcomes),
    )
    return PageSection("Damaged input", text, check_fuzz_goals(outcomes))


def check_fuzz_goals(outcomes: list[FuzzOutcome]) -> list[str]:
    """Return a sentence for each goal that the cases miss."""
    broken = [o for o in outcomes if o.end == "broken"]
    memory = max(o.peak_memory_mb for o in outcomes)
    out = []
    if broken:
        first = broken[0].message.strip().splitlines()[-1]
        out.append(
            f"{len(broken)} cases of damaged input broke, first {broken[0].case_number}: {first}"
        )
    if memory > MAX_MEMORY_MB:
        out.append(f"damaged input took {memory:.0f} MB, goal {MAX_MEMORY_MB} MB")
    return out
