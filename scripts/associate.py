"""Assign each measurement of a session to a feature of its target, at the initial guess.

Reads   keypoints.parquet of all sensors of a session, placements.parquet
Writes  pairs.parquet: the keypoints, each with the feature it is assigned to (-1 for none) and its
        residual there; the notes hold working pose, guess and status of every sensor
Solve starts from these assignments. They are made at the working poses of stage extract and at the
noise from which solve starts.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.estimation.estimate_state import initial_state
from calib.estimation.estimation_problem import Setup
from calib.estimation.measurement_assignment import pad_to_two_columns
from calib.estimation.problem_assembly import (
    INITIAL_NOISE_FACTOR,
    build_setup,
    mounts_from_guesses,
    session_keypoints_from_notes,
)
from calib.estimation.solver import start_from_initial_guess
from calib.io.parquet_tables import concatenate_columns, read_table, write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage
from calib.io.table_schemas import KEYPOINTS_SCHEMA, PAIRS_SCHEMA, PLACEMENTS_SCHEMA
from calib.sensors.lens_from_log import with_lens_from_log


def read_keypoints(
    paths: Sequence[str], sensors: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
    """Return the keypoints of all sensors with status ok, and the notes by sensor."""
    parts, notes = [], {}
    for path, name in zip(paths, sensors, strict=True):
        columns, status, table_notes = read_table(path, KEYPOINTS_SCHEMA)
        notes[name] = {k: table_notes[k] for k in ("T_robot_sensor", "guess")}
        notes[name]["status"] = status.to_dict()
        if status.ok:
            parts.append(columns | {"sensor": np.full(len(columns["view"]), name)})
    names = np.concatenate([np.zeros(0, "U1"), *(p["sensor"] for p in parts)])
    return concatenate_columns(parts, KEYPOINTS_SCHEMA) | {"sensor": names}, notes


def assign_keypoints(setup: Setup, T_robot_sensor: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns of pairs.parquet: all keypoints, assigned as at the start of solve."""
    state = initial_state(setup, T_robot_sensor, INITIAL_NOISE_FACTOR)
    _, assignments = start_from_initial_guess(setup, state)
    parts = [
        g.keypoints
        | {
            "sensor": np.full(len(a.feature), g.sensor),
            "candidate_feature": a.candidate_feature,
            "residual": pad_to_two_columns(a.residual),
            "standardized_residual": a.standardized_norm,
            "is_inlier": a.feature >= 0,
        }
        for g, a in zip(setup.groups, assignments, strict=True)
    ]
    return concatenate_columns(parts, PAIRS_SCHEMA)


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--keypoints", "keypoints.parquet of each sensor")
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--output", "pairs.parquet to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    options = args.options
    keypoints, notes = read_keypoints(args.keypoints, sorted(options["sensors"]))
    placement_columns, _, _ = read_table(args.placements, PLACEMENTS_SCHEMA)
    guesses = {n: note["guess"] for n, note in notes.items()}
    options["sensors"] = with_lens_from_log(options["sensors"], guesses.items())
    mounts = mounts_from_guesses([guesses])
    session = session_keypoints_from_notes(
        session="",
        keypoints=keypoints,
        notes=notes,
        placement_columns=placement_columns,
        mounts=mounts,
        options=options,
    )
    setup, T_robot_sensor = build_setup([session], mounts, options)
    pairs = assign_keypoints(setup, T_robot_sensor)
    write_table(args.output, PAIRS_SCHEMA, pairs, notes=notes)
    for name in T_robot_sensor:
        is_inlier = pairs["is_inlier"][pairs["sensor"] == name]
        share = 100 * np.mean(is_inlier)
        logger.info("%s: %d measurements, %.0f %% inliers", name, len(is_inlier), share)


if __name__ == "__main__":
    run_stage(main)
