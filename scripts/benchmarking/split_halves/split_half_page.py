"""Are the σ of results true? Measures the section "Split halves" of docs/benchmark.md.

Run    PYTHONPATH=scripts python -m benchmarking.split_halves.split_half_page WORK
Does   simulates rooms, calibrates them, draws halves of their placements and of those of
       --recordings, folders of finished runs, and puts the section into the page.
       WORK keeps recordings and draws: a second run goes on where the first one stopped.
       Remove it to measure anew
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarking.page.markdown import (
    PageSection,
    format_markdown_table,
    format_two_digits,
    render_markdown,
)
from benchmarking.pipeline_runs import ROOT, make_with_snakemake, simulate_log
from benchmarking.room_rigs import ROOM_RIGS
from benchmarking.split_halves.known_errors import (
    RATIO_GOAL,
    KnownErrorOutcome,
    check_known_error_goals,
    measure_known_errors,
)
from benchmarking.split_halves.split_half_draws import SplitHalfDraw, measure_split_halves

PAGE_TEMPLATE = Path(__file__).with_suffix(".md.j2")
TITLE = "Split halves"
NEES_GOAL = (0.5, 1.5)  # of the mean over the halvings of a recording
HALVED_RIGS = {"demo": "--rig demo", **ROOM_RIGS}  # arguments of simulate.py by folder
# What the same halvings gave when corrections came one after the other, and σ from the noise model
# alone: acfr_vlp16 with 20 against 19 placements.
EARLIER_NEES = {
    ("acfr_vlp16", "velodyne"): 7.3,
    ("acfr_vlp16", "camera"): 0.5,
    ("acfr_vlp16, lidars alone", "velodyne"): 27.0,
    ("rosi_charuco", "camera"): 0.95,
}
HALF_COLUMNS = (
    "recording", "sensor", "halves", "NEES, model alone", "NEES, with placements", "NEES, reported",
    "median", "chose alike", "NEES before",
)  # fmt: skip
ERROR_COLUMNS = ("error", "sensor", "recordings", "σ / σ if known", "worst direction", "NEES")


def simulate_rooms(work: Path, rooms: Sequence[str], has_kept_logs: bool) -> list[Path]:
    """Simulate and calibrate rooms of HALVED_RIGS; return their folders."""
    folders = []
    for title in rooms:
        folder, words = work / room_folder(title), HALVED_RIGS[title].split()
        simulate_log(folder, words, has_kept_logs)
        rig = words[words.index("--rig") + 1]
        make_with_snakemake(folder, [f"results/{rig}/solution.json"], 1)
        folders.append(folder)
    return folders


def room_folder(title: str) -> str:
    """Return the name of the folder of a room."""
    return title.replace(",", "").replace(" ", "_")


def _format_folders(folders: Iterable[str]) -> str:
    return "; ".join(name.replace("_", " ") for name in folders) or "none"


def format_split_half_table(draws_by_title: dict[str, list[SplitHalfDraw]]) -> str:
    """Return the table of NEES over degrees of freedom, by recording and sensor."""
    rows = []
    for title, draws in draws_by_title.items():
        for sensor in sorted({d.sensor for d in draws}):
            own = [d for d in draws if d.sensor == sensor]
            before = EARLIER_NEES.get((_short_title(title), sensor))
            cells = [*_format_sensor_cells(own), format_two_digits(before)]
            rows.append([title.replace("_", " "), sensor, str(len(own)), *cells])
    return format_markdown_table(HALF_COLUMNS, rows)


def _short_title(title: str) -> str:
    """Return a title without its rig."""
    folder, *parts = title.split(", ")
    return ", ".join([folder, *(p for p in parts if p == "lidars alone")])


def _format_sensor_cells(draws: list[SplitHalfDraw]) -> list[str]:
    means = [np.mean([getattr(d, k) for d in draws]) for k in ("model", "clusters", "reported")]
    median = np.median([d.reported for d in draws])
    alike = sum(d.is_same_choice for d in draws)
    return [*(format_two_digits(float(v)) for v in (*means, median)), f"{alike} of {len(draws)}"]


def format_known_error_table(outcomes: Sequence[KnownErrorOutcome]) -> str:
    """Return the table of σ with errors over σ of a fit that knows them."""
    rows = []
    for title, sensor in dict.fromkeys((o.title, o.sensor) for o in outcomes):
        own = [o for o in outcomes if (o.title, o.sensor) == (title, sensor)]
        values = [float(np.mean([getattr(o, k) for o in own])) for k in ("ratio", "worst", "nees")]
        rows.append([title, sensor, str(len(own)), *map(format_two_digits, values)])
    return format_markdown_table(ERROR_COLUMNS, rows)


def build_split_half_section(
    draws_by_title: dict[str, list[SplitHalfDraw]], outcomes: Sequence[KnownErrorOutcome]
) -> PageSection:
    """Return the section of the page on split halves and known errors."""
    folders = list(dict.fromkeys(title.split(", ")[0] for title in draws_by_title))
    rooms = {room_folder(title) for title in HALVED_RIGS}
    missed = [*check_split_half_goals(draws_by_title), *check_known_error_goals(outcomes)]
    text = render_markdown(
        PAGE_TEMPLATE,
        table=format_split_half_table(draws_by_title),
        errors=format_known_error_table(outcomes) if outcomes else "",
        real=_format_folders(f for f in folders if f not in rooms),
        simulated=_format_folders(f for f in folders if f in rooms),
        low=NEES_GOAL[0],
        high=NEES_GOAL[1],
        most=RATIO_GOAL,
        missed=missed,
    )
    return PageSection(TITLE, text, [])  # the section tells what it misses


def check_split_half_goals(draws_by_title: dict[str, list[SplitHalfDraw]]) -> list[str]:
    """Return a sentence for each sensor whose mean NEES misses the goal."""
    out = []
    for title, draws in draws_by_title.items():
        for sensor in sorted({d.sensor for d in draws}):
            mean = float(np.mean([d.reported for d in draws if d.sensor == sensor]))
            if not NEES_GOAL[0] <= mean <= NEES_GOAL[1]:
                goal = f"{NEES_GOAL[0]:g} to {NEES_GOAL[1]:g}"
                out.append(f"split halves of {title}: {sensor} has {mean:.2g}, goal {goal}")
    return out


def measure_section(
    work: Path,
    recordings: Sequence[Path],
    rooms: Sequence[str] = tuple(HALVED_RIGS),
    *,
    draws: int,
    seeds: int,
) -> PageSection:
    """Measure the section in a folder, which keeps recordings and draws.

    recordings: folders of finished runs; seeds: recordings of each known error.
    """
    folders = [*recordings, *simulate_rooms(work, rooms, has_kept_logs=True)]
    halves = measure_split_halves(folders, draws, work / "split_halves.json")
    return build_split_half_section(halves, measure_known_errors(work, seeds))


def replace_section(page: str, section: PageSection) -> str:
    """Return a page with a section instead of the one of its title, or before the last one."""
    parts = page.split("\n## ")
    titles = [part.partition("\n")[0] for part in parts]
    new = f"{section.title}\n\n{section.text.strip()}\n"
    if section.title in titles:
        parts[titles.index(section.title)] = new
    else:
        parts.insert(len(parts) - 1, new)
    return "\n## ".join(parts)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure the section and put it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", type=Path, metavar="WORK")
    parser.add_argument("--recordings", type=Path, nargs="*", default=[], metavar="FOLDER")
    parser.add_argument("--draws", type=int, default=30, help="halvings of each rig")
    parser.add_argument("--seeds", type=int, default=3, help="recordings of each known error")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "benchmark.md")
    args = parser.parse_args(argv)
    work = args.work.resolve()
    section = measure_section(work, args.recordings, draws=args.draws, seeds=args.seeds)
    args.page.write_text(replace_section(args.page.read_text(), section))


if __name__ == "__main__":
    main()
