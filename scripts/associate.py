"""The first assignment of each measurement to a part of a target.

Reads   keypoints.parquet of all sensors of a session, placements.parquet
Writes  pairs.parquet: the keypoints with the feature each belongs to, -1 for none; its notes hold
        the working pose and the status of every sensor
Decides with calib.estimation.residuals, from the pose that extract worked out for each sensor.
"""

import numpy as np

from calib.estimation import estimate_state, estimation_problem, measurement_groups, solver
from calib.extraction import extractor_registry
from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.stage_cli import logger
from calib.sensors import lens_from_log, sensor_models
from calib.targets import target_shapes
from calib.views import frame_selection


def assigned(name, keypoints, T_robot_sensor, places, options, shapes):
    """Columns of pairs.parquet of one sensor."""
    numbers = sorted(set(keypoints["placement"].tolist()))
    setup = estimation_problem.Setup(
        models={name: sensor_models.model(options["sensors"][name])},
        targets=shapes,
        placements=[places[k] for k in numbers],
        groups=measurement_groups.groups(keypoints, name, {k: i for i, k in enumerate(numbers)}),
        associate=options["associate"],
        prior={},
    )
    noise = extractor_registry.NOISE[options["sensors"][name]["kind"]]
    state = estimate_state.start(setup, {name: T_robot_sensor}, noise)
    parts = [
        g.keypoints | {"sensor": np.full(len(a.feature), name), "feature": a.feature}
        for g, a in zip(setup.groups, solver.assign_first(setup, state), strict=True)
    ]
    return parquet_tables.concatenate(parts, table_schemas.PAIRS)


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        keypoints="*input",
        placements="input",
        output="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    shapes = {n: target_shapes.from_config(c) for n, c in options["targets"].items()}
    table, _, _ = parquet_tables.read(args.placements, table_schemas.PLACEMENTS)
    parts, notes = [], {}
    for path, name in zip(args.keypoints, sorted(options["sensors"]), strict=True):
        keypoints, status, found = parquet_tables.read(path, table_schemas.KEYPOINTS)
        notes[name] = {k: found[k] for k in ("T_robot_sensor", "guess")}
        notes[name]["status"] = status.to_dict()
        if status.ok:
            T, blocks = np.array(found["T_robot_sensor"]), options["targets"]
            mounts = frame_selection.mounts(blocks, found["guess"])
            places = measurement_groups.still(table, "", blocks, options["mocap"], mounts)
            options["sensors"] = lens_from_log.told(options["sensors"], [(name, found["guess"])])
            parts.append(assigned(name, keypoints, T, places, options, shapes))
            share = np.mean(parts[-1]["feature"] >= 0)
            logger.info(
                "%s: %d measurements, %.0f %% members", name, len(parts[-1]["feature"]), 100 * share
            )
    parquet_tables.write(
        args.output,
        table_schemas.PAIRS,
        parquet_tables.concatenate(parts, table_schemas.PAIRS),
        notes=notes,
    )


if __name__ == "__main__":
    stage_cli.run(main)
