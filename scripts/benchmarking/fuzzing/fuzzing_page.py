"""Report what became of damaged and hostile input, as Markdown."""

from collections import Counter

from benchmarking.fuzzing import case_runner
from benchmarking.fuzzing.case_runner import CASE_ENDS, CASE_KINDS, FuzzOutcome
from benchmarking.fuzzing.small_recordings import FUZZ_CONTAINERS
from benchmarking.page.markdown import PageSection, format_markdown_table

MAX_MEMORY_MB = 500  # MB

FUZZ_TEMPLATE = """{count} cases drawn from a seed: a small log of poses, clouds and images in one
of {containers} containers, some of whose bytes are wrong or missing (*damaged log*) or whose
messages say what no driver means (*hostile log*); a folder of configs with other values, keys or
bytes (*config*). A log is decoded, gated and read again as crop reads it.

{table}

* *result*: nothing was found to be wrong; *warning*: a result, and words on what is wrong;
  *refused*: one clear error; *broken*: a traceback, a file half written, or no end after
  {most} s. The slowest case took {slowest:.1f} s, and no process more than {memory:.0f} MB."""


def build_fuzz_section(outcomes: list[FuzzOutcome]) -> PageSection:
    """The Section on fuzz.Outcomes."""
    ends = Counter((o.kind, o.end) for o in outcomes)
    rows = [
        [
            kind,
            str(sum(ends[kind, e] for e in CASE_ENDS)),
            *(str(ends[kind, e]) for e in CASE_ENDS),
        ]
        for kind in CASE_KINDS
    ]
    text = FUZZ_TEMPLATE.format(
        count=len(outcomes),
        containers=len(FUZZ_CONTAINERS),
        table=format_markdown_table(("input", "cases", *CASE_ENDS), rows),
        most=case_runner.MAX_CASE_SECONDS,
        slowest=max(o.seconds for o in outcomes),
        memory=max(o.peak_memory_mb for o in outcomes),
    )
    return PageSection("Damaged input", text, check_fuzz_goals(outcomes))


def check_fuzz_goals(outcomes: list[FuzzOutcome]) -> list[str]:
    """Sentences on what does not hold for all cases."""
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
