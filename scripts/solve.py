"""All sensors, targets and sessions of a rig in one problem.

Reads   pairs.parquet, placements.parquet and mocap.parquet of all its sessions, moving_keypoints.parquet of
        all their sensors
Writes  solution.json       poses, joint covariance, noise, observability, a status per sensor
        residuals.parquet   one row per measurement
        iterations.parquet  one row per round of solving and re-association
Decides which measurements are members, with the library function that associate uses, until
nothing moves. A sensor that the data cannot place gets no pose, and stops no other.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from calib.diagnosis.model_selection import estimate_with_corrections
from calib.diagnosis.next_best_view import find_best_views
from calib.diagnosis.residual_table import residual_columns
from calib.diagnosis.session_repeatability import repeatability_json
from calib.diagnosis.solution_json import solution_json
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.robot_markers import make_markers_corrections, robot_markers_json
from calib.estimation.problem_assembly import (
    add_moving_views,
    build_setup,
    iteration_limits,
    mounts_from_guesses,
    read_session_placements,
    statuses_before_solve,
)
from calib.io.parquet_tables import read_table, write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage, write_json
from calib.io.table_schemas import (
    ITERATIONS_SCHEMA,
    KEYPOINTS_SCHEMA,
    MOCAP_SCHEMA,
    PAIRS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.sensors.lens_from_log import reject_lens_mismatches, with_lens_from_log


def read_paired_sessions(args, options):
    """{session: (pairs columns, notes, Placements by number)}, and the mounts that guess found:
    T_body_target (4, 4) to start from, by target."""
    read = [read_table(path, PAIRS_SCHEMA) for path in args.pairs]
    mounts = mounts_from_guesses([notes for _, _, notes in read])
    out, anew = {}, options["remounted"]
    for session, (pairs, _, notes), path in zip(
        options["sessions"], read, args.placements, strict=True
    ):
        table, _, _ = read_table(path, PLACEMENTS_SCHEMA)
        out[session] = pairs, notes, read_session_placements(table, session, notes, mounts, options)
    # Those whose markers define R come first: their sensors' poses are in it.
    return {s: out[s] for s in sorted(out, key=lambda s: (s in anew, s))}, mounts


def read_moving_keypoints(args, options):
    """{session: (columns of the MCS's poses, topics by body, {sensor: columns of its views in
    motion})}."""
    files, out = iter(args.moving_keypoints), {}
    for session, path in zip(options["sessions"], args.mocap, strict=True):
        sensors = options["used"][session]
        tracked = {name: read_table(next(files), KEYPOINTS_SCHEMA)[0] for name in sensors}
        poses, _, notes = read_table(path, MOCAP_SCHEMA)
        out[session] = poses, notes["topics"], tracked
    return out


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--pairs", "pairs.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_paths("--mocap", "mocap.parquet of each session")
    parser.add_paths("--moving-keypoints", "moving_keypoints.parquet of each session and sensor")
    parser.add_path("--solution", "solution.json to write")
    parser.add_path("--residuals", "residuals.parquet to write")
    parser.add_path("--iterations", "iterations.parquet to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    options = args.options
    sessions, mounts = read_paired_sessions(args, options)
    sessions = reject_lens_mismatches(sessions)
    guesses = ((n, note["guess"]) for _, notes, _ in sessions.values() for n, note in notes.items())
    options["sensors"] = with_lens_from_log(options["sensors"], guesses)
    setup, start = build_setup(sessions, mounts, options)
    notes = {s: found for s, (_, found, _) in sessions.items()}
    setup = replace(setup, corrections=tuple(make_markers_corrections(notes, options["remounted"])))
    wanted, most = options["solve"]["estimate"], iteration_limits(setup, options["solve"])
    moving = partial(
        add_moving_views,
        moving_by_session=read_moving_keypoints(args, options),
        sessions=sessions,
        options=options,
    )
    setup, result, suspected = estimate_with_corrections(setup, start, wanted, moving, **most)
    known = statuses_before_solve(sessions, options)
    content = solution_json(setup, result, suspected, known, options)
    content["sessions"] |= robot_markers_json(setup, result) if result.solve_result else {}
    placed = [n for n, sensor in content["sensors"].items() if sensor["T_robot_sensor"]]
    views = find_best_views(setup, result, placed, options["views"])
    for name, sensor in content["sensors"].items():
        sensor["next_view"] = views.get(name)
    content["repeatability"] = repeatability_json(setup, result, **most)
    write_json(args.solution, content)
    write_table(args.residuals, RESIDUALS_SCHEMA, residual_columns(setup, result))
    rounds = {k: [r[k] for r in result.rounds] for k in ITERATIONS_SCHEMA.names}
    write_table(args.iterations, ITERATIONS_SCHEMA, rounds)
    for r in result.rounds:
        logger.info(
            "round %(round)d: cost %(cost).6g, %(ipopt_iterations)d iterations, "
            "%(n_inliers)d inliers, %(n_reassigned)d reassigned, step %(step_m).1e m %(step_rad).1e rad",
            r,
        )
    logger.info("settled" if result.has_converged else "not settled")
    for estimate in correction_estimates(setup, result):
        text = estimate.correction.describe(estimate.values, estimate.sigma)
        logger.info("correction: %s", text)
    for target in sorted(set(setup.initial_mounts) & set(setup.mount_sigma)):
        logger.info("estimated besides: T_body_target of %s", target)


if __name__ == "__main__":
    run_stage(main)
