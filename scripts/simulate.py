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
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from simulation import session_recording
from simulation.config_and_truth import simulated_log_path, write_simulated_config, write_truth
from simulation.placement_sampling import draw_placements
from simulation.ros_log import write_simulated_mcap
from simulation.sensor_mounts import build_rig, bump_last_sensor, draw_displacement, perturb_pose
from simulation.sensors.camera_exposure import IMAGE_ENCODERS
from simulation.sensors.mocap_errors import draw_label_swaps
from simulation.session_recording import SessionTruth, generate_messages, mcs_time_span
from simulation.simulated_rigs import (
    COMPRESSED_ENCODINGS,
    LIDAR_CHOICES,
    SIMULATED_RIGS,
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
) = range(9)  # streams of random numbers
SENSOR_ARGUMENTS = (  # flag, what it takes, what it does; of all lidars or all cameras of the rig
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
ERROR_ARGUMENTS = (  # flag, default, what it is
    ("--range-noise-m", 0.0, "along the beam, standard deviation"),
    ("--beam-bias-m", 0.0, "of each beam's range, drawn once, standard deviation"),
    ("--beam-divergence-deg", 0.0, "angle across a beam; more than 0 mixes returns at edges"),
    ("--image-noise", 0.0, "grey levels per channel, standard deviation"),
    ("--blur-px", 0.0, "of the lens: Gaussian, standard deviation"),
    ("--exposure-s", 0.0, "how long a shutter is open, half of it before the stamp"),
    ("--mcs-noise-m", 0.0, "per axis and sample, standard deviation"),
    ("--mcs-noise-deg", 0.0, "likewise"),
    ("--mcs-bias-m", 0.0, "per axis, drawn once per body and placement"),
    ("--mcs-bias-deg", 0.0, "likewise"),
    ("--mcs-late-s", 0.0, "by which its stamps are late"),
    ("--mcs-drift-ppm", 0.0, "millionths by which they get later as a session goes on"),
    ("--mcs-dropout", 0.0, "share of each body's samples that is lost, in bursts"),
    ("--mount-m", 0.0, "unstated offset of a target in its body: length"),
    ("--mount-deg", 0.0, "and angle"),
    ("--remount-m", 0.0, "of the robot's markers in every session but the first: length"),
    ("--remount-deg", 0.0, "and angle"),
    ("--bump-m", 0.0, "of the rig's last sensor in the last session: length"),
    ("--bump-deg", 0.0, "and angle"),
    ("--target-scale", 1.0, "size of the targets as built over the size written in the config"),
    ("--guess-error-m", 0.03, "written guess: uniform per axis within ±"),
    ("--guess-error-deg", 5.0, "likewise"),
)


def parse_simulation_arguments(argv):
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
    for flag, kind, what in SENSOR_ARGUMENTS:
        add(flag, help=what, **kind)
    for flag, default, what in ERROR_ARGUMENTS:
        add(flag, type=float, default=default, help=what)
    named = parser.parse_known_args(argv)[0].rig
    parser.set_defaults(**SIMULATED_RIGS[named].default_arguments)
    return parser.parse_args(argv)


def _parse_target_names(text):
    names = text.split(",")
    if set(names) - set(SIMULATED_TARGETS) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{text}: expected some of {','.join(SIMULATED_TARGETS)}")
    return [name for name in SIMULATED_TARGETS if name in names]


def draw_sessions(args):
    """Sessions of the arguments, and the guesses T_robot_sensor (4, 4) to be written, by sensor."""
    rig = customize_rig(SIMULATED_RIGS[args.rig], args)
    built = build_rig(rig, _make_rng(args, RIG_SEED), _make_rng(args, BEAM_SEED), args.beam_bias_m)
    error, rng = (args.guess_error_m, args.guess_error_deg), _make_rng(args, GUESS_SEED)
    guesses = {k: perturb_pose(rng, T, *error) for k, T in built.T_robot_sensor.items()}
    rng = _make_rng(args, MOUNT_SEED)
    shifts = {k: draw_displacement(rng, args.mount_m, args.mount_deg) for k in args.targets}
    kinds = layouts_for_targets(rig, args.targets)
    sessions = [_draw_session(args, built, kinds, shifts, *s) for s in enumerate(rig.session_names)]
    return sessions, guesses


def _make_rng(args, seed_stream, session=0):
    return np.random.default_rng([args.seed, seed_stream, session])


def _draw_session(args, rig, layouts, target_mounts, session_number, session_name):
    """The record.Session of that number and name."""
    rng = [_make_rng(args, stream, session_number) for stream in range(SWAP_SEED + 1)]
    # Drawn with targets of the size written in the config, whatever size they are built in.
    drawn = draw_placements(
        rng[PLACEMENT_SEED], build_scene(args.targets), rig, layouts, args.placements, args.upright
    )
    times = schedule_placements(drawn.time_slots, args.hold_s, args.move_s)
    sigma = np.repeat([args.mcs_bias_m, np.deg2rad(args.mcs_bias_deg)], 3)
    biases = {
        k: sigma * rng[BIAS_SEED].standard_normal((args.placements, 6))
        for k in drawn.placement_poses
    }
    bodies = [session_recording.ROBOT_BODY, *(SIMULATED_TARGETS[k]["body"] for k in args.targets)]
    swaps = draw_label_swaps(rng[SWAP_SEED], args.label_swaps, bodies, *mcs_time_span(times))
    world = build_scene(args.targets, args.target_scale)
    anew = (args.remount_m, args.remount_deg) if session_number else (0.0, 0.0)
    markers = draw_displacement(_make_rng(args, MARKER_SEED, session_number), *anew)
    if (args.bump_m or args.bump_deg) and session_name == SIMULATED_RIGS[args.rig].session_names[
        -1
    ]:
        knock = draw_displacement(_make_rng(args, BUMP_SEED), args.bump_m, args.bump_deg)
        rig = bump_last_sensor(rig, knock)
    motions = (times, drawn.placement_poses, target_mounts, markers, biases, swaps)
    return SessionTruth(session_name, session_number, world, rig, *motions, args)


def write_session_log(session):
    """Write the session's log, telling how far it is; what it holds, in words."""
    path = session.arguments.out / simulated_log_path(session.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = write_simulated_mcap(path, with_progress(session, generate_messages(session)))
    listed = ", ".join(f"{n} on {topic}" for topic, n in sorted(counts.items()))
    return f"wrote {path}: {listed}; {path.stat().st_size / 1e6:.1f} MB"


def write_all_sessions(sessions):
    """What `write` says of every session; several are written in processes of their own."""
    if len(sessions) == 1:
        return [write_session_log(sessions[0])]
    # Threads of NumPy's would take the cores from the other process; they start with NumPy.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        return list(pool.map(write_session_log, sessions))


def with_progress(session, messages):
    """The messages, with a line on stderr for every tenth of the session."""
    start, end = mcs_time_span(session.placement_times_ns)
    begun, tenth = time.monotonic(), 1
    for message in messages:
        if message[0] >= start + tenth * (end - start) / 10:
            took = time.monotonic() - begun
            print(f"{session.name}: {10 * tenth} %, {took:.0f} s", file=sys.stderr, flush=True)
            tenth += 1
        yield message


def main(argv=None):
    args = parse_simulation_arguments(argv)
    sessions, guesses = draw_sessions(args)
    write_simulated_config(args.out / "config", args.rig, sessions, guesses)
    write_truth(args.out / "truth.json", sessions, guesses)
    for line in write_all_sessions(sessions):
        print(line, file=sys.stderr)


if __name__ == "__main__":
    main()
