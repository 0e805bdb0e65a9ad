"""One small scene without noise, as every motion capture, lidar driver and camera would record it.

A robot looks at a board that is held at five places. Motion capture is sampled at 40 Hz, the lidar
at 5 Hz; an image is taken at each place, and one on the way to the next.
"""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from calib.geometry.se3 import invert_pose, pose_from_rpy
from calib.io.logs.ros_messages import COMPRESSED_IMAGE_TYPE, IMAGE_TYPE, TF_TYPE, make_tf_message
from helpers.log_containers import (
    BOARD_BODY,
    MAP_FRAME,
    MOCAP_TYPES,
    ROBOT_BODY,
    make_ros2_message,
    make_ros_pose,
    make_stamped_header,
)
from simulate import draw_sessions, parse_simulation_arguments
from simulation.ros_log import make_cloud_message
from simulation.sensors.camera_exposure import IMAGE_ENCODERS, digitize_image
from simulation.sensors.cloud_formats import CLOUD_FORMATS, make_point_array
from simulation.sensors.image_renderer import COARSE_POINTS_PER_PIXEL, compute_ray_grid
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.scan_patterns import SCAN_PATTERNS, SCAN_PERIOD_NS, SpinningPattern
from simulation.session_recording import mcs_time_span, render_session_image
from simulation.simulated_rigs import (
    SIMULATED_RIGS,
    SimulatedCamera,
    SimulatedLidar,
    SimulatedRig,
    TargetSpot,
)
from simulation.world.ray_casting import PosedScene

NS_PER_MS = 10**6
LOG_DELAY_NS = 2 * NS_PER_MS  # by which the log takes every message
IMAGE_SIZE_PX, FOCAL_LENGTH_PX = (360, 280), 400.0
LENS_PARAMS = (FOCAL_LENGTH_PX, FOCAL_LENGTH_PX + 1, 181.3, 138.6, 0.0, 0.0, 0.0, 0.0)
CLOUD_TOPIC, IMAGE_TOPIC = "/points", "/image"
BEAM_PATTERN = SpinningPattern(tuple(range(-15, 16, 2)), 720)
DRIVER_RIG = SimulatedRig(
    sensors={
        "lidar": SimulatedLidar(CLOUD_TOPIC, (0.15, 0.0, 0.60), (0.0, 0.0, 2.0), sector_deg=25.0),
        "camera": SimulatedCamera(
            IMAGE_TOPIC,
            (0.25, -0.10, 0.45),
            (-90.0, 0.0, -90.0),
            "radtan",
            LENS_PARAMS,
            IMAGE_SIZE_PX,
        ),
    },
    session_names=("matrix",),
    placement_layouts=({"board": TargetSpot("lidar", (-5, 5), (1.6, 2.4), ("lidar", "camera"))},),
    single_target_spots={},
    default_arguments={
        "placements": 5,
        "hold_s": 1.2,
        "move_s": 0.5,
        "targets": ["board"],
        "seed": 4,
    },
)


class RecordedScene(NamedTuple):
    """times (n,), ns, and poses {body: (n, 4, 4)} of motion capture; scans: [(t, Echoes)] of
    BEAMS, flat: of one beam; images: [(t, (h, w, 3) uint8)]; guesses and sensors: T_robot_sensor
    (4, 4) by sensor, as written and as it is."""

    mocap_times_ns: np.ndarray
    body_poses: dict
    scans: list
    single_beam_scans: list
    images: list
    guess_poses: dict
    T_robot_sensor: dict


def draw_driver_session():
    """(session, guesses) of RIG, as simulate.py draws them."""
    SIMULATED_RIGS["matrix"] = DRIVER_RIG
    try:
        sessions, guesses = draw_sessions(parse_simulation_arguments(["unused", "--rig", "matrix"]))
    finally:
        del SIMULATED_RIGS["matrix"]
    return sessions[0], guesses


@cache
def record_driver_scene():
    """The Scene; it takes two seconds."""
    session, guesses = draw_driver_session()
    start, end = mcs_time_span(session.placement_times_ns)
    t = np.arange(start, end, 25 * NS_PER_MS)
    poses = {
        ROBOT_BODY: session.true_body_poses("robot", t),
        BOARD_BODY: session.true_body_poses("board", t),
    }
    moments = range(start + 100 * NS_PER_MS, end - 100 * NS_PER_MS, 200 * NS_PER_MS)
    shown = [int(a) + dt * NS_PER_MS for a, _ in session.placement_times_ns for dt in (400, 1350)][
        :-1
    ]
    return RecordedScene(
        t,
        poses,
        [(m, _scan_echoes(session, m, BEAM_PATTERN)) for m in moments],
        [(m, _scan_echoes(session, m, SCAN_PATTERNS["flat"])) for m in moments],
        [(m, _take_image(session, m)) for m in shown],
        guesses,
        session.rig.T_robot_sensor,
    )


def _scan_echoes(session, t, pattern):
    firing = pattern.make_firing(np.deg2rad(DRIVER_RIG.sensors["lidar"].sector_deg), 0)
    when = t + firing.column_time_ns
    T = session.true_body_poses("robot", when) @ session.rig.T_robot_sensor["lidar"]
    bias = np.zeros(pattern.n_beams)
    return scan_scene(
        PosedScene(session.scene, session.surface_poses(when), T), firing, t, range_sigma_m=0.0,
        range_bias_m=bias, beam_divergence_rad=0.0,
    )  # fmt: skip


def _take_image(session, t):
    view = compute_ray_grid(session.rig.camera_models["camera"])
    exact = render_session_image(session, "camera", view, t, COARSE_POINTS_PER_PIXEL)
    return digitize_image(exact, "bgr8", 0.0, None)


# --- motion capture


def make_chain_rows(t, poses):
    """Bodies below static frames, in one TFMessage: the tracker hangs from the map's ceiling, and
    the robot sits on a plate with markers; statics come again, as ROS 1 sends them."""
    rows = [("/tf", TF_TYPE, make_tf_message(t, "tracker", {
        "plate": invert_pose(T_MAP_TRACKER) @ poses[ROBOT_BODY] @ invert_pose(T_PLATE_ROBOT),
        BOARD_BODY: invert_pose(T_MAP_TRACKER) @ poses[BOARD_BODY],
    }))]  # fmt: skip
    statics = ((MAP_FRAME, {"tracker": T_MAP_TRACKER}), ("plate", {ROBOT_BODY: T_PLATE_ROBOT}))
    return rows + [("/tf_static", TF_TYPE, make_tf_message(t, a, b)) for a, b in statics]


T_MAP_TRACKER = pose_from_rpy([0.4, -0.3, 3.0], [np.pi, 0.1, 0.2])
T_PLATE_ROBOT = pose_from_rpy([0.02, 0.01, -0.3], [0.0, 0.05, 0.3])
MOCAP_VARIANTS = MOCAP_TYPES | {
    "TFMessage, a chain": (make_chain_rows, ["/tf"], (ROBOT_BODY, BOARD_BODY))
}


@cache
def make_mocap_rows(mocap_variant):
    """Rows of motion capture of a kind of MOCAP."""
    say, known = MOCAP_VARIANTS[mocap_variant][0], record_driver_scene()
    rows = []
    for i, t in enumerate(known.mocap_times_ns.tolist()):
        said = say(t, {body: T[i] for body, T in known.body_poses.items()})
        rows += [(t + LOG_DELAY_NS, *message) for message in said]
    return rows


# --- lidars

FOXGLOVE_FIELD_TYPES = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}


def _foxglove_cloud(t, echoes):
    points = make_point_array("velodyne", echoes)
    layout = points.dtype
    field = "foxglove_msgs/msg/PackedElementField"
    fields = [
        make_ros2_message(
            field, name=n, offset=layout.fields[n][1], type=FOXGLOVE_FIELD_TYPES[layout[n].str[1:]]
        )
        for n in layout.names
    ]
    kind, data = "foxglove_msgs/msg/PointCloud", points.reshape(-1).view("u1")
    return make_ros2_message(
        kind, timestamp=make_stamped_header(t).stamp, frame_id="lidar",
        pose=make_ros_pose(np.eye(4)), point_stride=layout.itemsize, fields=fields, data=data,
    )  # fmt: skip


def _driver_message(name):
    return lambda t, echoes: make_cloud_message(t, "lidar", name, echoes)


LIDAR_VARIANTS = {
    **{name: _driver_message(name) for name in (*CLOUD_FORMATS, "livox_custom", "laserscan")},
    "foxglove": _foxglove_cloud,
}


@cache
def make_lidar_rows(lidar_variant):
    """Rows of a lidar of DRIVERS; a laserscan has one beam, and the others those of BEAMS."""
    scans = (
        record_driver_scene().single_beam_scans
        if lidar_variant == "laserscan"
        else record_driver_scene().scans
    )
    return [
        _message_row(t + SCAN_PERIOD_NS, CLOUD_TOPIC, LIDAR_VARIANTS[lidar_variant](t, e))
        for t, e in scans
    ]


# --- cameras


def _encode_pixel_rows(encoding, pixels):
    pixels = IMAGE_ENCODERS[encoding](pixels)
    return np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)


def _raw_image_message(encoding, convert_pixels=lambda pixels: pixels):
    def message(t, pixels):
        lines = _encode_pixel_rows(encoding, convert_pixels(pixels))
        return make_ros2_message(
            IMAGE_TYPE, header=make_stamped_header(t, "camera"), height=len(pixels),
            width=pixels.shape[1], encoding=encoding, is_bigendian=0, step=lines.shape[1],
            data=lines.reshape(-1),
        )  # fmt: skip

    return message


def _nv12_message(t, pixels):
    planar = cv2.cvtColor(pixels, cv2.COLOR_BGR2YUV_I420)
    h, w = pixels.shape[:2]
    u, v = planar[h:].reshape(2, h // 4, 2, w // 2)
    data = np.concatenate([planar[:h].ravel(), np.stack([u.ravel(), v.ravel()], 1).ravel()])
    return make_ros2_message(
        IMAGE_TYPE, header=make_stamped_header(t, "camera"), height=h, width=w, encoding="nv12",
        is_bigendian=0, step=w, data=data,
    )  # fmt: skip


def _compressed_image_message(suffix, convert_pixels=lambda pixels: pixels):
    def message(t, pixels):
        data = cv2.imencode(suffix, convert_pixels(pixels))[1].reshape(-1)
        head = make_stamped_header(t, "camera")
        return make_ros2_message(
            COMPRESSED_IMAGE_TYPE, header=head, format=f"bgr8; {suffix[1:]} compressed", data=data
        )

    return message


def _foxglove_raw_message(t, pixels):
    lines = _encode_pixel_rows("rgb8", pixels)
    return make_ros2_message(
        "foxglove_msgs/msg/RawImage", timestamp=make_stamped_header(t).stamp, frame_id="camera",
        height=len(pixels), width=pixels.shape[1], encoding="rgb8", step=lines.shape[1],
        data=lines.reshape(-1),
    )  # fmt: skip


def _foxglove_compressed_message(t, pixels):
    data = cv2.imencode(".png", pixels)[1].reshape(-1)
    kind, stamp = "foxglove_msgs/msg/CompressedImage", make_stamped_header(t).stamp
    return make_ros2_message(kind, timestamp=stamp, frame_id="camera", data=data, format="png")


def _to_grey(pixels):
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)


IMAGE_VARIANTS = {
    **{name: _raw_image_message(name) for name in ("bgr8", "rgb8", "rgb16", "bgra8", "rgba8")},
    "png": _compressed_image_message(".png"),
    "foxglove raw": _foxglove_raw_message,
    "foxglove png": _foxglove_compressed_message,
    "mono8": _raw_image_message("mono8", _to_grey),
    "mono16": _raw_image_message("mono16", _to_grey),
    "grey png": _compressed_image_message(".png", _to_grey),
    "jpeg": _compressed_image_message(".jpg"),
    "bayer_rggb8": _raw_image_message("bayer_rggb8"),
    "yuv422": _raw_image_message("yuv422"),
    "nv12": _nv12_message,
}


@cache
def make_camera_rows(image_variant):
    """Rows of a camera of IMAGES."""
    return [
        _message_row(t + LOG_DELAY_NS, IMAGE_TOPIC, IMAGE_VARIANTS[image_variant](t, pixels))
        for t, pixels in record_driver_scene().images
    ]


def _message_row(log_t, topic, message):
    return log_t, topic, message.__msgtype__, message


def make_driver_recording(mocap_variant, lidar_variant, image_variant):
    """The whole recording, in order of log time."""
    return sorted(
        [
            *make_mocap_rows(mocap_variant),
            *make_lidar_rows(lidar_variant),
            *make_camera_rows(image_variant),
        ],
        key=lambda row: row[0],
    )
