"""Halves of the keypoints of finished runs: NEES of the two poses of each sensor.

Every halving has a seed, and a rig with lidars and cameras is drawn a second time with its lidars
alone. The draws are kept in a file, so that a measurement goes on where it stopped.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import solve
from benchmarking.pipeline_runs import ROOT
from calib.diagnosis.correction_selection import select_confirmed_corrections
from calib.diagnosis.covariance.choice_covariance import choice_covariance
from calib.diagnosis.error_search.supported_corrections import with_requested_corrections
from calib.diagnosis.split_halves import HalfEstimate, compare_halves, estimate_halves
from calib.estimation.estimation_problem import Setup
from calib.estimation.problem_assembly import iteration_limits
from calib.io.atomic_files import write_file
from calib.sensors.lidar.lidar_model import LidarModel

LIDARS_ALONE = ", lidars alone"
LIMITS = {"tolerance_m": 1e-6, "tolerance_rad": 1e-6}  # a hundredth of σ and less


@dataclass(frozen=True)
class SplitHalfDraw:
    """One halving: NEES over its directions of one sensor.

    model: by the model's covariance; clusters: with what placements scatter by; reported: with what
    the choice of corrections moves; is_same_choice: whether both halves chose alike.
    """

    sensor: str
    model: float
    clusters: float
    reported: float
    is_same_choice: bool


@dataclass(frozen=True)
class HalvedRig:
    """A rig whose placements are halved: what solve starts from, and its options.

    start: poses (4, 4) by sensor; wanted: solve.estimate; limits: of estimate_poses.
    """

    setup: Setup
    start: dict[str, np.ndarray]
    wanted: dict[str, Any]
    limits: dict[str, Any]

    def lidars_alone(self) -> "HalvedRig | None":
        """Return the rig without its cameras; None if it has none, or no lidar."""
        models = self.setup.models
        lidars = {n for n, model in models.items() if isinstance(model, LidarModel)}
        if not lidars or len(lidars) == len(models):
            return None
        groups = [g for g in self.setup.groups if g.sensor in lidars]
        seen = sorted({g.placement for g in groups})
        setup = replace(self.setup, groups=groups).at_placements(seen)
        return replace(self, setup=setup, start={n: self.start[n] for n in lidars})


class DrawFile:
    """The draws of all recordings by title and seed, in a JSON file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        stored = json.loads(path.read_text()) if path.exists() else {}
        self._draws = {
            title: {
                int(seed): [SplitHalfDraw(**d) for d in found] for seed, found in by_seed.items()
            }
            for title, by_seed in stored.items()
        }

    def draw(self, title: str, rig: HalvedRig, n_draws: int) -> None:
        """Draw what is missing of the first n_draws halvings of a rig."""
        by_seed = self._draws.setdefault(title, {})
        for seed in range(n_draws):
            if seed not in by_seed:
                by_seed[seed] = draw_halving(rig, seed)
                self._write()

    def by_title(self) -> dict[str, list[SplitHalfDraw]]:
        """Return all draws of each recording."""
        return {
            title: [draw for _, found in sorted(by_seed.items()) for draw in found]
            for title, by_seed in self._draws.items()
        }

    def _write(self) -> None:
        content = {
            title: {seed: [asdict(d) for d in found] for seed, found in by_seed.items()}
            for title, by_seed in self._draws.items()
        }
        write_file(self.path, json.dumps(content, indent=1))


def measure_split_halves(
    folders: Sequence[Path], n_draws: int, draw_file: Path
) -> dict[str, list[SplitHalfDraw]]:
    """Draw halves of every rig of the folders of finished runs; return the draws by title.

    draw_file: holds what was drawn before.
    """
    draws = DrawFile(draw_file.resolve())
    for folder in (f.resolve() for f in folders):
        for words in list_solve_arguments(folder):
            rig, name = read_halved_rig(folder, words)
            title = folder.name if folder.name == name else f"{folder.name}, {name}"
            draws.draw(title, rig, n_draws)
            lidars = rig.lidars_alone()
            if lidars is not None:
                draws.draw(title + LIDARS_ALONE, lidars, n_draws)
    return draws.by_title()


def list_solve_arguments(folder: Path) -> Iterator[list[str]]:
    """Yield the arguments of the solve job of every rig of a folder."""
    snakemake = Path(sys.executable).with_name("snakemake")
    command = [str(snakemake), "-s", str(ROOT / "Snakefile"), "-d", str(folder), "--cores", "1"]
    command += ["-n", "-F", "--printshellcmds", "--quiet", "host"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    for line in re.findall(
        r"^Shell command: .*?(python \S*solve\.py .*)$", run.stdout + run.stderr, re.M
    ):
        yield shlex.split(line.rsplit(" 2> ", 1)[0])[2:]


def read_halved_rig(folder: Path, solve_arguments: Sequence[str]) -> tuple[HalvedRig, str]:
    """Return a rig of a folder by the arguments of its solve job, and its name."""
    here = Path.cwd()
    os.chdir(folder)  # the paths of a job are relative to its folder
    try:
        args = solve.parse_arguments(solve_arguments)
        setup, start, _ = solve.build_rig_setup(args, args.options)
    finally:
        os.chdir(here)
    block = args.options["solve"] | LIMITS
    rig = HalvedRig(setup, start, block["estimate"], iteration_limits(setup, block))
    return rig, args.options["rig"]


def draw_halving(rig: HalvedRig, seed: int) -> list[SplitHalfDraw]:
    """Return the NEES of every sensor that both halves of one seed see."""
    halves = estimate_halves(rig.setup, rig.start, rig.wanted, seed=seed, **rig.limits)
    if halves is None:
        return []
    added = _added_by_choice(rig, halves)
    out = []
    for i, sensor in enumerate(sorted(rig.setup.models)):
        out += _compare(halves, sensor, added[6 * i : 6 * i + 6, 6 * i : 6 * i + 6])
    return out


def _added_by_choice(rig: HalvedRig, halves: tuple[HalfEstimate, HalfEstimate]) -> np.ndarray:
    """Return the covariance that the choice of corrections adds; all placements tell it."""
    if halves[0].adopted == halves[1].adopted:
        return np.zeros((6 * len(rig.setup.models),) * 2)
    whole = select_confirmed_corrections(rig.setup, rig.start, rig.wanted, halves, **rig.limits)[:2]
    requested = with_requested_corrections(rig.setup, rig.wanted)
    return choice_covariance(requested, whole, halves, **rig.limits)


def _compare(
    halves: tuple[HalfEstimate, HalfEstimate], sensor: str, added: np.ndarray
) -> list[SplitHalfDraw]:
    model, clusters, reported = (
        compare_halves(pair, sensor, block)
        for pair, block in (
            ((_by_model(halves[0]), _by_model(halves[1])), None),
            (halves, None),
            (halves, added),
        )
    )
    if model is None or clusters is None or reported is None:
        return []
    a, b, c = (found.nees / found.n_directions for found in (model, clusters, reported))
    is_same_choice = halves[0].adopted == halves[1].adopted
    return [SplitHalfDraw(sensor, a, b, c, is_same_choice)]


def _by_model(half: HalfEstimate) -> HalfEstimate:
    """Return the half with the covariance of its model alone."""
    solved = replace(half.result.solved, added_pose_covariance=None)
    return replace(half, result=replace(half.result, solve_result=solved))
