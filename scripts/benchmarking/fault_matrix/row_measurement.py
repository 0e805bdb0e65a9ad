"""One row of the matrix: a whole run, draws of its noise, and the same after the first advice."""

import argparse
import json
import shutil
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarking.fault_matrix.config_mistakes import write_yaml
from benchmarking.fault_matrix.draw_outcome import DrawOutcome, read_draw_outcome
from benchmarking.fault_matrix.fault_recording import read_yaml, write_fault_recording
from benchmarking.fault_matrix.matrix_faults import MatrixFault
from benchmarking.fault_matrix.noise_redraw import redraw_inputs
from benchmarking.fault_matrix.stage_runner import (
    DRAWN_STAGES,
    StageJob,
    list_stage_jobs,
    run_stages,
    select_jobs,
    working_directory,
)
from calib.io.config_change import ConfigChange
from calib.io.status import InputError


@dataclass(frozen=True)
class RowResult:
    """The draws of a fault, and the same draws after the first advice was followed.

    causes: as of the fault; n_sensors: of the rig; stopped: why the run gave no verdict, "" if it
    did; after: by draw, None where the first finding gives no change for a program.
    """

    name: str
    size: str
    causes: tuple[str, ...]
    n_sensors: int
    stopped: str
    before: list[DrawOutcome]
    after: list[DrawOutcome | None]

    @property
    def title(self) -> str:
        """Fault and size, in words."""
        return f"{self.name}, {self.size}"

    def to_json(self) -> str:
        """Return the row as JSON."""
        return json.dumps(asdict(self), indent=1)

    @classmethod
    def from_json(cls, text: str) -> "RowResult":
        """Return a row that was written by to_json."""
        row = json.loads(text)
        before, after = ([d and DrawOutcome(**d) for d in row[k]] for k in ("before", "after"))
        kept = {k: row[k] for k in ("name", "size", "stopped", "n_sensors")}
        return cls(causes=tuple(row["causes"]), before=before, after=after, **kept)


def measure_row(folder: Path, fault: MatrixFault, n_draws: int) -> RowResult:
    """Measure a fault in a folder of its own."""
    shutil.rmtree(folder, ignore_errors=True)
    args = write_fault_recording(folder, fault)
    n_sensors = len(json.loads((folder / "truth.json").read_text())["sensors"])
    row = partial(RowResult, fault.name, fault.size, fault.causes, n_sensors)
    try:
        jobs = list_stage_jobs(folder)
    except InputError as error:
        return row(str(error), [], [])
    if stopped := run_upstream(folder, jobs, []):
        return row(stopped, [], [])
    before = [draw_outcome(folder, jobs, args, seed) for seed in range(n_draws)]
    after = [_follow_advice(folder, jobs, args, (s, b)) for s, b in enumerate(before)]
    return row("", before, after)


def run_upstream(folder: Path, jobs: list[StageJob], done: list[StageJob]) -> str:
    """Run what comes before the draws, where it changed; return why it stopped, or ""."""
    upstream, ready = (
        [job for job in these if job.stage.__name__ not in DRAWN_STAGES] for these in (jobs, done)
    )
    return run_stages(folder, upstream, ready).stopped


def draw_outcome(
    folder: Path, jobs: list[StageJob], noise: argparse.Namespace, seed: int
) -> DrawOutcome:
    """Return the outcome of a run's keypoints with the noise of one seed."""
    (judge_job,) = select_jobs(jobs, "judge")
    at = judge_job.arguments[judge_job.arguments.index("--verdict") + 1]
    with TemporaryDirectory(dir=folder) as name:
        out = Path(name)
        link_results(folder, out)
        redraw_inputs(folder, out, jobs, noise, seed)
        with working_directory(out):
            for stage in DRAWN_STAGES:
                (job,) = select_jobs(jobs, stage)
                job.stage.main(job.arguments)
        return read_draw_outcome((out / at).parent, folder / "truth.json")


def link_results(folder: Path, out: Path) -> None:
    """Link the results of a run into another folder; what is written there replaces its link."""
    for path in (p for p in (folder / "results").rglob("*") if p.is_file()):
        link = out / path.relative_to(folder)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(path.resolve())


def _follow_advice(
    folder: Path,
    jobs: list[StageJob],
    noise: argparse.Namespace,
    draw: tuple[int, DrawOutcome],
) -> DrawOutcome | None:
    """Return the outcome of a draw, (seed, before), after its first advice was followed."""
    seed, before = draw
    if before.change is None:
        return None
    with TemporaryDirectory(dir=folder.parent) as name:
        changed = Path(name)
        copy_run(folder, changed)
        apply_change(changed, before.change)
        changed_jobs = list_stage_jobs(changed)
        if stopped := run_upstream(changed, changed_jobs, jobs):
            return DrawOutcome("fail", stopped, None, {})
        return draw_outcome(changed, changed_jobs, noise, seed)


def copy_run(folder: Path, out: Path) -> None:
    """Copy config, truth and results of a run; its logs are linked."""
    for name in ("config", "results"):
        shutil.copytree(folder / name, out / name)
    shutil.copy(folder / "truth.json", out)
    (out / "logs").symlink_to((folder / "logs").resolve())


def apply_change(folder: Path, change: ConfigChange) -> None:
    """Write the value of a change into the config of a folder."""
    path = folder / change["file"]
    content = read_yaml(path)
    *blocks, last = change["key"].split(".")
    block = content
    for key in blocks:
        block = block.setdefault(key, {})
    block[last] = json.loads(json.dumps(change["value"]))
    write_yaml(path, content)
