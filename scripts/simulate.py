"""Write a recording with known truth: a robot with a VLP-16 and a camera, targets, motion capture.

Robot and targets rest for --hold-s at every placement, each target in view of the lidar and the
first one of the camera, and move smoothly in between. Into OUT go

    logs/sim.mcap        /tf 100 Hz, /velodyne_points 10 Hz, /camera/image_raw
    config/              config.yaml, rigs/sim.yaml, targets/*.yaml: ready for `snakemake -d OUT`
    truth.json           T_robot_sensor, placements with T_robot_target, and everything else drawn

Surfaces are met exactly, points are taken while the lidar turns, pixels are integrals. The same
arguments give the same bytes; a noise switched on or off leaves rig and placements as they are.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from calib.geometry import pose, so3_exp
from calib.sim import files, log, motion, placements, record, scene

RIG, PLACES, GUESS, BIAS, MOUNTS = range(5)  # streams of random numbers


def parse(argv):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("out", type=Path, metavar="OUT")
    add("--seed", type=int, default=1)
    add("--placements", type=int, default=10)
    add("--hold-s", type=float, default=1.0, help="how long everything rests at a placement")
    add("--move-s", type=float, default=0.8, help="how long it moves to the next")
    add("--targets", type=_targets, default=["board", "cylinder"], help="default board,cylinder")
    add("--range-noise-m", type=float, default=0.0, help="along the beam, standard deviation")
    add("--image-noise", type=float, default=0.0, help="grey levels per channel, likewise")
    add("--mcs-noise-m", type=float, default=0.0, help="per axis and sample, likewise")
    add("--mcs-noise-deg", type=float, default=0.0)
    add("--mcs-bias-m", type=float, default=0.0, help="per axis, drawn once per body and placement")
    add("--mcs-bias-deg", type=float, default=0.0)
    add("--mcs-late-s", type=float, default=0.0, help="by which its stamps are late")
    add(
        "--mount-m", type=float, default=0.0, help="unstated offset of a target in its body: length"
    )
    add("--mount-deg", type=float, default=0.0, help="and angle")
    add(
        "--guess-error-m", type=float, default=0.03, help="written guess: uniform per axis within ±"
    )
    add("--guess-error-deg", type=float, default=5.0)
    add("--sector-deg", type=float, default=100.0, help="azimuths recorded: ± about the lidar's x")
    add("--camera-hz", type=float, default=4.0)
    add("--encoding", choices=["bgr8", "mono8"], default="bgr8")
    add("--distortion", type=float, nargs=4, default=[0.0] * 4, metavar=("K1", "K2", "P1", "P2"))
    return parser.parse_args(argv)


def _targets(text):
    names = text.split(",")
    if set(names) - set(scene.TARGETS) or len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{text}: expected some of {','.join(scene.TARGETS)}")
    return [name for name in scene.TARGETS if name in names]


def draw(args):
    """Session of the arguments, and the guesses T_robot_sensor (4, 4) to be written, by sensor."""
    rng = [np.random.default_rng([args.seed, stream]) for stream in range(5)]
    world = scene.build(args.targets)
    rig = placements.draw_rig(rng[RIG], args.distortion)
    times = motion.placement_times(args.placements, args.hold_s, args.move_s)
    knots = placements.draw(rng[PLACES], world, rig, args.targets, args.placements)
    error = (args.guess_error_m, args.guess_error_deg)
    guesses = {k: placements.perturb(rng[GUESS], T, *error) for k, T in rig.sensors.items()}
    sigma = np.repeat([args.mcs_bias_m, np.deg2rad(args.mcs_bias_deg)], 3)
    biases = {k: sigma * rng[BIAS].standard_normal((args.placements, 6)) for k in knots}
    mounts = {k: _mount(rng[MOUNTS], args.mount_m, args.mount_deg) for k in args.targets}
    return record.Session(world, rig, times, knots, mounts, biases, args), guesses


def _mount(rng, length_m, angle_deg):
    """A pose (4, 4) of that length and angle, in random directions."""
    shift, axis = rng.standard_normal((2, 3))
    shift, axis = shift / np.linalg.norm(shift), axis / np.linalg.norm(axis)
    return pose(so3_exp(np.deg2rad(angle_deg) * axis), length_m * shift)


def main(argv=None):
    args = parse(argv)
    session, guesses = draw(args)
    files.write_config(args.out / "config", session, guesses)
    path = args.out / files.LOG
    path.parent.mkdir(parents=True, exist_ok=True)
    counts = log.write(path, record.messages(session))
    files.write_truth(args.out / "truth.json", session, guesses)
    listed = ", ".join(f"{n} on {topic}" for topic, n in sorted(counts.items()))
    print(f"wrote {path}: {listed}; {path.stat().st_size / 1e6:.1f} MB", file=sys.stderr)


if __name__ == "__main__":
    main()
