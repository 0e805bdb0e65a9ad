"""What is simulated for a choice of cases, and the config that calibrates all of it in one run."""

from collections import Counter

from benchmarking.accuracy import accuracy_cases

SPEED = "speed"  # folder of the logs of the row on speed
SPEED_RIG = "demo"  # of simulate.py, with the noise of a laboratory
SPEED_SENSORS = ("front_lidar", "rear_lidar", "left_camera")  # those in use


def log_name(kind, n, seed):
    """Folder of a simulated log."""
    return f"{kind}-n{n}-s{seed}"


def full_names(runs):
    """Folders of the logs that run through the whole pipeline, and names of their sessions."""
    return [f"full-s{seed}" for seed in range(1, 1 + runs)]


def simulations(cases, speed_placements, full_runs):
    """{folder: arguments of simulate.py}, the longest first, of the cases, of the speed row and of
    the full runs."""
    logs = sorted({case.log for case in cases}, key=lambda log: (-log[1], log[0], log[2]))
    speed = f"--rig {SPEED_RIG} --seed 1 --placements {speed_placements} {accuracy_cases.GUESS}"
    commands = {SPEED: speed}
    for kind, n, seed in logs:
        arguments = (
            f"{accuracy_cases.LOGS[kind]} --seed {seed} --placements {n} {accuracy_cases.GUESS}"
        )
        commands[log_name(kind, n, seed)] = arguments
    for seed, name in enumerate(full_names(full_runs), 1):
        commands[name] = f"{accuracy_cases.FULL} --seed {seed} {accuracy_cases.GUESS}"
    return {name: text.split() for name, text in commands.items()}


def session(case, log):
    """The session of a case, of the config.yaml of the run."""
    return {"rig": case.name, "log": log, "targets": [case.target], "sensors": [case.row.sensor]}


def rig(case, simulated):
    """The rig of a case: the simulated one with only the sensor of its row."""
    sensors = {case.row.sensor: simulated["sensors"][case.row.sensor]}
    return {"body": simulated["body"], "mocap": simulated["mocap"], "sensors": sensors}


def untold(simulated):
    """A simulated rig without a word of the truth."""
    return {key: value for key, value in simulated.items() if key != "truth"}


def target(case, simulated):
    """The target of a case: the simulated one, compared by the method of the case."""
    chosen = {} if case.method == accuracy_cases.DEFAULT else accuracy_cases.METHODS[case.method]
    return simulated | chosen


def home(case):
    """Working directory of a case below that of the run: all of it has one block `crop`."""
    return case.method.split(",")[0]


def crop(name):
    """Block `crop` of a working directory: the paper's methods take one scan of a placement."""
    return {} if name == accuracy_cases.DEFAULT else {"max_frames": 1}


def jobs(cases):
    """The files to ask Snakemake for."""
    return [f"results/{case.name}/calibration.json" for case in cases]


def speed_rig(simulated):
    """The rig of the row on speed: the simulated one with only SPEED_SENSORS."""
    return simulated | {"sensors": {name: simulated["sensors"][name] for name in SPEED_SENSORS}}


def about(solution, size):
    """Sensors, placements and size, bytes, of the logs of a solution.json in words."""
    sensors = solution["sensors"].values()
    kinds = Counter(sensor["kind"] for sensor in sensors)
    names = " + ".join(f"{n} {kind}{'s' * (n > 1)}" for kind, n in sorted(kinds.items(), reverse=1))
    placements = ", ".join(str(sensor["placements"]) for sensor in sensors)
    return f"{names}, {placements} placements, {size / 1e6:.0f} MB of logs"
