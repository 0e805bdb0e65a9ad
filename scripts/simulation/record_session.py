"""What motion capture, lidars and cameras put into the log, in order of log time."""

from heapq import merge
from typing import NamedTuple

import numpy as np

from simulation import ros_log, sensor_mounts
from simulation.sensors import (
    camera_exposure,
    mocap_errors,
    render_image,
    scan_patterns,
    scan_scene,
)
from simulation.world import room_scene, smooth_motion

MAP, ROBOT = "mocap/world", "mocap/robot"
MARGIN_NS = 100_000_000  # by which motion capture starts earlier and ends later than all else
MOCAP, LIDAR, CAMERA, LOSSES = 10, 11, 12, 13  # streams of random numbers


class Session(NamedTuple):
    """What a log is made of: times (n, 2) of the placements, ns; T_world_body (n, 4, 4) there of
    robot and targets; T_body_target by target; T_robot_markers (4, 4), where the robot's MCS body
    sits; bias (n, 6) of the MCS by body; swaps of names (mocap.draw_swaps); the arguments. `number`
    is that of the session."""

    name: str
    number: int
    scene: room_scene.Scene
    rig: sensor_mounts.Built
    times: np.ndarray
    knots: dict
    mounts: dict
    markers: np.ndarray
    biases: dict
    swaps: list
    args: object

    def T_world(self, name, t):
        """True poses (n, 4, 4) of the robot or of a target at t (n,), ns."""
        path = smooth_motion.around if name in self.mounts else smooth_motion.straight
        return smooth_motion.poses_at(t, self.times, self.knots[name], path)

    def surfaces(self, t):
        """T_world_surface (n, 4, 4) by name at t (n,), ns."""
        return room_scene.poses({name: self.T_world(name, t) for name in self.mounts})

    def bodies(self):
        """Names of robot and targets by MCS body."""
        return {ROBOT: "robot", **{room_scene.TARGETS[k]["body"]: k for k in self.mounts}}

    def rng(self, stream, *numbers):
        """Random numbers of one stream of this session."""
        numbers = (*numbers, 0, 0)[:2]
        return np.random.default_rng([self.args.seed, stream, *numbers, self.number])


def span(times):
    """First and last time, ns, of motion capture around placements (n, 2)."""
    return int(times[0, 0]) - MARGIN_NS, int(times[-1, 1]) + MARGIN_NS


def messages(session):
    """(log time in ns, topic, type, message) of the whole session, sorted by log time."""
    lidars = [clouds(session, name, i) for i, name in enumerate(session.rig.lidars())]
    pictures = [images(session, name, i) for i, name in enumerate(session.rig.cameras)]
    return merge(transforms(session), *lidars, *pictures, key=lambda m: m[0])


def transforms(session):
    """Messages of motion capture."""
    rng, args = session.rng(MOCAP), session.args
    start, end = span(session.times)
    t = np.arange(start, end + 1, mocap_errors.PERIOD_NS)
    names = session.bodies()
    poses = {body: mocap_errors.measured(session, rng, name, t) for body, name in names.items()}
    poses = mocap_errors.swapped(poses, t, session.swaps)
    late = t + round(args.mcs_late_s * 1e9)
    late += np.round(args.mcs_drift_ppm * 1e-6 * (t - start)).astype(np.int64)
    log_times = late + 4_000_000 + rng.integers(0, 2_000_000, len(t))
    rng = session.rng(LOSSES)
    lost = {body: mocap_errors.lost(rng, len(t), args.mcs_dropout) for body in names}
    for i, (stamp, log_t) in enumerate(zip(late, log_times, strict=True)):
        seen = {body: T[i] for body, T in poses.items() if not lost[body][i]}
        if seen:
            yield log_t, "/tf", ros_log.TF, ros_log.transforms(stamp, MAP, seen)


def clouds(session, name, number):
    """Messages of a lidar; number: which of the lidars it is."""
    spec, args = session.rig.specs[name], session.args
    sector, first = np.deg2rad(spec.sector_deg), int(session.times[0, 0]) + _ns(spec.start_s)
    last = session.times[-1, 1] - spec.scans.firing(sector, 0).after[-1]
    for i, t in enumerate(range(first, last, scan_patterns.TURN_NS)):
        rng = session.rng(LIDAR, i, number)
        firing = spec.scans.firing(sector, i)
        when = t + firing.after
        T_world_lidar = session.T_world("robot", when) @ session.rig.sensors[name]
        echoes = scan_scene.scan(
            *(session.scene, session.surfaces(when), T_world_lidar, firing, t, rng),
            noise=args.range_noise_m,
            bias=session.rig.beam_bias[name],
            spread=np.deg2rad(args.beam_divergence_deg),
        )
        log_t = t + scan_patterns.TURN_NS + 2_000_000 + rng.integers(0, 1_000_000)
        message = ros_log.cloud(t, name, spec.driver, echoes)
        yield log_t, spec.topic, message.__msgtype__, message


def images(session, name, number):
    """Messages of a camera, with a CameraInfo each where there is one; number: which of them."""
    spec, camera, args = session.rig.specs[name], session.rig.cameras[name], session.args
    view = render_image.view(camera)
    shutter = camera_exposure.Shutter(
        lambda t, points: image_at(session, name, view, t, points),
        *(session.times, args.exposure_s, args.blur_px),
    )
    info = ros_log.camera_info(camera)
    for i, t in enumerate(stamps(session, spec)):
        rng = session.rng(CAMERA, i, number)
        pixels = camera_exposure.expose(shutter.open(t), spec.encoding, args.image_noise, rng)
        log_t = t + 20_000_000 + rng.integers(0, 5_000_000)
        yield log_t, *ros_log.image(t, name, spec, pixels)
        if info:
            yield log_t, namespace(spec.topic) + "/camera_info", ros_log.INFO, info(t, name)


def stamps(session, spec):
    """Stamps of the images of a rigs.Camera, ns."""
    start, end = int(session.times[0, 0]) + _ns(spec.start_s), int(session.times[-1, 1])
    return range(start, end, _ns(1 / spec.hz))


def namespace(topic):
    """A topic without its last part."""
    return topic.rsplit("/", 1)[0]


def image_at(session, name, view, t, points):
    """Unrounded image (height, width, 3) at t, ns, with so many points per pixel at targets."""
    when = np.array([t])
    T_surfaces = {k: T.reshape(-1, 4, 4)[0] for k, T in session.surfaces(when).items()}
    T_world_camera = session.T_world("robot", when)[0] @ session.rig.sensors[name]
    return render_image.render(view, session.scene, T_surfaces, T_world_camera, points)


def _ns(seconds):
    return round(seconds * 1e9)
