"""The first assignment of each measurement to a part of a target.

Reads   keypoints.parquet of all sensors of a session, placements.parquet
Writes  pairs.parquet: the keypoints with the feature each belongs to, -1 for none; its notes hold
        the working pose and the status of every sensor
Decides with calib.kinds, from the pose that extract worked out for each sensor.
"""

import numpy as np

from calib import (
    chain,
    cropping,
    estimation,
    extraction,
    given,
    lenses,
    placements,
    rig,
    stage,
    tables,
    targets,
)
from calib.stage import logger


def assigned(name, keypoints, T_robot_sensor, places, options, shapes):
    """Columns of pairs.parquet of one sensor."""
    numbers = sorted(set(keypoints["placement"].tolist()))
    setup = given.Setup(
        models={name: rig.model(options["sensors"][name])},
        targets=shapes,
        placements=[places[k] for k in numbers],
        groups=placements.groups(keypoints, name, {k: i for i, k in enumerate(numbers)}),
        associate=options["associate"],
        prior={},
    )
    noise = extraction.NOISE[options["sensors"][name]["kind"]]
    state = chain.start(setup, {name: T_robot_sensor}, noise)
    parts = [
        g.keypoints | {"sensor": np.full(len(a.feature), name), "feature": a.feature}
        for g, a in zip(setup.groups, estimation.assign_first(setup, state), strict=True)
    ]
    return tables.concatenate(parts, tables.PAIRS)


def main(argv=None):
    args = stage.parser(
        __doc__,
        keypoints="*input",
        placements="input",
        output="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    shapes = {n: targets.from_config(c) for n, c in options["targets"].items()}
    table, _, _ = tables.read(args.placements, tables.PLACEMENTS)
    parts, notes = [], {}
    for path, name in zip(args.keypoints, sorted(options["sensors"]), strict=True):
        keypoints, status, found = tables.read(path, tables.KEYPOINTS)
        notes[name] = {k: found[k] for k in ("T_robot_sensor", "guess")}
        notes[name]["status"] = status.to_dict()
        if status.ok:
            T, blocks = np.array(found["T_robot_sensor"]), options["targets"]
            mounts = cropping.mounts(blocks, found["guess"])
            places = placements.still(table, "", blocks, options["mocap"], mounts)
            options["sensors"] = lenses.told(options["sensors"], [(name, found["guess"])])
            parts.append(assigned(name, keypoints, T, places, options, shapes))
            share = np.mean(parts[-1]["feature"] >= 0)
            logger.info(
                "%s: %d measurements, %.0f %% members", name, len(parts[-1]["feature"]), 100 * share
            )
    tables.write(args.output, tables.PAIRS, tables.concatenate(parts, tables.PAIRS), notes=notes)


if __name__ == "__main__":
    stage.run(main)
