"""What motion capture, lidar and camera put into the log, in order of log time."""

from heapq import merge
from typing import NamedTuple

import numpy as np

from calib.geometry import inverse, se3_exp
from calib.sim import camera as cameras
from calib.sim import lidar as lidars
from calib.sim import log, motion
from calib.sim import scene as scenes

MAP, ROBOT = "mocap/world", "mocap/robot"
TOPICS = {"velodyne": "/velodyne_points", "camera": "/camera/image_raw"}
MCS_NS, MARGIN_NS = 10_000_000, 100_000_000  # period; how much earlier and later than all else
LIDAR_START_NS, CAMERA_START_NS = 3_000_000, 20_000_000
MOCAP_STREAM, LIDAR_STREAM, CAMERA_STREAM = 10, 11, 12  # of random numbers, one per kind of message


class Session(NamedTuple):
    """What a log is made of: times (n, 2) of the placements, ns; T_world_body (n, 4, 4) there of
    robot and targets; T_body_target by target; bias (n, 6) of the MCS by body; the arguments."""

    scene: scenes.Scene
    rig: object
    times: np.ndarray
    knots: dict
    mounts: dict
    biases: dict
    args: object


def messages(session):
    """(log time in ns, topic, type, message) of the whole session, sorted by log time."""
    return merge(_mocap(session), _clouds(session), _images(session), key=lambda m: m[0])


def T_world(session, name, t):
    """True poses (n, 4, 4) of the robot or of a target at t (n,), ns."""
    return motion.poses_at(t, session.times, session.knots[name])


def surfaces_at(session, t):
    """T_world_surface (n, 4, 4) by name at t (n,), ns."""
    return scenes.poses({name: T_world(session, name, t) for name in session.mounts})


def measured(session, rng, name, t):
    """Poses (n, 4, 4) that the MCS reports at t (n,), ns: with bias and white noise along the axes
    of the body."""
    T = T_world(session, name, t)
    if name in session.mounts:
        T = T @ inverse(session.mounts[name])
    bias = motion.values_at(t, session.times, session.biases[name])
    args = session.args
    sigma = np.repeat([args.mcs_noise_m, np.deg2rad(args.mcs_noise_deg)], 3)
    return T @ se3_exp(bias) @ se3_exp(sigma * rng.standard_normal((len(t), 6)))


def _mocap(session):
    rng = np.random.default_rng([session.args.seed, MOCAP_STREAM])
    start, end = session.times[0, 0] - MARGIN_NS, session.times[-1, 1] + MARGIN_NS
    t = np.arange(start, end + 1, MCS_NS)
    bodies = {ROBOT: "robot", **{scenes.TARGETS[k]["body"]: k for k in session.mounts}}
    poses = {body: measured(session, rng, name, t) for body, name in bodies.items()}
    stamps = t + round(session.args.mcs_late_s * 1e9)
    log_times = stamps + 4_000_000 + rng.integers(0, 2_000_000, len(t))
    for i, (stamp, log_t) in enumerate(zip(stamps, log_times, strict=True)):
        message = log.transforms(stamp, MAP, {body: T[i] for body, T in poses.items()})
        yield log_t, "/tf", log.TF, message


def _clouds(session):
    args = session.args
    firing = lidars.pattern(np.deg2rad(args.sector_deg))
    last = session.times[-1, 1] - firing.after[-1]
    for i, t in enumerate(range(session.times[0, 0] + LIDAR_START_NS, last, lidars.TURN_NS)):
        rng = np.random.default_rng([args.seed, LIDAR_STREAM, i])
        when = t + firing.after
        T_world_lidar = T_world(session, "robot", when) @ session.rig.sensors["velodyne"]
        surfaces = surfaces_at(session, when)
        points = lidars.scan(
            session.scene, surfaces, T_world_lidar, firing, args.range_noise_m, rng
        )
        message = log.cloud(t, "velodyne", points)
        log_t = t + lidars.TURN_NS + 2_000_000 + rng.integers(0, 1_000_000)
        yield log_t, TOPICS["velodyne"], log.CLOUD, message


def _images(session):
    args = session.args
    view = cameras.view(session.rig.camera)
    start, end = session.times[0, 0] + CAMERA_START_NS, session.times[-1, 1]
    at_rest = {}  # the image of a placement, unrounded
    for i, t in enumerate(range(start, end, round(1e9 / args.camera_hz))):
        rng = np.random.default_rng([args.seed, CAMERA_STREAM, i])
        k, way = (v[0] for v in motion.blend(np.array([t]), session.times))
        if not way and k not in at_rest:
            at_rest = {k: image_at(session, view, t, cameras.FINE)}
        exact = image_at(session, view, t, cameras.COARSE) if way else at_rest[k]
        pixels = cameras.expose(exact, args.encoding, args.image_noise, rng)
        log_t = t + 20_000_000 + rng.integers(0, 5_000_000)
        message = log.image(t, "camera", pixels, args.encoding)
        yield log_t, TOPICS["camera"], log.IMAGE, message


def image_at(session, view, t, points):
    """Unrounded image (height, width, 3) at t, ns, with so many points per pixel at targets."""
    T_surfaces = {k: T.reshape(-1, 4, 4)[0] for k, T in surfaces_at(session, np.array([t])).items()}
    T_world_camera = T_world(session, "robot", np.array([t]))[0] @ session.rig.sensors["camera"]
    return cameras.render(view, session.scene, T_surfaces, T_world_camera, points)
