"""What became of damaged and hostile input, as Markdown."""

from collections import Counter

from benchmarking.fuzzing import run_cases, small_recordings
from benchmarking.page.markdown import Section, table

MOST_MEMORY = 500  # MB

WORDS = """{count} cases drawn from a seed: a small log of poses, clouds and images in one of
{containers} containers, some of whose bytes are wrong or missing (*damaged log*) or whose messages
say what no driver means (*hostile log*); a folder of configs with other values, keys or bytes
(*config*). A log is decoded, gated and read again as crop reads it.

{table}

* *result*: nothing was found to be wrong; *warning*: a result, and words on what is wrong;
  *refused*: one clear error; *broken*: a traceback, a file half written, or no end after
  {most} s. The slowest case took {slowest:.1f} s, and no process more than {memory:.0f} MB."""


def section(outcomes):
    """The Section on fuzz.Outcomes."""
    ends = Counter((o.kind, o.end) for o in outcomes)
    rows = [
        [
            kind,
            str(sum(ends[kind, e] for e in run_cases.ENDS)),
            *(str(ends[kind, e]) for e in run_cases.ENDS),
        ]
        for kind in run_cases.KINDS
    ]
    text = WORDS.format(
        count=len(outcomes),
        containers=len(small_recordings.CONTAINERS),
        table=table(("input", "cases", *run_cases.ENDS), rows),
        most=run_cases.MOST_SECONDS,
        slowest=max(o.seconds for o in outcomes),
        memory=max(o.memory for o in outcomes),
    )
    return Section("Damaged input", text, short_of(outcomes))


def short_of(outcomes):
    """Sentences on what does not hold for all cases."""
    broken = [o for o in outcomes if o.end == "broken"]
    memory = max(o.memory for o in outcomes)
    out = []
    if broken:
        first = broken[0].words.strip().splitlines()[-1]
        out.append(f"{len(broken)} cases of damaged input broke, first {broken[0].number}: {first}")
    if memory > MOST_MEMORY:
        out.append(f"damaged input took {memory:.0f} MB, goal {MOST_MEMORY} MB")
    return out
