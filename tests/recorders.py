"""One small scene without noise, as every motion capture, lidar driver and camera would record it.

A robot looks at a board that is held at five places. Motion capture is sampled at 40 Hz, the lidar
at 5 Hz; an image is taken at each place, and one on the way to the next.
"""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

import containers
import simulate
from calib.geometry import se3
from containers import BOARD, MAP, ROBOT, make
from simulation import record_session, ros_log, simulated_rigs
from simulation.sensors import (
    camera_exposure,
    cloud_formats,
    render_image,
    scan_patterns,
    scan_scene,
)

S, MS = 10**9, 10**6
LATE = 2 * MS  # by which the log takes every message
SIZE, FOCUS = (360, 280), 400.0
LENS = (FOCUS, FOCUS + 1, 181.3, 138.6, 0.0, 0.0, 0.0, 0.0)
POINTS, PIXELS = "/points", "/image"
BEAMS = scan_patterns.Spinning(tuple(range(-15, 16, 2)), 720)
RIG = simulated_rigs.Rig(
    sensors={
        "lidar": simulated_rigs.Lidar(POINTS, (0.15, 0.0, 0.60), (0.0, 0.0, 2.0), sector_deg=25.0),
        "camera": simulated_rigs.Camera(
            PIXELS, (0.25, -0.10, 0.45), (-90.0, 0.0, -90.0), "radtan", LENS, SIZE
        ),
    },
    sessions=("matrix",),
    kinds=({"board": simulated_rigs.Spot("lidar", (-5, 5), (1.6, 2.4), ("lidar", "camera"))},),
    alone={},
    defaults={"placements": 5, "hold_s": 1.2, "move_s": 0.5, "targets": ["board"], "seed": 4},
)


class Scene(NamedTuple):
    """times (n,), ns, and poses {body: (n, 4, 4)} of motion capture; scans: [(t, Echoes)] of
    BEAMS, flat: of one beam; images: [(t, (h, w, 3) uint8)]; guesses and sensors: T_robot_sensor
    (4, 4) by sensor, as written and as it is."""

    times: np.ndarray
    poses: dict
    scans: list
    flat: list
    images: list
    guesses: dict
    sensors: dict


def drawn():
    """(session, guesses) of RIG, as simulate.py draws them."""
    simulated_rigs.RIGS["matrix"] = RIG
    try:
        sessions, guesses = simulate.draw(simulate.parse(["unused", "--rig", "matrix"]))
    finally:
        del simulated_rigs.RIGS["matrix"]
    return sessions[0], guesses


@cache
def scene():
    """The Scene; it takes two seconds."""
    session, guesses = drawn()
    start, end = record_session.span(session.times)
    t = np.arange(start, end, 25 * MS)
    poses = {ROBOT: session.T_world("robot", t), BOARD: session.T_world("board", t)}
    moments = range(start + 100 * MS, end - 100 * MS, 200 * MS)
    shown = [int(a) + dt * MS for a, _ in session.times for dt in (400, 1350)][:-1]
    return Scene(
        t,
        poses,
        [(m, _echoes(session, m, BEAMS)) for m in moments],
        [(m, _echoes(session, m, scan_patterns.PATTERNS["flat"])) for m in moments],
        [(m, _image(session, m)) for m in shown],
        guesses,
        session.rig.sensors,
    )


def _echoes(session, t, pattern):
    firing = pattern.firing(np.deg2rad(RIG.sensors["lidar"].sector_deg), 0)
    when = t + firing.after
    T = session.T_world("robot", when) @ session.rig.sensors["lidar"]
    bias = np.zeros(pattern.beams)
    return scan_scene.scan(
        *(session.scene, session.surfaces(when), T, firing, t, np.random.default_rng(0)),
        noise=0.0, bias=bias, spread=0.0,
    )  # fmt: skip


def _image(session, t):
    view = render_image.view(session.rig.cameras["camera"])
    exact = record_session.image_at(session, "camera", view, t, render_image.COARSE)
    return camera_exposure.expose(exact, "bgr8", 0.0, None)


# --- motion capture


def chain(t, poses):
    """Bodies below static frames, in one TFMessage: the tracker hangs from the map's ceiling, and
    the robot sits on a plate with markers; statics come again, as ROS 1 sends them."""
    rows = [("/tf", ros_log.TF, ros_log.transforms(t, "tracker", {
        "plate": se3.inverse(HUNG) @ poses[ROBOT] @ se3.inverse(PLATE),
        BOARD: se3.inverse(HUNG) @ poses[BOARD],
    }))]  # fmt: skip
    statics = ((MAP, {"tracker": HUNG}), ("plate", {ROBOT: PLATE}))
    return rows + [("/tf_static", ros_log.TF, ros_log.transforms(t, a, b)) for a, b in statics]


HUNG = se3.from_rpy([0.4, -0.3, 3.0], [np.pi, 0.1, 0.2])
PLATE = se3.from_rpy([0.02, 0.01, -0.3], [0.0, 0.05, 0.3])
MOCAP = containers.TYPES | {"TFMessage, a chain": (chain, ["/tf"], (ROBOT, BOARD))}


@cache
def mocap(kind):
    """Rows of motion capture of a kind of MOCAP."""
    say, known = MOCAP[kind][0], scene()
    rows = []
    for i, t in enumerate(known.times.tolist()):
        said = say(t, {body: T[i] for body, T in known.poses.items()})
        rows += [(t + LATE, *message) for message in said]
    return rows


# --- lidars

FOXGLOVE = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}


def _foxglove_cloud(t, echoes):
    points = cloud_formats.points("velodyne", echoes)
    layout = points.dtype
    field = "foxglove_msgs/msg/PackedElementField"
    fields = [
        make(field, name=n, offset=layout.fields[n][1], type=FOXGLOVE[layout[n].str[1:]])
        for n in layout.names
    ]
    kind, data = "foxglove_msgs/msg/PointCloud", points.reshape(-1).view("u1")
    return make(
        kind, timestamp=containers.header(t).stamp, frame_id="lidar",
        pose=containers.pose(np.eye(4)), point_stride=layout.itemsize, fields=fields, data=data,
    )  # fmt: skip


def _driver(name):
    return lambda t, echoes: ros_log.cloud(t, "lidar", name, echoes)


DRIVERS = {
    **{name: _driver(name) for name in (*cloud_formats.DRIVERS, "livox_custom", "laserscan")},
    "foxglove": _foxglove_cloud,
}


@cache
def clouds(driver):
    """Rows of a lidar of DRIVERS; a laserscan has one beam, and the others those of BEAMS."""
    scans = scene().flat if driver == "laserscan" else scene().scans
    return [_row(t + scan_patterns.TURN_NS, POINTS, DRIVERS[driver](t, e)) for t, e in scans]


# --- cameras


def _image_of(encoding, pixels):
    pixels = camera_exposure.ENCODINGS[encoding](pixels)
    return np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)


def _raw(encoding, of=lambda pixels: pixels):
    def message(t, pixels):
        lines = _image_of(encoding, of(pixels))
        return make(
            ros_log.IMAGE, header=containers.header(t, "camera"), height=len(pixels),
            width=pixels.shape[1], encoding=encoding, is_bigendian=0, step=lines.shape[1],
            data=lines.reshape(-1),
        )  # fmt: skip

    return message


def _nv12(t, pixels):
    planar = cv2.cvtColor(pixels, cv2.COLOR_BGR2YUV_I420)
    h, w = pixels.shape[:2]
    u, v = planar[h:].reshape(2, h // 4, 2, w // 2)
    data = np.concatenate([planar[:h].ravel(), np.stack([u.ravel(), v.ravel()], 1).ravel()])
    return make(
        ros_log.IMAGE, header=containers.header(t, "camera"), height=h, width=w, encoding="nv12",
        is_bigendian=0, step=w, data=data,
    )  # fmt: skip


def _file(suffix, of=lambda pixels: pixels):
    def message(t, pixels):
        data = cv2.imencode(suffix, of(pixels))[1].reshape(-1)
        head = containers.header(t, "camera")
        return make(
            ros_log.COMPRESSED, header=head, format=f"bgr8; {suffix[1:]} compressed", data=data
        )

    return message


def _foxglove_raw(t, pixels):
    lines = _image_of("rgb8", pixels)
    return make(
        "foxglove_msgs/msg/RawImage", timestamp=containers.header(t).stamp, frame_id="camera",
        height=len(pixels), width=pixels.shape[1], encoding="rgb8", step=lines.shape[1],
        data=lines.reshape(-1),
    )  # fmt: skip


def _foxglove_file(t, pixels):
    data = cv2.imencode(".png", pixels)[1].reshape(-1)
    kind, stamp = "foxglove_msgs/msg/CompressedImage", containers.header(t).stamp
    return make(kind, timestamp=stamp, frame_id="camera", data=data, format="png")


def _grey(pixels):
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)


IMAGES = {
    **{name: _raw(name) for name in ("bgr8", "rgb8", "rgb16", "bgra8", "rgba8")},
    "png": _file(".png"),
    "foxglove raw": _foxglove_raw,
    "foxglove png": _foxglove_file,
    "mono8": _raw("mono8", _grey),
    "mono16": _raw("mono16", _grey),
    "grey png": _file(".png", _grey),
    "jpeg": _file(".jpg"),
    "bayer_rggb8": _raw("bayer_rggb8"),
    "yuv422": _raw("yuv422"),
    "nv12": _nv12,
}


@cache
def images(kind):
    """Rows of a camera of IMAGES."""
    return [_row(t + LATE, PIXELS, IMAGES[kind](t, pixels)) for t, pixels in scene().images]


def _row(log_t, topic, message):
    return log_t, topic, message.__msgtype__, message


def rows(mocap_kind, driver, image):
    """The whole recording, in order of log time."""
    return sorted([*mocap(mocap_kind), *clouds(driver), *images(image)], key=lambda row: row[0])
