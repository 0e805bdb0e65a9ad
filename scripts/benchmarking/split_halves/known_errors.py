"""σ of recordings with errors of sensors and boards, over σ of a fit that knows the error.

An error of known size takes no information: who knows it has the σ of the same recording without
it. The simulator draws the same rig, placements and noise with and without.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarking.pipeline_runs import make_with_snakemake, simulate_log
from benchmarking.room_rigs import ROOM_NOISE
from calib.geometry.se3 import invert_pose, se3_log

RECORDING = f"--rig sim --placements 12 {ROOM_NOISE}"
KNOWN_ERRORS = {  # title: arguments of simulate.py
    "beams that err by 15 mm": "--beam-bias-m 0.015",
    "board bowed by 4 mm": "--board-bow-x-m 0.004",
    "board off by 6 mm, 0.6°": "--mount-m 0.006 --mount-deg 0.6",
}
RATIO_GOAL = 1.3  # of σ over that of a fit that knows the error


class KnownErrorOutcome(NamedTuple):
    """One sensor of one recording with an error.

    ratio: σ over that of a fit that knows the error, rms over directions; worst: of a direction;
    nees: of the error of the pose, per direction.
    """

    title: str
    sensor: str
    ratio: float
    worst: float
    nees: float


def measure_known_errors(work: Path, n_seeds: int) -> list[KnownErrorOutcome]:
    """Simulate and calibrate recordings with and without errors; return what σ comes to."""
    out = []
    for seed in range(1, n_seeds + 1):
        knows = _calibrate(work / f"known-none-s{seed}", f"{RECORDING} --seed {seed}".split())
        for number, (title, arguments) in enumerate(KNOWN_ERRORS.items()):
            words = f"{RECORDING} --seed {seed} {arguments}".split()
            found = _calibrate(work / f"known-{number}-s{seed}", words)
            truth = _read_truth(work / f"known-{number}-s{seed}")
            for sensor in sorted(set(knows) & set(found)):
                T, covariance = found[sensor]
                error = se3_log(invert_pose(truth[sensor]) @ T)
                out.append(compare_sigma(title, sensor, knows[sensor][1], covariance, error))
    return out


def _calibrate(folder: Path, words: Sequence[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return T_robot_sensor (4, 4) and covariance (6, 6) by sensor of a simulated recording."""
    simulate_log(folder, words, has_kept_logs=True)
    make_with_snakemake(folder, ["results/sim/solution.json"], 1)
    solution = json.loads((folder / "results/sim/solution.json").read_text())
    return {
        name: (np.array(s["T_robot_sensor"]["matrix"]), np.array(s["covariance"]))
        for name, s in solution["sensors"].items()
        if s["T_robot_sensor"]
    }


def _read_truth(folder: Path) -> dict[str, np.ndarray]:
    sensors = json.loads((folder / "truth.json").read_text())["sensors"]
    return {name: np.array(s["T_robot_sensor"]["matrix"]) for name, s in sensors.items()}


def compare_sigma(
    title: str, sensor: str, known: np.ndarray, covariance: np.ndarray, error: np.ndarray
) -> KnownErrorOutcome:
    """Return the outcome of a pose; known: covariance (6, 6) of a fit that knows the error."""
    ratios = np.linalg.eigvals(np.linalg.solve(known, covariance)).real
    nees = float(error @ np.linalg.solve(covariance, error)) / len(error)
    return KnownErrorOutcome(
        title, sensor, float(np.sqrt(ratios.mean())), float(np.sqrt(ratios.max())), nees
    )


def check_known_error_goals(outcomes: Sequence[KnownErrorOutcome]) -> list[str]:
    """Return a sentence for each error and sensor whose mean ratio misses the goal."""
    out = []
    for title, sensor in dict.fromkeys((o.title, o.sensor) for o in outcomes):
        mean = np.mean([o.ratio for o in outcomes if (o.title, o.sensor) == (title, sensor)])
        if mean > RATIO_GOAL:
            out.append(
                f"{title}: σ of {sensor} is {mean:.2g} of a known error's, goal {RATIO_GOAL}"
            )
    return out
