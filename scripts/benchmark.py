"""Measure accuracy and cost on logs with known truth, and write docs/benchmark.md.

Simulates the logs in WORK, calibrates them with the pipeline, and compares the results with
truth.json, which no job of the pipeline reads. Prints the page; a full run also writes benchmark.md
and benchmark.svg into --docs.
"""

import argparse
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import yaml

from benchmarking.accuracy.accuracy_cases import AccuracyCase, list_accuracy_cases
from benchmarking.accuracy.draw_statistics import DrawStatistics, compute_run_statistics
from benchmarking.accuracy.error_metrics import AccuracyLine, summarize_outcomes
from benchmarking.accuracy.parallel_draws import plan_draw_tasks, run_all_draws
from benchmarking.accuracy.result_collection import (
    collect_full_runs,
    collect_outcomes,
    find_log_file,
    load_run_config,
    read_decode_memory,
    read_job_logs,
    read_simulated_config,
)
from benchmarking.accuracy.simulation_plan import (
    SPEED_FOLDER,
    SPEED_RIG,
    calibration_paths,
    case_folder,
    case_rig_config,
    case_session_config,
    case_target_config,
    crop_block,
    describe_run,
    full_run_names,
    plan_simulations,
    remove_truth,
    simulated_log_name,
    speed_rig_config,
)
from benchmarking.decode_cost.decode_cost import build_decode_section, measure_decode_costs
from benchmarking.decode_cost.process_cost import RunSpeed, parse_stage_costs, time_raw_read
from benchmarking.fuzzing.case_runner import run_fuzz_campaign
from benchmarking.fuzzing.fuzzing_page import build_fuzz_section
from benchmarking.lab_faults.lab_faults import (
    LAB_FAULTS,
    QUICK_FAULTS,
    LabOutcome,
    lab_estimate_options,
    lab_log_name,
    make_lab_rig,
    plan_lab_simulations,
    read_lab_outcome,
)
from benchmarking.lab_faults.lab_faults_page import build_lab_section
from benchmarking.page.benchmark_page import DrawResults, render_benchmark_page
from benchmarking.page.error_chart import render_error_chart_svg
from benchmarking.pipeline_runs import ROOT, make_with_snakemake, simulate_log
from benchmarking.split_halves.split_half_page import HALVED_RIGS, measure_section


def parse_benchmark_arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("work", type=Path, metavar="WORK", help="folder for logs and results, 2 GB")
    add(
        "--quick", action="store_true", help="only the fewest placements of every row, one log each"
    )
    add("--draws", type=int, help="noise draws per line; default 100, with --quick 4")
    add("--cores", type=int, default=2)
    add(
        "--docs",
        type=Path,
        default=ROOT / "docs",
        help="folder for the page and the chart of a full run",
    )
    add(
        "--recordings",
        type=Path,
        nargs="*",
        default=[],
        metavar="FOLDER",
        help="folders of finished runs on real recordings, for the table of split halves",
    )
    add(
        "--keep-logs",
        action="store_true",
        help="use the logs, and the draws of halves, of an earlier run in WORK",
    )
    return parser.parse_args(argv)


def write_run_config(run_folder: Path, logs: Path, cases: list[AccuracyCase]) -> None:
    """Write the config of the cases of one working directory; logs: folder of simulated logs."""
    sessions, files = {}, {}
    for case in cases:
        log = logs / simulated_log_name(*case.log_key)
        sessions[case.case_name] = case_session_config(case, str(find_log_file(log)))
        files[f"rigs/{case.case_name}.yaml"] = case_rig_config(
            case, read_simulated_config(log, "rigs/*")
        )
        body = read_simulated_config(log, f"targets/{case.row.target}")
        files[f"targets/{case.target_name}.yaml"] = case_target_config(case, body)
    settings = {"sessions": sessions, "crop": crop_block(case_folder(cases[0]))}
    write_config_files(run_folder, {"config.yaml": settings, **files})


def write_config_files(run_folder: Path, files: dict[str, Any]) -> None:
    """Write files, content by name, into the config folder of a working directory."""
    for name, content in files.items():
        path = run_folder / "config" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(content, sort_keys=False))


def measure_run_speed(
    logs_folder: Path, run_folder: Path, cases: list[AccuracyCase], cores: int
) -> RunSpeed:
    """Measure the cost of a run on the log in SPEED_FOLDER.

    run_folder, cases: of the other runs, for the memory of decode.
    """
    folder, results = logs_folder / SPEED_FOLDER, logs_folder / SPEED_FOLDER / "results"
    rig = folder / "config" / "rigs" / f"{SPEED_RIG}.yaml"
    rig.write_text(yaml.safe_dump(speed_rig_config(yaml.safe_load(rig.read_text()))))
    settings = folder / "config" / "config.yaml"
    sessions = yaml.safe_load(settings.read_text())["sessions"]
    settings.write_text(yaml.safe_dump({"sessions": sessions}))
    shutil.rmtree(results, ignore_errors=True)
    # Made twice. The second run has nothing to do: its time is that of Snakemake itself.
    wanted = f"results/{SPEED_RIG}/solution.json"
    walls = [make_with_snakemake(folder, [wanted], cores)[1] for _ in range(2)]
    files = sorted((folder / "logs").glob("*.mcap"))
    solution = json.loads((folder / wanted).read_text())
    return RunSpeed(
        description=describe_run(solution, sum(path.stat().st_size for path in files)),
        stage_costs=parse_stage_costs(read_job_logs(results)),
        wall_s=walls[0] - walls[1],
        raw_cpu_s=sum(time_raw_read(path) for path in files),
        decode_memory_mb=[read_decode_memory(logs_folder, run_folder, case) for case in cases],
    )


def measure_full_runs(
    logs: Path, run_folder: Path, n_runs: int, cores: int
) -> dict[str, DrawStatistics]:
    """Run n_runs small logs through the whole pipeline; return the statistics by sensor."""
    names, sessions, files = full_run_names(n_runs), {}, {}
    for name in names:
        sessions[name] = {"rig": name, "log": str(find_log_file(logs / name))}
        files[f"rigs/{name}.yaml"] = remove_truth(read_simulated_config(logs / name, "rigs/*"))
    files["targets/board.yaml"] = read_simulated_config(logs / names[0], "targets/*")
    write_config_files(run_folder, {"config.yaml": {"sessions": sessions}, **files})
    make_with_snakemake(run_folder, [f"results/{name}/calibration.json" for name in names], cores)
    results = collect_full_runs(run_folder, logs, names)
    return {sensor: compute_run_statistics(draws) for sensor, draws in results.items()}


def measure_lab_faults(
    work_folder: Path, is_quick: bool, args: argparse.Namespace
) -> dict[tuple[str, bool], list[LabOutcome]]:
    """Calibrate logs with faults of labs; return the outcomes by (fault, corrections on)."""
    faults, seeds = (QUICK_FAULTS, (1,)) if is_quick else (tuple(LAB_FAULTS), (1, 2, 3))
    commands = plan_lab_simulations(faults, seeds)
    tasks = [(fault, on, seed) for fault in faults for on in (True, False) for seed in seeds]
    with ThreadPoolExecutor(args.cores) as pool:
        folders = [work_folder / name for name in commands]
        list(pool.map(simulate_log, folders, commands.values(), [args.keep_logs] * len(folders)))
        results = list(pool.map(lambda task: run_lab_log(work_folder, *task), tasks))
    out: dict[tuple[str, bool], list[LabOutcome]] = {}
    for (fault, on, _), outcome in zip(tasks, results, strict=True):
        out.setdefault((fault, on), []).append(outcome)
    return out


def run_lab_log(work_folder: Path, fault: str, has_options_on: bool, seed: int) -> LabOutcome:
    """Calibrate one log with a fault."""
    log = work_folder / lab_log_name(fault, seed)
    run = work_folder / ("on" if has_options_on else "off") / log.name
    shutil.copytree(log / "config", run / "config", dirs_exist_ok=True)
    session = {"rig": "sim", "log": str(find_log_file(log))}
    settings = {
        "sessions": {"sim": session},
        "solve": {"estimate": lab_estimate_options(fault, has_options_on)},
    }
    rig = make_lab_rig(fault, read_simulated_config(log, "rigs/*"))
    write_config_files(run, {"config.yaml": settings, "rigs/sim.yaml": rig})
    make_with_snakemake(run, ["results/sim/verdict.json"], 1)
    return read_lab_outcome(run / "results" / "sim", log)


def measure_accuracy(
    work_folder: Path,
    cases: list[AccuracyCase],
    placements: int,
    draws: int,
    args: argparse.Namespace,
) -> tuple[list[AccuracyLine], RunSpeed, DrawResults]:
    """Measure accuracy and cost in a folder; return the lines, the cost, and the noise draws.

    placements: of the log for the cost; draws: of the noise, per line.
    """
    logs, run, runs = work_folder / "logs", work_folder / "run", max(1, draws // 5)
    commands = plan_simulations(cases, placements, runs)
    with ThreadPoolExecutor(args.cores) as pool:
        folders = [logs / name for name in commands]
        list(pool.map(simulate_log, folders, commands.values(), [args.keep_logs] * len(folders)))
    for home in sorted({case_folder(case) for case in cases}):
        mine = [case for case in cases if case_folder(case) == home]
        write_run_config(run / home, logs, mine)
        make_with_snakemake(run / home, calibration_paths(mine), args.cores)
    lines = summarize_outcomes(collect_outcomes(run, logs, cases))
    speeds = measure_run_speed(logs, run, cases, args.cores)
    pending = plan_draw_tasks(run, logs, load_run_config(run)[0], cases, draws)
    drawn, covered = run_all_draws(pending, 10 * draws, args.cores)
    return lines, speeds, (drawn, covered, measure_full_runs(logs, run / "full", runs, args.cores))


def main(argv: list[str] | None = None) -> None:
    """Measure everything and write the page."""
    args = parse_benchmark_arguments(argv)
    draws = args.draws or (4 if args.quick else 100)
    sizes = list_accuracy_cases(args.quick), 5 if args.quick else 30, draws
    lines, speeds, found = measure_accuracy(args.work.resolve(), *sizes, args)
    rooms = list(HALVED_RIGS)[:1] if args.quick else list(HALVED_RIGS)
    halved, seeds = args.work.resolve() / "halves", 0 if args.quick else 3
    if not args.keep_logs:
        shutil.rmtree(halved, ignore_errors=True)
    sections = [
        measure_section(halved, args.recordings, rooms, draws=4 if args.quick else 30, seeds=seeds),
        build_lab_section(measure_lab_faults(args.work.resolve() / "lab", args.quick, args)),
        build_decode_section(measure_decode_costs(args.work.resolve() / "ingest", args.quick)),
        build_fuzz_section(run_fuzz_campaign(500 if args.quick else 10_000, 1, args.cores)),
    ]
    text = render_benchmark_page(lines, speeds, found, sections, args.quick)
    print(text)
    if not args.quick:
        args.docs.mkdir(parents=True, exist_ok=True)
        (args.docs / "benchmark.md").write_text(text)
        (args.docs / "benchmark.svg").write_bytes(render_error_chart_svg(lines, found[0]))


if __name__ == "__main__":
    main()
