"""All sensors, targets and sessions of a rig in one problem.

Reads   pairs.parquet, placements.parquet and mocap.parquet of all its sessions, tracked.parquet of
        all their sensors
Writes  solution.json       poses, joint covariance, noise, observability, a status per sensor
        residuals.parquet   one row per measurement
        iterations.parquet  one row per round of solving and re-association
Decides which measurements are members, with the library function that associate uses, until
nothing moves. A sensor that the data cannot place gets no pose, and stops no other.
"""

from dataclasses import replace
from functools import partial

from calib.diagnosis import model_selection, next_best_view, residual_table, solution_json
from calib.diagnosis.session_repeatability import repeatability
from calib.estimation import problem_assembly
from calib.estimation.corrections import robot_markers
from calib.io import parquet_tables, stage_cli, table_schemas
from calib.io.stage_cli import logger
from calib.sensors import lens_from_log


def read_sessions(args, options):
    """{session: (pairs columns, notes, Placements by number)}, and the mounts that guess found:
    T_body_target (4, 4) to start from, by target."""
    read = [parquet_tables.read(path, table_schemas.PAIRS) for path in args.pairs]
    mounts = problem_assembly.found_mounts([notes for _, _, notes in read])
    out, anew = {}, options["remounted"]
    for session, (pairs, _, notes), path in zip(
        options["sessions"], read, args.placements, strict=True
    ):
        table, _, _ = parquet_tables.read(path, table_schemas.PLACEMENTS)
        out[session] = pairs, notes, problem_assembly.still(table, session, notes, mounts, options)
    # Those whose markers define R come first: their sensors' poses are in it.
    return {s: out[s] for s in sorted(out, key=lambda s: (s in anew, s))}, mounts


def read_motion(args, options):
    """{session: (columns of the MCS's poses, topics by body, {sensor: columns of its views in
    motion})}."""
    files, out = iter(args.tracked), {}
    for session, path in zip(options["sessions"], args.mocap, strict=True):
        sensors = options["used"][session]
        tracked = {
            name: parquet_tables.read(next(files), table_schemas.KEYPOINTS)[0] for name in sensors
        }
        poses, _, notes = parquet_tables.read(path, table_schemas.MOCAP)
        out[session] = poses, notes["topics"], tracked
    return out


def main(argv=None):
    args = stage_cli.parser(
        __doc__,
        pairs="*input, one per session",
        placements="*input, one per session",
        mocap="*input, one per session",
        tracked="*input, one per sensor of every session",
        solution="output",
        residuals="output",
        iterations="output",
        options="slice of the config",
    ).parse_args(argv)
    options = args.options
    sessions, mounts = read_sessions(args, options)
    sessions = lens_from_log.agreed(sessions)
    guesses = ((n, note["guess"]) for _, notes, _ in sessions.values() for n, note in notes.items())
    options["sensors"] = lens_from_log.told(options["sensors"], guesses)
    setup, start = problem_assembly.setup_of(sessions, mounts, options)
    notes = {s: found for s, (_, found, _) in sessions.items()}
    setup = replace(
        setup, corrections=tuple(robot_markers.corrections(notes, options["remounted"]))
    )
    wanted, most = options["solve"]["estimate"], problem_assembly.limits(setup, options["solve"])
    moving = partial(
        problem_assembly.with_motion,
        seen=read_motion(args, options),
        sessions=sessions,
        options=options,
    )
    setup, result, suspected = model_selection.estimate(setup, start, wanted, moving, **most)
    known = problem_assembly.statuses(sessions, options)
    content = solution_json.as_json(setup, result, suspected, known, options)
    content["sessions"] |= robot_markers.told(setup, result) if result.solution else {}
    placed = [n for n, sensor in content["sensors"].items() if sensor["T_robot_sensor"]]
    views = next_best_view.best_views(setup, result, placed, options["views"])
    for name, sensor in content["sensors"].items():
        sensor["next_view"] = views.get(name)
    content["repeatability"] = repeatability(setup, result, **most)
    stage_cli.write_json(args.solution, content)
    parquet_tables.write(
        args.residuals, table_schemas.RESIDUALS, residual_table.residuals(setup, result)
    )
    rounds = {k: [r[k] for r in result.rounds] for k in table_schemas.ITERATIONS.names}
    parquet_tables.write(args.iterations, table_schemas.ITERATIONS, rounds)
    for r in result.rounds:
        logger.info(
            "round %(round)d: cost %(cost).6g, %(ipopt_iterations)d iterations, "
            "%(members)d members, %(changed)d changed, step %(step_m).1e m %(step_rad).1e rad",
            r,
        )
    logger.info("settled" if result.settled else "not settled")
    for h in setup.corrections:
        logger.info("estimated besides: %s of %s", h.name, h.of)
    for target in sorted(set(setup.mounts) & set(setup.alignment)):
        logger.info("estimated besides: T_body_target of %s", target)


if __name__ == "__main__":
    stage_cli.run(main)
