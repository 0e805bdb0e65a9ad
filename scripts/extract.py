"""Extract the keypoints of one sensor.

Reads   views.parquet, moving_views.parquet, placements.parquet, mocap.parquet, guess.json; if
        nothing is found, or what is absurd: frames.parquet, log.json, and a few frames of the log
Writes  keypoints.parquet: corners; returns near a target's surface, more than solve uses; outline
        crossings. Each with its σ and stamp. Its notes hold the outcome of every kept view,
        expected against found, and the working pose that the views of this sensor agree on.
        moving_keypoints.parquet: the same for moving targets; the number of a placement is the
        number of its view
Starts from the initial guess and refines the working pose with the sensor's own views. If nothing
agrees, mistakes of convention in the config are tried; the one that explains the data is named.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from calib.extraction.extraction_inputs import make_extraction_context
from calib.extraction.extraction_results import Extraction, extraction_status
from calib.extraction.extractor_registry import SENSOR_EXTRACTORS
from calib.extraction.mistakes.lost_agreement import find_lost_targets
from calib.extraction.moving_keypoints import extract_moving_views
from calib.initial_guess.initial_guess import OffsetGuess
from calib.io.logs.open_log import open_log, require_same_log
from calib.io.parquet_tables import Columns, read_table, write_table
from calib.io.stage_cli import (
    StageArgumentParser,
    limit_opencv_threads,
    logger,
    read_json,
    run_stage,
)
from calib.io.status import Status
from calib.io.table_schemas import FRAMES_SCHEMA, KEYPOINTS_SCHEMA, MOCAP_SCHEMA, PLACEMENTS_SCHEMA
from calib.sensors.sensor_models import sensor_model_from_config, with_log_metadata
from calib.views.sensor_croppers import CROPPERS
from calib.views.target_placements import PlacementTable


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


def find_config_mistake(
    args: argparse.Namespace, views: Columns, extraction: Extraction
) -> Status | None:
    """Return the status that names a mistake in the config, if it explains why nothing agrees."""
    options, guess, audit = args.options, read_json(args.guess), read_json(args.audit)
    T_guess = guess["T_robot_sensor"] and np.array(guess["T_robot_sensor"]["matrix"])
    lost = find_lost_targets(extraction, views, T_guess, np.array(guess["sigma"]))
    placements = PlacementTable.read(args.placements)
    sensor_audit = audit["sensors"][options["name"]]
    if T_guess is None:
        lost = sorted(options["targets"])
    if not lost or not sensor_audit["status"]["ok"] or not placements.still_target_status().ok:
        return None
    # These imports take 0.6 s, which only a search should pay.
    from calib.extraction.session_evidence import explain_lost_agreement
    from calib.initial_guess.session_search import SessionSearch

    require_same_log(options["log"], audit["fingerprint"])
    sensor = with_log_metadata(options["sensor"], sensor_audit)
    session = SessionSearch(
        log=open_log(options["log"]),
        frames=read_table(args.frames, FRAMES_SCHEMA)[0],
        placements=placements,
        poses=None,
        options=options | {"sensor": sensor},
    )
    offset = guess["time_offset_s"]
    return explain_lost_agreement(
        session.with_time_offset(OffsetGuess(offset["value"], offset["sigma"])),
        lost,
        guess_json=guess,
        poses=read_table(args.mocap, MOCAP_SCHEMA)[0],
        mocap_notes=[note for topic in audit["mocap"].values() for note in topic["found"]],
    )


def _parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = StageArgumentParser(__doc__)
    parser.add_path("--views", "views.parquet")
    parser.add_path("--moving-views", "moving_views.parquet")
    parser.add_path("--placements", "placements.parquet")
    parser.add_path("--mocap", "mocap.parquet")
    parser.add_path("--guess", "guess.json")
    parser.add_path("--frames", "frames.parquet, if nothing agrees")
    parser.add_path("--audit", "log.json, if nothing agrees")
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
    mistake = find_config_mistake(args, views, still)
    if mistake:
        status, still = mistake, Extraction(Extraction.empty().keypoints, still.outcomes)
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
