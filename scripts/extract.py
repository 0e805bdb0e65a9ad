"""Extract the keypoints of one sensor.

Reads   views.parquet, moving_views.parquet, placements.parquet, mocap.parquet, guess.json
Writes  keypoints.parquet: corners; returns near a target's surface, more than solve uses; outline
        crossings. Each with its σ and stamp. Its notes hold the outcome of every kept view,
        expected against found, and the working pose that the views of this sensor agree on.
        moving_keypoints.parquet: the same for moving targets; the number of a placement is the
        number of its view
Starts from the initial guess and refines the working pose with the sensor's own views.
"""

import argparse
from collections.abc import Sequence

from calib.extraction.extraction_inputs import make_extraction_context
from calib.extraction.extraction_results import Extraction, extraction_status
from calib.extraction.extractor_registry import SENSOR_EXTRACTORS
from calib.extraction.moving_keypoints import extract_moving_views
from calib.io.parquet_tables import read_table, write_table
from calib.io.stage_cli import (
    StageArgumentParser,
    limit_opencv_threads,
    logger,
    read_json,
    run_stage,
)
from calib.io.table_schemas import KEYPOINTS_SCHEMA, MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.sensors.sensor_models import sensor_model_from_config, with_log_metadata
from calib.views.sensor_croppers import CROPPERS


def log_extraction(name: str, still: Extraction, moving: Extraction) -> None:
    """Log the views without keypoints, and the counts."""
    for outcome in still.outcomes:
        if not outcome.status.ok:
            logger.info("view %d: %s", outcome.view, outcome.status)
    for kind, extraction in (("views", still), ("views of moving targets", moving)):
        logger.info(
            "%s: %d of %d %s, %d keypoints",
            name,
            extraction.n_used_views,
            len(extraction.outcomes),
            kind,
            extraction.n_keypoints,
        )


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--views", "views.parquet")
    parser.add_path("--moving-views", "moving_views.parquet")
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--guess", "guess.json")
    parser.add_path("--output", "keypoints.parquet to write")
    parser.add_path("--moving-keypoints", "moving_keypoints.parquet to write")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the stage."""
    args = _parse_arguments(argv)
    limit_opencv_threads()
    options, guess = args.options, read_json(args.guess)
    kind = options["sensor"]["kind"]
    views, status, _ = read_table(args.views, CROPPERS[kind].schema)
    still, moving = Extraction.empty(), Extraction.empty()
    if status.ok:
        placements, _, _ = read_table(args.placements, PLACEMENTS_SCHEMA)
        model = sensor_model_from_config(with_log_metadata(options["sensor"], guess))
        context = make_extraction_context(options, model, placements, guess)
        still = SENSOR_EXTRACTORS[kind].extract(context, views)
        status = extraction_status(options["name"], still)
    if still.T_robot_sensor is not None:
        moving_views, _, _ = read_table(args.moving_views, CROPPERS[kind].schema)
        poses, _, _ = read_table(args.mocap, MOCAP_SCHEMA)
        moving = extract_moving_views(
            context,
            moving_views,
            still.T_robot_sensor,
            poses=poses,
            guess_json=guess,
            options=options,
        )
    T = still.T_robot_sensor
    notes = {
        "outcomes": still.outcomes_json(),
        "T_robot_sensor": None if T is None else T.tolist(),
        "guess": guess,
    }
    write_table(args.output, KEYPOINTS_SCHEMA, still.keypoints, status, notes)
    moving_notes = {"outcomes": moving.outcomes_json()}
    write_table(args.moving_keypoints, KEYPOINTS_SCHEMA, moving.keypoints, status, moving_notes)
    log_extraction(options["name"], still, moving)


if __name__ == "__main__":
    run_stage(main)
