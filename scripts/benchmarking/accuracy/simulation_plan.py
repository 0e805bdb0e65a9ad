"""The logs to simulate for the cases of the benchmark, and the configs that calibrate them."""

from collections import Counter
from typing import Any

from benchmarking.accuracy.accuracy_cases import (
    DEFAULT_METHOD,
    FULL_RUN_ARGUMENTS,
    GUESS_ARGUMENTS,
    LOG_ARGUMENTS,
    METHOD_CONFIGS,
    AccuracyCase,
)

SPEED_FOLDER = "speed"  # folder of the logs of the speed measurement
SPEED_RIG = "demo"  # rig of simulate.py, with the noise of a laboratory
SPEED_SENSORS = ("front_lidar", "rear_lidar", "left_camera")  # sensors in use


def simulated_log_name(log_kind: str, n_placements: int, seed: int) -> str:
    """Return the folder name of a simulated log."""
    return f"{log_kind}-n{n_placements}-s{seed}"


def full_run_names(n_runs: int) -> list[str]:
    """Return the folder names of the logs for full runs, which are also their session names."""
    return [f"full-s{seed}" for seed in range(1, 1 + n_runs)]


def plan_simulations(
    cases: list[AccuracyCase], speed_placements: int, n_full_runs: int
) -> dict[str, list[str]]:
    """Return the arguments of simulate.py by folder: speed, cases (longest first), full runs."""
    logs = sorted({case.log_key for case in cases}, key=lambda log: (-log[1], log[0], log[2]))
    speed = f"--rig {SPEED_RIG} --seed 1 --placements {speed_placements} {GUESS_ARGUMENTS}"
    commands = {SPEED_FOLDER: speed}
    for kind, n, seed in logs:
        arguments = f"{LOG_ARGUMENTS[kind]} --seed {seed} --placements {n} {GUESS_ARGUMENTS}"
        commands[simulated_log_name(kind, n, seed)] = arguments
    for seed, name in enumerate(full_run_names(n_full_runs), 1):
        commands[name] = f"{FULL_RUN_ARGUMENTS} --seed {seed} {GUESS_ARGUMENTS}"
    return {name: text.split() for name, text in commands.items()}


def case_session_config(case: AccuracyCase, log: str) -> dict[str, str | list[str]]:
    """Return the session of a case for config.yaml."""
    return {
        "rig": case.case_name,
        "log": log,
        "targets": [case.target_name],
        "sensors": [case.row.sensor],
    }


def case_rig_config(
    case: AccuracyCase,
    rig_config: dict[str, Any],
) -> dict[str, Any]:
    """Return the rig of a case: the simulated rig with only the sensor of its row."""
    sensors = {case.row.sensor: rig_config["sensors"][case.row.sensor]}
    return {"body": rig_config["body"], "mocap": rig_config["mocap"], "sensors": sensors}


def remove_truth(rig_config: dict[str, Any]) -> dict[str, Any]:
    """Return a simulated rig config without the truth."""
    return {key: value for key, value in rig_config.items() if key != "truth"}


def case_target_config(
    case: AccuracyCase,
    target_config: dict[str, Any],
) -> dict[str, Any]:
    """Return the target of a case: the simulated target with the method of the case."""
    method_config = METHOD_CONFIGS[case.method] if case.method != DEFAULT_METHOD else {}
    return target_config | method_config


def case_folder(case: AccuracyCase) -> str:
    """Return the working directory of a case, relative to the run; one per block `crop`."""
    return case.method.split(",")[0]


def crop_block(folder_name: str) -> dict[str, Any]:
    """Return block `crop` of a working directory: the paper's methods use one scan a placement."""
    return {} if folder_name == DEFAULT_METHOD else {"max_frames": 1}


def calibration_paths(cases: list[AccuracyCase]) -> list[str]:
    """Return the calibration.json files that Snakemake has to make."""
    return [f"results/{case.case_name}/calibration.json" for case in cases]


def speed_rig_config(rig_config: dict[str, Any]) -> dict[str, Any]:
    """Return the rig of the speed measurement: the simulated rig with only SPEED_SENSORS."""
    return rig_config | {"sensors": {name: rig_config["sensors"][name] for name in SPEED_SENSORS}}


def describe_run(solution: dict[str, Any], size_bytes: int) -> str:
    """Describe sensors, placements and log size of a solution.json in words."""
    sensors = solution["sensors"].values()
    kinds = Counter(sensor["kind"] for sensor in sensors)
    names = " + ".join(
        f"{n} {kind}{'s' * (n > 1)}" for kind, n in sorted(kinds.items(), reverse=True)
    )
    placements = ", ".join(str(sensor["placements"]) for sensor in sensors)
    return f"{names}, {placements} placements, {size_bytes / 1e6:.0f} MB of logs"
