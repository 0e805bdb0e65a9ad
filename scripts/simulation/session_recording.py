"""What motion capture, lidars and cameras put into the log, in order of log time."""

import argparse
from heapq import merge
from typing import NamedTuple

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.logs.ros_messages import TF_TYPE, RosMessage, make_tf_message
from calib.sensors.camera.camera_info import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_info_message import make_camera_info_message
from simulation.ros_log import make_cloud_message, make_image_message
from simulation.sensor_mounts import BuiltRig
from simulation.sensors.camera_exposure import Shutter, digitize_image
from simulation.sensors.image_renderer import compute_ray_grid, render_image
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import (
    MCS_PERIOD_NS,
    apply_label_swaps,
    draw_dropouts,
    measure_body_poses,
)
from simulation.sensors.scan_patterns import SCAN_PERIOD_NS
from simulation.world.room_scene import SIMULATED_TARGETS, SimulatedScene, place_surfaces
from simulation.world.smooth_motion import (
    interpolate_around_robot,
    interpolate_line,
    interpolate_placement_poses,
)

MAP_FRAME, ROBOT_BODY = "mocap/world", "mocap/robot"
MCS_MARGIN_NS = 100_000_000  # by which motion capture starts earlier and ends later than all else
MOCAP_SEED, LIDAR_SEED, CAMERA_SEED, DROPOUT_SEED = 10, 11, 12, 13  # streams of random numbers


class SessionTruth(NamedTuple):
    """What a log is made of: times (n, 2) of the placements, ns; T_world_body (n, 4, 4) there of
    robot and targets; T_body_target by target; T_robot_markers (4, 4), where the robot's MCS body
    sits; bias (n, 6) of the MCS by body; swaps of names (mocap.draw_swaps); the arguments. `number`
    is that of the session."""

    name: str
    session_number: int
    scene: SimulatedScene
    rig: BuiltRig
    placement_times_ns: np.ndarray
    placement_poses: dict
    T_body_target: dict
    T_robot_markers: np.ndarray
    mcs_biases: dict
    label_swaps: list
    arguments: argparse.Namespace

    def true_body_poses(self, name, t):
        """True poses (n, 4, 4) of the robot or of a target at t (n,), ns."""
        path = interpolate_around_robot if name in self.T_body_target else interpolate_line
        return interpolate_placement_poses(
            t, self.placement_times_ns, self.placement_poses[name], path
        )

    def surface_poses(self, t):
        """T_world_surface (n, 4, 4) by name at t (n,), ns."""
        return place_surfaces({name: self.true_body_poses(name, t) for name in self.T_body_target})

    def names_by_body(self):
        """Names of robot and targets by MCS body."""
        return {
            ROBOT_BODY: "robot",
            **{SIMULATED_TARGETS[k]["body"]: k for k in self.T_body_target},
        }

    def make_rng(self, seed_stream, *indices):
        """Random numbers of one stream of this session."""
        indices = (*indices, 0, 0)[:2]
        return np.random.default_rng(
            [self.arguments.seed, seed_stream, *indices, self.session_number]
        )


def mcs_time_span(placement_times_ns):
    """First and last time, ns, of motion capture around placements (n, 2)."""
    return int(placement_times_ns[0, 0]) - MCS_MARGIN_NS, int(
        placement_times_ns[-1, 1]
    ) + MCS_MARGIN_NS


def generate_messages(session):
    """(log time in ns, topic, type, message) of the whole session, sorted by log time."""
    lidars = [
        generate_cloud_messages(session, name, i)
        for i, name in enumerate(session.rig.lidar_names())
    ]
    pictures = [
        generate_image_messages(session, name, i)
        for i, name in enumerate(session.rig.camera_models)
    ]
    return merge(generate_tf_messages(session), *lidars, *pictures, key=lambda m: m[0])


def generate_tf_messages(session):
    """Messages of motion capture."""
    rng, args = session.make_rng(MOCAP_SEED), session.arguments
    start, end = mcs_time_span(session.placement_times_ns)
    t = np.arange(start, end + 1, MCS_PERIOD_NS)
    names = session.names_by_body()
    poses = {body: measure_body_poses(session, rng, name, t) for body, name in names.items()}
    poses = apply_label_swaps(poses, t, session.label_swaps)
    late = t + round(args.mcs_late_s * NS_PER_S)
    late += np.round(args.mcs_drift_ppm * 1e-6 * (t - start)).astype(np.int64)
    log_times = late + 4_000_000 + rng.integers(0, 2_000_000, len(t))
    rng = session.make_rng(DROPOUT_SEED)
    lost = {body: draw_dropouts(rng, len(t), args.mcs_dropout) for body in names}
    for i, (stamp, log_t) in enumerate(zip(late, log_times, strict=True)):
        seen = {body: T[i] for body, T in poses.items() if not lost[body][i]}
        if seen:
            yield log_t, "/tf", TF_TYPE, make_tf_message(stamp, MAP_FRAME, seen)


def generate_cloud_messages(session, name, lidar_number):
    """Messages of a lidar; lidar_number: which of the lidars it is."""
    spec, args = session.rig.sensor_specs[name], session.arguments
    sector, first = (
        np.deg2rad(spec.sector_deg),
        int(session.placement_times_ns[0, 0]) + _to_ns(spec.start_s),
    )
    last = (
        session.placement_times_ns[-1, 1]
        - spec.scan_pattern.make_firing(sector, 0).column_time_ns[-1]
    )
    for i, t in enumerate(range(first, last, SCAN_PERIOD_NS)):
        rng = session.make_rng(LIDAR_SEED, i, lidar_number)
        firing = spec.scan_pattern.make_firing(sector, i)
        when = t + firing.column_time_ns
        T_world_lidar = session.true_body_poses("robot", when) @ session.rig.T_robot_sensor[name]
        echoes = scan_scene(
            *(session.scene, session.surface_poses(when), T_world_lidar, firing, t, rng),
            range_sigma_m=args.range_noise_m,
            range_bias_m=session.rig.beam_bias_m[name],
            beam_divergence_rad=np.deg2rad(args.beam_divergence_deg),
        )
        log_t = t + SCAN_PERIOD_NS + 2_000_000 + rng.integers(0, 1_000_000)
        message = make_cloud_message(t, name, spec.cloud_format, echoes)
        yield log_t, spec.topic, message.__msgtype__, message


def generate_image_messages(session, name, camera_number):
    """Messages of a camera, with a CameraInfo each where there is one; camera_number: which of them."""
    spec, camera, args = (
        session.rig.sensor_specs[name],
        session.rig.camera_models[name],
        session.arguments,
    )
    view = compute_ray_grid(camera)
    shutter = Shutter(
        lambda t, points: render_session_image(session, name, view, t, points),
        *(session.placement_times_ns, args.exposure_s, args.blur_px),
    )
    for i, t in enumerate(image_stamps(session, spec)):
        rng = session.make_rng(CAMERA_SEED, i, camera_number)
        pixels = digitize_image(shutter.capture_image(t), spec.encoding, args.image_noise, rng)
        log_t = t + 20_000_000 + rng.integers(0, 5_000_000)
        yield log_t, *make_image_message(t, name, spec, pixels)
        info = make_camera_info_message(t, name, camera)
        if info is not None:
            info_topic = f"{topic_namespace(spec.topic)}/camera_info"
            yield RosMessage(log_t, info_topic, CAMERA_INFO_TYPE, info)


def image_stamps(session, camera_spec):
    """Stamps of the images of a rigs.Camera, ns."""
    start, end = (
        int(session.placement_times_ns[0, 0]) + _to_ns(camera_spec.start_s),
        int(session.placement_times_ns[-1, 1]),
    )
    return range(start, end, _to_ns(1 / camera_spec.rate_hz))


def topic_namespace(topic):
    """A topic without its last part."""
    return topic.rsplit("/", 1)[0]


def render_session_image(session, name, ray_grid, t, n_points_per_pixel):
    """Unrounded image (height, width, 3) at t, ns, with so many points per pixel at targets."""
    when = np.array([t])
    T_surfaces = {k: T.reshape(-1, 4, 4)[0] for k, T in session.surface_poses(when).items()}
    T_world_camera = session.true_body_poses("robot", when)[0] @ session.rig.T_robot_sensor[name]
    return render_image(ray_grid, session.scene, T_surfaces, T_world_camera, n_points_per_pixel)


def _to_ns(seconds):
    return round(seconds * NS_PER_S)
