"""Estimate all sensors, targets and sessions of a rig in one problem.

Reads   pairs.parquet, placements.parquet and mocap.parquet of all its sessions,
        moving_keypoints.parquet of all their sensors
Writes  solution.json       poses, joint covariance, noise, observability, a status per sensor
        residuals.parquet   one row per measurement
        iterations.parquet  one row per round of solving and reassignment
Starts from the assignments in pairs.parquet and assigns again after each round, until nothing
changes. A sensor that the data do not determine gets no pose; the others are not affected.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calib.diagnosis.correction_selection import estimate_with_corrections
from calib.diagnosis.covariance.choice_covariance import choice_covariance
from calib.diagnosis.error_search.supported_corrections import with_requested_corrections
from calib.diagnosis.next_view.next_best_view import find_best_views
from calib.diagnosis.residual_table import residual_columns
from calib.diagnosis.session_repeatability import repeatability_json
from calib.diagnosis.solution_json import solution_json
from calib.diagnosis.split_halves import estimate_halves, split_halves_json
from calib.estimation.corrections.correction_estimate import correction_estimates
from calib.estimation.corrections.mocap.robot_markers import (
    make_markers_corrections,
    robot_markers_json,
)
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.moving_view_poses import MovingSession, add_moving_views
from calib.estimation.problem_assembly import (
    SessionKeypoints,
    build_setup,
    iteration_limits,
    mounts_from_guesses,
    reject_lens_mismatches,
    session_keypoints_from_notes,
    statuses_before_solve,
)
from calib.io.parquet_tables import Columns, read_table, write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage, write_json
from calib.io.table_schemas import (
    ITERATIONS_SCHEMA,
    KEYPOINTS_SCHEMA,
    MOCAP_SCHEMA,
    PAIRS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.sensors.lens_from_log import with_lens_from_log


def read_sessions(
    args: argparse.Namespace, options: dict[str, Any]
) -> tuple[list[SessionKeypoints], dict[str, np.ndarray]]:
    """Return the sessions, and T_body_target (4, 4) of the targets whose mount a guess found.

    Sessions whose markers were not re-attached come first: they define the robot frame.
    """
    tables = [read_table(path, PAIRS_SCHEMA) for path in args.pairs]
    notes_of_sessions = [notes for _, _, notes in tables]
    mounts = mounts_from_guesses(
        {n: note["guess"] for n, note in notes.items()} for notes in notes_of_sessions
    )
    files = zip(options["sessions"], tables, args.placements, strict=True)
    sessions = [
        _make_session_keypoints(session, (pairs, notes), path, mounts, options)
        for session, (pairs, _, notes), path in files
    ]
    sessions.sort(key=lambda s: (s.session in options["remounted"], s.session))
    return sessions, mounts


def _make_session_keypoints(
    session: str,
    pairs_and_notes: tuple[Columns, dict[str, Any]],
    placements_path: Path,
    mounts: dict[str, np.ndarray],
    options: dict[str, Any],
) -> SessionKeypoints:
    """Return a session, with the start of its log unless it is a part of a cut one."""
    columns, _, about = read_table(placements_path, PLACEMENTS_SCHEMA)
    made = session_keypoints_from_notes(
        session=session,
        keypoints=pairs_and_notes[0],
        notes=pairs_and_notes[1],
        placement_columns=columns,
        mounts=mounts,
        options=options,
    )
    if session in options["cut_sessions"]:
        return made
    return replace(made, log_start_ns=about["log_start_ns"])


def read_moving_sessions(args: argparse.Namespace, options: dict[str, Any]) -> list[MovingSession]:
    """Return motion capture and moving keypoints of every session."""
    files = iter(args.moving_keypoints)
    out = []
    for session, path in zip(options["sessions"], args.mocap, strict=True):
        mocap_columns, _, notes = read_table(path, MOCAP_SCHEMA)
        keypoints = {
            n: read_table(next(files), KEYPOINTS_SCHEMA)[0] for n in options["used"][session]
        }
        out.append(MovingSession(session, mocap_columns, notes["topics"], keypoints))
    return out


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the paths and the options of the stage."""
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--pairs", "pairs.parquet of each session")
    parser.add_paths("--placements", "placements.parquet of each session")
    parser.add_paths("--mocap", "mocap.parquet of each session")
    parser.add_paths("--moving-keypoints", "moving_keypoints.parquet of each session and sensor")
    parser.add_path("--solution", "solution.json to write")
    parser.add_path("--residuals", "residuals.parquet to write")
    parser.add_path("--iterations", "iterations.parquet to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = parse_arguments(argv)
    options = args.options
    setup, result, content = estimate_rig(args, options)
    write_json(args.solution, content)
    write_table(args.residuals, RESIDUALS_SCHEMA, residual_columns(setup, result))
    rows = {k: [dict(row)[k] for row in result.rounds] for k in ITERATIONS_SCHEMA.names}
    write_table(args.iterations, ITERATIONS_SCHEMA, rows)
    log_result(setup, result)


def build_rig_setup(
    args: argparse.Namespace, options: dict[str, Any]
) -> tuple[Setup, dict[str, np.ndarray], list[SessionKeypoints]]:
    """Return the Setup of the rig, the poses by sensor from which to start, and the sessions.

    The sensors of options get the lenses that the logs state.
    """
    sessions, mounts = read_sessions(args, options)
    sessions = reject_lens_mismatches(sessions)
    guesses = (item for session in sessions for item in session.guesses.items())
    options["sensors"] = with_lens_from_log(options["sensors"], guesses)
    setup, T_robot_sensor = build_setup(sessions, mounts, options)
    working_poses = {s.session: s.T_robot_sensor for s in sessions}
    markers = make_markers_corrections(working_poses, options["remounted"])
    return replace(setup, corrections=tuple(markers)), T_robot_sensor, sessions


def estimate_rig(
    args: argparse.Namespace, options: dict[str, Any]
) -> tuple[Setup, EstimationResult, dict[str, Any]]:
    """Estimate the rig; return the Setup, its result and the content of solution.json."""
    setup, T_robot_sensor, sessions = build_rig_setup(args, options)
    limits = iteration_limits(setup, options["solve"])
    estimate_options = options["solve"]["estimate"]
    halves = estimate_halves(setup, T_robot_sensor, estimate_options, **limits)
    requested = with_requested_corrections(setup, estimate_options)
    setup, result, suspected = estimate_with_corrections(
        setup,
        T_robot_sensor,
        estimate_options,
        partial(
            add_moving_views,
            moving_sessions=read_moving_sessions(args, options),
            sessions=sessions,
            options=options,
        ),
        halves,
        **limits,
    )
    by_choice = choice_covariance(requested, (setup, result), halves, **limits)
    if result.solve_result is not None:
        result = result.with_added_covariance(by_choice)
    statuses = statuses_before_solve(options["sensors"], sessions)
    content = solution_json(setup, result, suspected, statuses, options)
    content["sessions"] |= robot_markers_json(setup, result) if result.solve_result else {}
    placed = [n for n, sensor in content["sensors"].items() if sensor["T_robot_sensor"]]
    views = find_best_views(setup, result, placed, options["views"])
    for name, sensor in content["sensors"].items():
        sensor["next_view"] = views.get(name)
    content["repeatability"] = repeatability_json(setup, result, **limits)
    content["split_halves"] = split_halves_json(setup, halves, by_choice)
    return setup, result, content


def log_result(setup: Setup, result: EstimationResult) -> None:
    """Log the rounds, whether they converged, and what was estimated beside the poses."""
    for row in result.rounds:
        logger.info(
            "round %(round)d: cost %(cost).6g, %(ipopt_iterations)d iterations, "
            "%(n_inliers)d inliers, %(n_reassigned)d reassigned, "
            "step %(step_m).1e m %(step_rad).1e rad",
            row,
        )
    logger.info("converged" if result.has_converged else "not converged")
    for estimate in correction_estimates(setup, result):
        text = estimate.correction.describe(estimate.values, estimate.sigma)
        logger.info("correction: %s", text)
    for target in sorted(set(setup.initial_mounts) & set(setup.mount_sigma)):
        logger.info("also estimated: T_body_target of %s", target)


if __name__ == "__main__":
    run_stage(main)
