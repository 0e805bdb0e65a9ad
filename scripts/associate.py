"""The first assignment of each measurement to a part of a target.

Reads   keypoints.parquet of all sensors of a session, placements.parquet
Writes  pairs.parquet: the keypoints with the feature each belongs to, -1 for none; its notes hold
        the working pose and the status of every sensor
Decides with calib.estimation.residuals, from the pose that extract worked out for each sensor.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from calib.estimation.estimate_state import initial_state
from calib.estimation.estimation_problem import Setup
from calib.estimation.measurement_groups import group_keypoints, make_still_placements
from calib.estimation.solver import assign_at_initial_guess
from calib.extraction.extractor_registry import NOISE_FACTORS
from calib.io.parquet_tables import concatenate_columns, read_table, write_table
from calib.io.stage_cli import StageArgumentParser, logger, run_stage
from calib.io.table_schemas import KEYPOINTS_SCHEMA, PAIRS_SCHEMA, PLACEMENTS_SCHEMA
from calib.sensors.lens_from_log import with_lens_from_log
from calib.sensors.sensor_models import sensor_model_from_config
from calib.targets.target_shapes import target_from_config
from calib.views.target_placements import mounts_from_guess


def assign_sensor_measurements(
    sensor, keypoints, T_robot_sensor, placements, options, target_shapes
):
    """Columns of pairs.parquet of one sensor."""
    numbers = sorted(set(keypoints["placement"].tolist()))
    setup = Setup(
        models={sensor: sensor_model_from_config(options["sensors"][sensor])},
        targets=target_shapes,
        placements=[placements[k] for k in numbers],
        groups=group_keypoints(keypoints, sensor, {k: i for i, k in enumerate(numbers)}),
        associate_options=options["associate"],
        sensor_priors={},
    )
    noise = NOISE_FACTORS[options["sensors"][sensor]["kind"]]
    state = initial_state(setup, {sensor: T_robot_sensor}, noise)
    parts = [
        g.keypoints | {"sensor": np.full(len(a.feature), sensor), "candidate_feature": a.feature}
        for g, a in zip(setup.groups, assign_at_initial_guess(setup, state), strict=True)
    ]
    return concatenate_columns(parts, PAIRS_SCHEMA)


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_paths("--keypoints", "keypoints.parquet of each sensor")
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--output", "pairs.parquet to write")
    return parser.parse_args(argv)


def main(argv=None):
    args = _parse_arguments(argv)
    options = args.options
    shapes = {n: target_from_config(c) for n, c in options["targets"].items()}
    table, _, _ = read_table(args.placements, PLACEMENTS_SCHEMA)
    parts, notes = [], {}
    for path, name in zip(args.keypoints, sorted(options["sensors"]), strict=True):
        keypoints, status, found = read_table(path, KEYPOINTS_SCHEMA)
        notes[name] = {k: found[k] for k in ("T_robot_sensor", "guess")}
        notes[name]["status"] = status.to_dict()
        if status.ok:
            T, blocks = np.array(found["T_robot_sensor"]), options["targets"]
            mounts = mounts_from_guess(blocks, found["guess"])
            places = make_still_placements(table, "", blocks, options["mocap"], mounts)
            options["sensors"] = with_lens_from_log(options["sensors"], [(name, found["guess"])])
            parts.append(assign_sensor_measurements(name, keypoints, T, places, options, shapes))
            share = np.mean(parts[-1]["candidate_feature"] >= 0)
            logger.info(
                "%s: %d measurements, %.0f %% members",
                name,
                len(parts[-1]["candidate_feature"]),
                100 * share,
            )
    write_table(
        args.output,
        PAIRS_SCHEMA,
        concatenate_columns(parts, PAIRS_SCHEMA),
        notes=notes,
    )


if __name__ == "__main__":
    run_stage(main)
