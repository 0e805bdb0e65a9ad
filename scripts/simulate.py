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

from simulation import (
    config_and_truth,
    draw_placements,
    record_session,
    ros_log,
    sensor_mounts,
    simulated_rigs,
)
from simulation.sensors import camera_exposure, mocap_errors
from simulation.world import room_scene, smooth_motion

RIG, PLACES, GUESS, BIAS, MOUNTS, BEAMS, SWAPS, MARKERS, BUMP = range(
    9
)  # streams of random numbers
SENSORS = (  # flag, what it takes, what it does; of all lidars or all cameras of the rig
    ("--sector-deg", {"type": float}, "azimuths recorded: ± about the lidar's x"),
    (
        "--lidar",
        {"choices": list(simulated_rigs.LIDARS)},
        "cloud format, with a scan pattern that fits",
    ),
    ("--camera-hz", {"type": float}, "images per second"),
    ("--camera-model", {"choices": simulated_rigs.models()}, "with parameters for 900 by 700 px"),
    ("--encoding", {"choices": list(camera_exposure.ENCODINGS)}, "of Image"),
    (
        "--compressed",
        {"choices": list(simulated_rigs.COMPRESSED)},
        "CompressedImage instead of Image",
    ),
    ("--distortion", {"type": float, "nargs": 4, "metavar": ("K1", "K2", "P1", "P2")}, "radtan"),
)
ERRORS = (  # flag, default, what it is
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


def parse(argv):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("out", type=Path, metavar="OUT")
    add("--rig", choices=list(simulated_rigs.RIGS), default="sim")
    add("--seed", type=int, default=1)
    add("--placements", type=int, default=10, help="of each session")
    add("--hold-s", type=float, default=1.0, help="how long everything rests at a placement")
    add("--move-s", type=float, default=0.8, help="how long it moves to the next")
    add("--targets", type=_targets, default=["board", "cylinder"], help="default board,cylinder")
    add("--camera-info", action="store_true", help="written in place of the cameras' params")
    add("--upright", action="store_true", help="robot and targets turn about the vertical only")
    add("--label-swaps", type=int, default=0, help="times that two bodies exchange their names")
    for flag, kind, what in SENSORS:
        add(flag, help=what, **kind)
    for flag, default, what in ERRORS:
        add(flag, type=float, default=default, help=what)
    named = parser.parse_known_args(argv)[0].rig
    parser.set_defaults(**simulated_rigs.RIGS[named].defaults)
    return parser.parse_args(argv)


def _targets(text):
    names = text.split(",")
    if set(names) - set(room_scene.TARGETS) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{text}: expected some of {','.join(room_scene.TARGETS)}")
    return [name for name in room_scene.TARGETS if name in names]


def draw(args):
    """Sessions of the arguments, and the guesses T_robot_sensor (4, 4) to be written, by sensor."""
    rig = simulated_rigs.customised(simulated_rigs.RIGS[args.rig], args)
    built = sensor_mounts.build(rig, _rng(args, RIG), _rng(args, BEAMS), args.beam_bias_m)
    error, rng = (args.guess_error_m, args.guess_error_deg), _rng(args, GUESS)
    guesses = {k: sensor_mounts.perturb(rng, T, *error) for k, T in built.sensors.items()}
    rng = _rng(args, MOUNTS)
    shifts = {
        k: sensor_mounts.displacement(rng, args.mount_m, args.mount_deg) for k in args.targets
    }
    kinds = simulated_rigs.kinds(rig, args.targets)
    sessions = [_session(args, built, kinds, shifts, *s) for s in enumerate(rig.sessions)]
    return sessions, guesses


def _rng(args, stream, session=0):
    return np.random.default_rng([args.seed, stream, session])


def _session(args, built, kinds, shifts, number, name):
    """The record.Session of that number and name."""
    rng = [_rng(args, stream, number) for stream in range(SWAPS + 1)]
    # Drawn with targets of the size written in the config, whatever size they are built in.
    drawn = draw_placements.draw(
        rng[PLACES], room_scene.build(args.targets), built, kinds, args.placements, args.upright
    )
    times = smooth_motion.placement_times(drawn.slots, args.hold_s, args.move_s)
    sigma = np.repeat([args.mcs_bias_m, np.deg2rad(args.mcs_bias_deg)], 3)
    biases = {k: sigma * rng[BIAS].standard_normal((args.placements, 6)) for k in drawn.knots}
    bodies = [record_session.ROBOT, *(room_scene.TARGETS[k]["body"] for k in args.targets)]
    swaps = mocap_errors.draw_swaps(
        rng[SWAPS], args.label_swaps, bodies, *record_session.span(times)
    )
    world = room_scene.build(args.targets, args.target_scale)
    anew = (args.remount_m, args.remount_deg) if number else (0.0, 0.0)
    markers = sensor_mounts.displacement(_rng(args, MARKERS, number), *anew)
    if (args.bump_m or args.bump_deg) and name == simulated_rigs.RIGS[args.rig].sessions[-1]:
        knock = sensor_mounts.displacement(_rng(args, BUMP), args.bump_m, args.bump_deg)
        built = sensor_mounts.bumped(built, knock)
    motions = (times, drawn.knots, shifts, markers, biases, swaps)
    return record_session.Session(name, number, world, built, *motions, args)


def write(session):
    """Write the session's log, telling how far it is; what it holds, in words."""
    path = session.args.out / config_and_truth.log_path(session.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = ros_log.write(path, told(session, record_session.messages(session)))
    listed = ", ".join(f"{n} on {topic}" for topic, n in sorted(counts.items()))
    return f"wrote {path}: {listed}; {path.stat().st_size / 1e6:.1f} MB"


def write_all(sessions):
    """What `write` says of every session; several are written in processes of their own."""
    if len(sessions) == 1:
        return [write(sessions[0])]
    # Threads of NumPy's would take the cores from the other process; they start with NumPy.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        return list(pool.map(write, sessions))


def told(session, messages):
    """The messages, with a line on stderr for every tenth of the session."""
    start, end = record_session.span(session.times)
    begun, tenth = time.monotonic(), 1
    for message in messages:
        if message[0] >= start + tenth * (end - start) / 10:
            took = time.monotonic() - begun
            print(f"{session.name}: {10 * tenth} %, {took:.0f} s", file=sys.stderr, flush=True)
            tenth += 1
        yield message


def main(argv=None):
    args = parse(argv)
    sessions, guesses = draw(args)
    config_and_truth.write_config(args.out / "config", args.rig, sessions, guesses)
    config_and_truth.write_truth(args.out / "truth.json", sessions, guesses)
    for line in write_all(sessions):
        print(line, file=sys.stderr)


if __name__ == "__main__":
    main()
