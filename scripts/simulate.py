"""Write recordings with known truth: a robot with lidars and cameras, targets, motion capture.

Robot and targets rest for --hold-s at every placement, each target in view of the sensors that
the rig (simulation/simulated_rigs.py) names for it, and move smoothly in between. Into OUT go

    logs/<session>.mcap  /tf 100 Hz, a cloud per lidar 10 Hz, image and CameraInfo per camera
    config/              config.yaml, rigs/<rig>.yaml, targets/*.yaml: ready for `snakemake -d OUT`
    truth.json           T_robot_sensor, placements with T_robot_target, and everything else drawn

Surfaces are met exactly, points are taken while the lidar turns, pixels are integrals. The same
arguments give the same bytes; a noise switched on or off leaves rig and placements as they are.
--rig sim: one lidar, one camera, no noise. --rig round: a lidar alone, the targets all round it.
--rig demo: two lidars and two cameras whose views do not overlap, two sessions, the noise of a
laboratory.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from calib.io.logs.ros_messages import RosMessage
from simulation.config_and_truth import simulated_log_path, write_simulated_config, write_truth
from simulation.error_arguments import ERROR_ARGUMENTS
from simulation.placement_sampling import PlacementSettings, draw_placements
from simulation.ros_log import write_simulated_mcap
from simulation.sensor_mounts import (
    BuiltRig,
    build_rig,
    bump_last_sensor,
    draw_displacement,
    perturb_pose,
)
from simulation.sensors.camera_exposure import IMAGE_ENCODERS
from simulation.sensors.mocap_errors import MarkerKnock, draw_label_swaps
from simulation.session_recording import (
    ROBOT_BODY,
    SessionTruth,
    generate_messages,
    mcs_time_span,
)
from simulation.simulated_rigs import (
    COMPRESSED_ENCODINGS,
    LIDAR_CHOICES,
    SIMULATED_RIGS,
    PlacementLayout,
    customize_rig,
    layouts_for_targets,
    simulated_camera_models,
)
from simulation.world.room_scene import SIMULATED_TARGETS, build_scene
from simulation.world.smooth_motion import schedule_placements

(
    RIG_SEED,
    PLACEMENT_SEED,
    GUESS_SEED,
    BIAS_SEED,
    MOUNT_SEED,
    BEAM_SEED,
    SWAP_SEED,
    MARKER_SEED,
    BUMP_SEED,
    KNOCK_SEED,
) = range(10)  # streams of random numbers
# Flag, options of add_argument, help; they hold for all lidars or all cameras of the rig.
SENSOR_ARGUMENTS: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("--sector-deg", {"type": float}, "azimuths recorded: ± about the lidar's x"),
    (
        "--lidar",
        {"choices": list(LIDAR_CHOICES)},
        "cloud format, with a scan pattern that fits",
    ),
    ("--camera-hz", {"type": float}, "images per second"),
    ("--camera-model", {"choices": simulated_camera_models()}, "with parameters for 900 by 700 px"),
    ("--encoding", {"choices": list(IMAGE_ENCODERS)}, "of Image"),
    (
        "--compressed",
        {"choices": list(COMPRESSED_ENCODINGS)},
        "CompressedImage instead of Image",
    ),
    ("--distortion", {"type": float, "nargs": 4, "metavar": ("K1", "K2", "P1", "P2")}, "radtan"),
)


def parse_simulation_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; a rig has defaults of its own."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("out", type=Path, metavar="OUT")
    add("--rig", choices=list(SIMULATED_RIGS), default="sim")
    add("--seed", type=int, default=1)
    add("--placements", type=int, default=10, help="of each session")
    add("--hold-s", type=float, default=1.0, help="how long everything rests at a placement")
    add("--move-s", type=float, default=0.8, help="how long it moves to the next")
    add(
        "--targets",
        type=_parse_target_names,
        default=["board", "cylinder"],
        help="default board,cylinder",
    )
    add("--camera-info", action="store_true", help="written in place of the cameras' params")
    add("--upright", action="store_true", help="robot and targets turn about the vertical only")
    add("--label-swaps", type=int, default=0, help="times that two bodies exchange their names")
    for flag, options, help_text in SENSOR_ARGUMENTS:
        add(flag, help=help_text, **options)
    wander_help = "slow noise about x, y and z of each body"
    add("--mcs-wander-deg", type=float, nargs=3, default=[0.0] * 3, metavar="DEG", help=wander_help)
    for flag, default, help_text in ERROR_ARGUMENTS:
        add(flag, type=float, default=default, help=help_text)
    rig_name = parser.parse_known_args(argv)[0].rig
    parser.set_defaults(**SIMULATED_RIGS[rig_name].default_arguments)
    return parser.parse_args(argv)


def _parse_target_names(text: str) -> list[str]:
    names = text.split(",")
    if set(names) - set(SIMULATED_TARGETS) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{text}: expected some of {','.join(SIMULATED_TARGETS)}")
    return [name for name in SIMULATED_TARGETS if name in names]


def draw_sessions(
    args: argparse.Namespace,
) -> tuple[list[SessionTruth], dict[str, np.ndarray]]:
    """Draw the sessions, and the first guesses T_robot_sensor (4, 4) to be written, by sensor."""
    rig = customize_rig(SIMULATED_RIGS[args.rig], args)
    built = build_rig(rig, _make_rng(args, RIG_SEED), _make_rng(args, BEAM_SEED), args.beam_bias_m)
    rng = _make_rng(args, GUESS_SEED)
    guesses = {
        name: perturb_pose(rng, T, args.guess_error_m, args.guess_error_deg)
        for name, T in built.T_robot_sensor.items()
    }
    rng = _make_rng(args, MOUNT_SEED)
    mounts = {name: draw_displacement(rng, args.mount_m, args.mount_deg) for name in args.targets}
    layouts = layouts_for_targets(rig, args.targets)
    sessions = []
    for number, name in enumerate(rig.session_names):
        sessions.append(
            _draw_session(
                args, built, number=number, name=name, layouts=layouts, target_mounts=mounts
            )
        )
    if args.bump_m or args.bump_deg:
        # After the placements are drawn: they stay the same.
        sessions[-1] = replace(sessions[-1], rig=_bump_rig(args, built))
    return sessions, guesses


def _make_rng(
    args: argparse.Namespace, seed_stream: int, session_number: int = 0
) -> np.random.Generator:
    return np.random.default_rng([args.seed, seed_stream, session_number])


def _bump_rig(args: argparse.Namespace, rig: BuiltRig) -> BuiltRig:
    T_bump = draw_displacement(_make_rng(args, BUMP_SEED), args.bump_m, args.bump_deg)
    return bump_last_sensor(rig, T_bump)


def _draw_session(
    args: argparse.Namespace,
    rig: BuiltRig,
    *,
    number: int,
    name: str,
    layouts: Sequence[PlacementLayout],
    target_mounts: Mapping[str, np.ndarray],
) -> SessionTruth:
    """Draw the placements and the errors of one session."""
    # Drawn with flat targets of the size written in the config, whatever size they are built in.
    settings = PlacementSettings(build_scene(args.targets), rig, layouts, args.upright)
    rng = _make_rng(args, PLACEMENT_SEED, number)
    drawn = draw_placements(rng, settings, args.placements)
    times = schedule_placements(drawn.time_slots, args.hold_s, args.move_s)
    start_ns, end_ns = mcs_time_span(times)
    board_warp = (args.board_bow_x_m, args.board_bow_y_m, args.board_twist_m)
    remount_m, remount_deg = (args.remount_m, args.remount_deg) if number else (0.0, 0.0)
    return SessionTruth(
        name=name,
        session_number=number,
        scene=build_scene(args.targets, args.target_scale, board_warp),
        rig=rig,
        placement_times_ns=times,
        placement_poses=drawn.placement_poses,
        T_body_target=dict(target_mounts),
        T_robot_markers=draw_displacement(
            _make_rng(args, MARKER_SEED, number), remount_m, remount_deg
        ),
        mcs_biases=_draw_mcs_biases(args, number, list(drawn.placement_poses)),
        label_swaps=draw_label_swaps(
            _make_rng(args, SWAP_SEED, number),
            args.label_swaps,
            [ROBOT_BODY, *(SIMULATED_TARGETS[target]["body"] for target in args.targets)],
            start_ns=start_ns,
            end_ns=end_ns,
        ),
        marker_knock=_draw_marker_knock(args, number, times),
        arguments=args,
    )


def _draw_marker_knock(
    args: argparse.Namespace, session_number: int, placement_times_ns: np.ndarray
) -> MarkerKnock | None:
    """Draw the knock of the robot's markers, if one is asked for."""
    if not (args.knock_m or args.knock_deg):
        return None
    rng = _make_rng(args, KNOCK_SEED, session_number)
    T = draw_displacement(rng, args.knock_m, args.knock_deg)
    return MarkerKnock.after_share(placement_times_ns, args.knock_after, T)


def _draw_mcs_biases(
    args: argparse.Namespace, session_number: int, names: Sequence[str]
) -> dict[str, np.ndarray]:
    """Draw the biases (placements, 6), m and rad, of robot and targets by name."""
    rng = _make_rng(args, BIAS_SEED, session_number)
    sigma = np.repeat([args.mcs_bias_m, np.deg2rad(args.mcs_bias_deg)], 3)
    return {name: sigma * rng.standard_normal((args.placements, 6)) for name in names}


def write_session_log(session: SessionTruth) -> str:
    """Write the log of a session with progress on stderr; returns what it holds, in words."""
    path = session.arguments.out / simulated_log_path(session.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = write_simulated_mcap(path, with_progress(session, generate_messages(session)))
    topics = ", ".join(f"{n} on {topic}" for topic, n in sorted(counts.items()))
    return f"wrote {path}: {topics}; {path.stat().st_size / 1e6:.1f} MB"


def write_all_sessions(sessions: Sequence[SessionTruth]) -> list[str]:
    """Write the logs of all sessions, several in processes of their own; returns what they hold."""
    if len(sessions) == 1:
        return [write_session_log(sessions[0])]
    # Threads of NumPy would take the cores from the other process; they start with NumPy.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        return list(pool.map(write_session_log, sessions))


def with_progress(session: SessionTruth, messages: Iterator[RosMessage]) -> Iterator[RosMessage]:
    """Pass the messages on, with a line on stderr for every tenth of the session."""
    start, end = mcs_time_span(session.placement_times_ns)
    start_s, tenth = time.monotonic(), 1
    for message in messages:
        if message.log_time_ns >= start + tenth * (end - start) / 10:
            elapsed_s = time.monotonic() - start_s
            print(f"{session.name}: {10 * tenth} %, {elapsed_s:.0f} s", file=sys.stderr, flush=True)
            tenth += 1
        yield message


def main(argv: Sequence[str] | None = None) -> None:
    """Run the simulator."""
    args = parse_simulation_arguments(argv)
    sessions, guesses = draw_sessions(args)
    write_simulated_config(args.out / "config", args.rig, sessions, guesses)
    write_truth(args.out / "truth.json", sessions, guesses)
    for line in write_all_sessions(sessions):
        print(line, file=sys.stderr)


if __name__ == "__main__":
    main()
