"""Measure accuracy and cost on logs with known truth: the tables of docs/benchmark.md.

Simulates the logs below WORK, calibrates all of them with the pipeline in one working directory,
and compares the results with truth.json, which no job of the pipeline gets to see. The table goes
to stdout; a full run also writes benchmark.md and benchmark.svg into --docs.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

from benchmarking.accuracy import (
    accuracy_cases,
    collect_results,
    draw_statistics,
    error_metrics,
    parallel_draws,
    simulation_plan,
)
from benchmarking.decode_cost import decode_cost, process_cost
from benchmarking.fuzzing import fuzzing_page, run_cases
from benchmarking.lab_faults import lab_faults, lab_faults_page
from benchmarking.page import benchmark_page, error_chart

ROOT = Path(__file__).resolve().parents[1]


def parse(argv):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("work", type=Path, metavar="WORK", help="an own folder; 2 GB of logs are written there")
    add("--quick", action="store_true", help="the smallest N of every row, one log of each")
    add("--draws", type=int, help="of the noise, per line; default 100, or 4 in a quick run")
    add("--cores", type=int, default=2)
    add("--docs", type=Path, default=ROOT / "docs", help="where a full run writes")
    add("--keep-logs", action="store_true", help="use logs that an earlier run left in WORK")
    return parser.parse_args(argv)


def simulate(folder, arguments, keep):
    """Write one log with its truth below folder."""
    if keep and (folder / "truth.json").exists():
        return
    command = [sys.executable, ROOT / "scripts" / "simulate.py", folder, *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{folder.name} was not simulated:\n{done.stderr}")


def snakemake(run, targets, cores):
    """Make the targets in the working directory run; whether all were made, and the seconds."""
    command = [Path(sys.executable).with_name("snakemake"), "-s", ROOT / "Snakefile", "-d", run]
    command += ["--cores", str(cores), "--keep-going", "--", *targets]
    begin = time.perf_counter()
    with (run / "snakemake.log").open("a") as log:
        done = subprocess.run(command, stdout=log, stderr=log).returncode == 0
    return done, time.perf_counter() - begin


def write_config(run, logs, cases):
    """The config of the cases of one working directory; logs: the folder of the simulated ones."""
    sessions, files = {}, {}
    for case in cases:
        log = logs / simulation_plan.log_name(*case.log)
        sessions[case.name] = simulation_plan.session(case, str(collect_results.log_file(log)))
        files[f"rigs/{case.name}.yaml"] = simulation_plan.rig(
            case, collect_results.simulated(log, "rigs/*")
        )
        body = collect_results.simulated(log, f"targets/{case.row.target}")
        files[f"targets/{case.target}.yaml"] = simulation_plan.target(case, body)
    settings = {"sessions": sessions, "crop": simulation_plan.crop(simulation_plan.home(cases[0]))}
    write_files(run, {"config.yaml": settings, **files})


def write_files(run, files):
    """Write the contents of files by name, below the config of a working directory."""
    for name, content in files.items():
        path = run / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(content, sort_keys=False))


def speed(logs, run, cases, cores):
    """The Speed of the log made for it, in its own working directory; run, cases: of the others."""
    folder, results = logs / simulation_plan.SPEED, logs / simulation_plan.SPEED / "results"
    rig = folder / "config" / "rigs" / f"{simulation_plan.SPEED_RIG}.yaml"
    rig.write_text(yaml.safe_dump(simulation_plan.speed_rig(yaml.safe_load(rig.read_text()))))
    settings = folder / "config" / "config.yaml"
    sessions = yaml.safe_load(settings.read_text())["sessions"]
    settings.write_text(yaml.safe_dump({"sessions": sessions}))
    shutil.rmtree(results, ignore_errors=True)
    # Made twice: the second time there is nothing to do but to find that out.
    wanted = f"results/{simulation_plan.SPEED_RIG}/solution.json"
    walls = [snakemake(folder, [wanted], cores)[1] for _ in range(2)]
    files = sorted((folder / "logs").glob("*.mcap"))
    solution = json.loads((folder / wanted).read_text())
    return process_cost.Speed(
        about=simulation_plan.about(solution, sum(path.stat().st_size for path in files)),
        costs=process_cost.costs(collect_results.read_logs(results)),
        wall=walls[0] - walls[1],
        raw=sum(process_cost.raw_read(path) for path in files),
        memory=[collect_results.decode_of(logs, run, case) for case in cases],
    )


def full_runs(logs, run, count, cores):
    """{sensor: Statistics} of so many small logs through the whole pipeline."""
    names, sessions, files = simulation_plan.full_names(count), {}, {}
    for name in names:
        sessions[name] = {"rig": name, "log": str(collect_results.log_file(logs / name))}
        files[f"rigs/{name}.yaml"] = simulation_plan.untold(
            collect_results.simulated(logs / name, "rigs/*")
        )
    files["targets/board.yaml"] = collect_results.simulated(logs / names[0], "targets/*")
    write_files(run, {"config.yaml": {"sessions": sessions}, **files})
    snakemake(run, [f"results/{name}/calibration.json" for name in names], cores)
    found = collect_results.full_runs(run, logs, names)
    return {sensor: draw_statistics.of_runs(draws) for sensor, draws in found.items()}


def lab_runs(work, quick, args):
    """{(fault, on): [lab.Outcome]} of logs with what labs get wrong, options on and off."""
    faults, seeds = (lab_faults.QUICK, (1,)) if quick else (tuple(lab_faults.FAULTS), (1, 2, 3))
    commands = lab_faults.simulations(faults, seeds)
    tasks = [(fault, on, seed) for fault in faults for on in (True, False) for seed in seeds]
    with ThreadPoolExecutor(args.cores) as pool:
        folders = [work / name for name in commands]
        list(pool.map(simulate, folders, commands.values(), [args.keep_logs] * len(folders)))
        found = list(pool.map(lambda task: lab_run(work, *task), tasks))
    out = {}
    for (fault, on, _), outcome in zip(tasks, found, strict=True):
        out.setdefault((fault, on), []).append(outcome)
    return out


def lab_run(work, fault, on, seed):
    """The lab.Outcome of one log."""
    log = work / lab_faults.folder(fault, seed)
    run = work / ("on" if on else "off") / log.name
    shutil.copytree(log / "config", run / "config", dirs_exist_ok=True)
    session = {"rig": "sim", "log": str(collect_results.log_file(log))}
    settings = {"sessions": {"sim": session}, "solve": {"estimate": lab_faults.estimate(fault, on)}}
    rig = lab_faults.stated(fault, collect_results.simulated(log, "rigs/*"))
    write_files(run, {"config.yaml": settings, "rigs/sim.yaml": rig})
    snakemake(run, ["results/sim/verdict.json"], 1)
    return lab_faults.outcome(run / "results" / "sim", log)


def measured(work, cases, placements, draws, args):
    """(Lines, cost.Speed, (draws, coverage, full runs)) of the cases, below the folder work."""
    logs, run, runs = work / "logs", work / "run", max(1, draws // 5)
    commands = simulation_plan.simulations(cases, placements, runs)
    with ThreadPoolExecutor(args.cores) as pool:
        folders = [logs / name for name in commands]
        list(pool.map(simulate, folders, commands.values(), [args.keep_logs] * len(folders)))
    for home in sorted({simulation_plan.home(case) for case in cases}):
        mine = [case for case in cases if simulation_plan.home(case) == home]
        write_config(run / home, logs, mine)
        snakemake(run / home, simulation_plan.jobs(mine), args.cores)
    lines = error_metrics.lines(collect_results.outcomes(run, logs, cases))
    speeds = speed(logs, run, cases, args.cores)
    pending = parallel_draws.tasks(run, logs, collect_results.load(run)[0], cases, draws)
    drawn, covered = parallel_draws.everything(pending, 10 * draws, args.cores)
    return lines, speeds, (drawn, covered, full_runs(logs, run / "full", runs, args.cores))


def main(argv=None):
    args = parse(argv)
    draws = args.draws or (4 if args.quick else 100)
    sizes = accuracy_cases.cases(args.quick), 5 if args.quick else 30, draws
    lines, speeds, found = measured(args.work.resolve(), *sizes, args)
    sections = [
        lab_faults_page.section(lab_runs(args.work.resolve() / "lab", args.quick, args)),
        decode_cost.section(decode_cost.measured(args.work.resolve() / "ingest", args.quick)),
        fuzzing_page.section(run_cases.everything(500 if args.quick else 10_000, 1, args.cores)),
    ]
    text = benchmark_page.whole(lines, speeds, found, sections, args.quick)
    print(text)
    if not args.quick:
        args.docs.mkdir(parents=True, exist_ok=True)
        (args.docs / "benchmark.md").write_text(text)
        (args.docs / "benchmark.svg").write_bytes(error_chart.svg(lines, found[0]))


if __name__ == "__main__":
    main()
