"""Record a simulated session: the messages of motion capture, lidars and cameras by log time."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from heapq import merge

import numpy as np

from calib.geometry.units import NS_PER_S
from calib.io.logs.ros_messages import TF_TYPE, RosMessage, make_tf_message
from calib.sensors.camera.camera_info_reader import CAMERA_INFO_TYPE
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from simulation.ros_log import make_cloud_message, make_image_message
from simulation.sensor_mounts import BuiltRig
from simulation.sensors.camera_exposure import Shutter, digitize_image
from simulation.sensors.image_renderer import RayGrid, compute_ray_grid, render_image
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import (
    LabelSwap,
    MarkerKnock,
    apply_label_swaps,
    draw_dropouts,
    measure_body_poses,
)
from simulation.sensors.scan_patterns import SCAN_PERIOD_NS
from simulation.simulated_rigs import SimulatedCamera
from simulation.world.ray_casting import PosedScene
from simulation.world.room_scene import SIMULATED_TARGETS, SimulatedScene, place_surfaces
from simulation.world.smooth_motion import (
    interpolate_around_robot,
    interpolate_line,
    interpolate_placement_poses,
)

MAP_FRAME, ROBOT_BODY = "mocap/world", "mocap/robot"
MCS_MARGIN_NS = 100_000_000  # motion capture starts earlier and ends later than all else
MOCAP_SEED, LIDAR_SEED, CAMERA_SEED, DROPOUT_SEED = 10, 11, 12, 13  # streams of random numbers


@dataclass(frozen=True)
class SessionTruth:
    """Everything that a session's log is made of.

    placement_times_ns (n, 2): start and end of the placements; placement_poses: T_world_body
    (n, 4, 4) there of robot and targets; T_body_target by target; T_robot_markers (4, 4): where
    the robot's MCS body is, until marker_knock if there is one; mcs_biases (n, 6) by body: shift
    (m) and rotation vector (rad); arguments: of simulate.py.
    """

    name: str
    session_number: int
    scene: SimulatedScene
    rig: BuiltRig
    placement_times_ns: np.ndarray
    placement_poses: dict[str, np.ndarray]
    T_body_target: dict[str, np.ndarray]
    T_robot_markers: np.ndarray
    mcs_biases: dict[str, np.ndarray]
    label_swaps: list[LabelSwap]
    marker_knock: MarkerKnock | None
    arguments: argparse.Namespace

    def true_body_poses(self, name: str, t: np.ndarray) -> np.ndarray:
        """Return the true poses (n, 4, 4) of the robot or of a target at t (n,), ns."""
        path = interpolate_around_robot if name in self.T_body_target else interpolate_line
        return interpolate_placement_poses(
            t, self.placement_times_ns, self.placement_poses[name], path
        )

    def surface_poses(self, t: np.ndarray) -> dict[str, np.ndarray]:
        """Return T_world_surface (n, 4, 4) by name at t (n,), ns."""
        return place_surfaces({name: self.true_body_poses(name, t) for name in self.T_body_target})

    def names_by_body(self) -> dict[str, str]:
        """Return the names of robot and targets by MCS body."""
        targets = {SIMULATED_TARGETS[name]["body"]: name for name in self.T_body_target}
        return {ROBOT_BODY: "robot", **targets}

    def make_rng(self, seed_stream: int, *indices: int) -> np.random.Generator:
        """Make the random numbers of one stream of this session; up to two indices."""
        first, second, *_ = (*indices, 0, 0)
        return np.random.default_rng(
            [self.arguments.seed, seed_stream, first, second, self.session_number]
        )


def mcs_time_span(placement_times_ns: np.ndarray) -> tuple[int, int]:
    """Return the first and the last time, ns, of motion capture around placements (n, 2)."""
    first, last = int(placement_times_ns[0, 0]), int(placement_times_ns[-1, 1])
    return first - MCS_MARGIN_NS, last + MCS_MARGIN_NS


def generate_messages(session: SessionTruth) -> Iterator[RosMessage]:
    """Generate the messages of the whole session, sorted by log time."""
    lidars = [
        generate_cloud_messages(session, name, i)
        for i, name in enumerate(session.rig.lidar_names())
    ]
    cameras = [
        generate_image_messages(session, name, i)
        for i, name in enumerate(session.rig.camera_models)
    ]
    return merge(generate_tf_messages(session), *lidars, *cameras, key=lambda m: m.log_time_ns)


def generate_tf_messages(session: SessionTruth) -> Iterator[RosMessage]:
    """Generate the messages of motion capture."""
    rng, args = session.make_rng(MOCAP_SEED), session.arguments
    start, end = mcs_time_span(session.placement_times_ns)
    t = np.arange(start, end + 1, round(NS_PER_S / args.mcs_hz))
    names = session.names_by_body()
    poses = {body: measure_body_poses(session, rng, name, t) for body, name in names.items()}
    poses = apply_label_swaps(poses, t, session.label_swaps)
    stamps = t + round(args.mcs_late_s * NS_PER_S)
    stamps += np.round(args.mcs_drift_ppm * 1e-6 * (t - start)).astype(np.int64)
    log_times = stamps + 4_000_000 + rng.integers(0, 2_000_000, len(t))
    rng = session.make_rng(DROPOUT_SEED)
    n_lost = args.mcs_dropout_s * args.mcs_hz
    is_lost = {body: draw_dropouts(rng, len(t), args.mcs_dropout, n_lost) for body in names}
    for i, (stamp_ns, log_time_ns) in enumerate(zip(stamps, log_times, strict=True)):
        measured = {body: T[i] for body, T in poses.items() if not is_lost[body][i]}
        if measured:
            message = make_tf_message(stamp_ns, MAP_FRAME, measured)
            yield RosMessage(int(log_time_ns), "/tf", TF_TYPE, message)


def generate_cloud_messages(
    session: SessionTruth, name: str, lidar_number: int
) -> Iterator[RosMessage]:
    """Generate the messages of the lidar of a name and number."""
    spec, args = session.rig.lidar_spec(name), session.arguments
    sector = np.deg2rad(spec.sector_deg)
    first = int(session.placement_times_ns[0, 0]) + _to_ns(spec.start_s)
    scan_duration_ns = spec.scan_pattern.make_firing(sector, 0).column_time_ns[-1]
    last = session.placement_times_ns[-1, 1] - scan_duration_ns
    for i, t in enumerate(range(first, last, SCAN_PERIOD_NS)):
        rng = session.make_rng(LIDAR_SEED, i, lidar_number)
        firing = spec.scan_pattern.make_firing(sector, i)
        column_times = t + firing.column_time_ns
        T_world_robot = session.true_body_poses("robot", column_times)
        T_world_lidar = T_world_robot @ session.rig.T_robot_sensor[name]
        echoes = scan_scene(
            PosedScene(session.scene, session.surface_poses(column_times), T_world_lidar),
            firing,
            t,
            rng=rng,
            range_sigma_m=args.range_noise_m,
            range_bias_m=session.rig.beam_bias_m[name],
            beam_divergence_rad=np.deg2rad(args.beam_divergence_deg),
            dark_range_m=args.dark_range_m,
        )
        log_time_ns = t + SCAN_PERIOD_NS + 2_000_000 + int(rng.integers(0, 1_000_000))
        message = make_cloud_message(t, name, spec.cloud_format, echoes)
        yield RosMessage(log_time_ns, spec.topic, message.__msgtype__, message)


def generate_image_messages(
    session: SessionTruth, name: str, camera_number: int
) -> Iterator[RosMessage]:
    """Generate the images of the camera of a name and number, each with its CameraInfo."""
    spec, args = session.rig.camera_spec(name), session.arguments
    camera = session.rig.camera_models[name]
    ray_grid = compute_ray_grid(camera)

    def render_at(t: int, n_points_per_pixel: int) -> np.ndarray:
        return render_session_image(
            session, name, ray_grid, t, n_points_per_pixel=n_points_per_pixel
        )

    shutter = Shutter(render_at, session.placement_times_ns, args.exposure_s, args.blur_px)
    for i, t in enumerate(image_stamps(session, spec)):
        rng = session.make_rng(CAMERA_SEED, i, camera_number)
        pixels = digitize_image(shutter.capture_image(t), spec.encoding, args.image_noise, rng)
        log_time_ns = t + 20_000_000 + int(rng.integers(0, 5_000_000))
        yield RosMessage(log_time_ns, *make_image_message(t, name, spec, pixels))
        info = make_camera_info_message(t, name, camera)
        if info is not None:
            info_topic = f"{topic_namespace(spec.topic)}/camera_info"
            yield RosMessage(log_time_ns, info_topic, CAMERA_INFO_TYPE, info)


def image_stamps(session: SessionTruth, camera_spec: SimulatedCamera) -> range:
    """Return the stamps of a camera's images, ns."""
    start = int(session.placement_times_ns[0, 0]) + _to_ns(camera_spec.start_s)
    end = int(session.placement_times_ns[-1, 1])
    return range(start, end, _to_ns(1 / camera_spec.rate_hz))


def topic_namespace(topic: str) -> str:
    """Return a topic without its last part."""
    return topic.rsplit("/", 1)[0]


def render_session_image(
    session: SessionTruth,
    name: str,
    ray_grid: RayGrid,
    t: int,
    n_points_per_pixel: int,
) -> np.ndarray:
    """Render the unrounded image (height, width, 3) of a camera at t, ns, with that many points
    per pixel at targets."""
    instant = np.array([t])
    T_world_surfaces = {
        surface: T.reshape(-1, 4, 4)[0] for surface, T in session.surface_poses(instant).items()
    }
    T_world_robot = session.true_body_poses("robot", instant)[0]
    T_world_camera = T_world_robot @ session.rig.T_robot_sensor[name]
    posed = PosedScene(session.scene, T_world_surfaces, T_world_camera)
    return render_image(ray_grid, posed, n_points_per_pixel)


def _to_ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
