"""Each recording's placements as an MCAP to look at: what lidars saw, in the colours of the images,
images with what lidars saw and where the calibration puts the target drawn into them."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.export import mcap_writer
from calib.export.formats import ros_camera_info
from calib.geometry import se3
from calib.io import parquet_tables
from calib.report.data.run_data import LIGHT, VIEWS
from calib.sensors.camera.images import image_messages
from calib.targets import target_shapes
from calib.views.frame_selection import evenly
from calib.views.view_payloads import payloads

TITLE = (
    "the placements for Foxglove: clouds in the colours of the images, points and targets drawn "
    "into the images (3D panel: /<target>/points, /<target>/<lidar>/points; image panel: "
    "/<target>/<camera>/projected)"
)
CONVENTION = (
    "clouds lie in the frames of their sensors, targets in the parent's; each transform of "
    "/tf_static maps points of child_frame_id into header.frame_id; metres"
)
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]
GREY, GREEN = (150, 150, 150), (90, 230, 60)  # BGR of what no image shows, and of targets
NEAR, FAR = (60, 60, 255), (255, 130, 40)  # BGR of the nearest and the farthest return
SPACING = 60  # points of a target along its reach


@dataclass(frozen=True)
class View:
    """What one sensor saw of a placement: stamp, ns; returns xyz (n, 3), m, of a lidar, or the
    whole image (h, w, 3), BGR, black but for what was kept of it, and where that is (h, w)."""

    t: int
    xyz: np.ndarray = None
    image: np.ndarray = None
    known: np.ndarray = None


def render(scene):
    """foxglove_<session>.mcap of every session."""
    about = {"convention": CONVENTION, "worked_point": "\n".join(scene.worked())}
    out = {}
    for name, session in scene.sessions.items():
        found = placements(scene, session)
        sent = [m for n, rows in found.items() for m in messages(scene, session, n, rows)]
        start = min([session.start, *(m[0] for m in sent)])
        out[f"foxglove_{name}.mcap"] = mcap_writer.to_bytes(
            [mcap_writer.transforms(start, scene.edges()), *sent], about
        )
    return out


def placements(scene, session):
    """{placement: {sensor: row of its views}} of some, what most sensors saw first."""
    first = {}
    for name, path in session.views.items():
        if name in scene.sensors:
            for number, view in _first_views(path, scene.sensors[name].kind).items():
                first.setdefault(number, {})[name] = view
    together = max((len(v) for v in first.values()), default=0)
    numbers = []
    for count in range(together, 0, -1):
        some = sorted(n for n, v in first.items() if len(v) == count)
        numbers += [some[i] for i in evenly(len(some), scene.most_views - len(numbers))]
    found = {n: {} for n in sorted(numbers)}
    for name in sorted(session.views):
        wanted = {first[n][name]: n for n in found if name in first[n]}
        for view, row in payloads(session.views[name], wanted).items():
            found[wanted[view]][name] = row
    return found


def _first_views(path, kind):
    """{placement: number of its first view that was kept}."""
    columns, _, _ = parquet_tables.read(path, VIEWS[kind], LIGHT)
    out = {}
    for i in np.flatnonzero(columns["kept"]):
        out.setdefault(int(columns["placement"][i]), int(columns["view"][i]))
    return out


def _view(sensor, row):
    if sensor.kind == "lidar":
        xyz = np.asarray(row["xyz"], float).reshape(-1, 3)
        return View(row["t"], xyz=xyz[np.isfinite(xyz).all(1) & (xyz != 0).any(1)])
    part = image_messages.from_png(row["png"])
    v1, u1 = row["v0"] + part.shape[0], row["u0"] + part.shape[1]
    width, height = sensor.camera.size if sensor.camera else (u1, v1)
    image, known = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), bool)
    at = np.s_[row["v0"] : v1, row["u0"] : u1]
    image[at], known[at] = part, True
    return View(row["t"], image=image, known=known)


def messages(scene, session, number, rows):
    """[(t, topic, type, message)] of one placement."""
    views = {n: _view(scene.sensors[n], row) for n, row in rows.items()}
    seen = {n: v for n, v in views.items() if scene.sensors[n].kind == "camera"}
    scans = {n: v for n, v in views.items() if n not in seen}
    topic = f"/{target_of(session, number)}"
    target = target_points(scene, session, number)
    out = []
    for name, view in scans.items():
        colours = coloured(scene, scene.sensors[name], view, seen)
        message = mcap_writer.cloud(view.t, scene.sensors[name].frame, view.xyz, colours)
        out.append((view.t, f"{topic}/{name}/points", "sensor_msgs/msg/PointCloud2", message))
    for name, view in seen.items():
        out += _of_camera(scene, f"{topic}/{name}", scene.sensors[name], view, scans, target)
    t = min(v.t for v in views.values())
    message = mcap_writer.cloud(t, scene.parent, target, np.tile(GREEN, (len(target), 1)))
    return [*out, (t, f"{topic}/points", "sensor_msgs/msg/PointCloud2", message)]


def target_of(session, number):
    """Name of the target of a placement."""
    p = session.placements
    return str(p["target"][np.asarray(p["placement"]) == number][0])


def target_points(scene, session, number):
    """Points (n, 3) of a placement's target, parent frame, where the motion capture has it."""
    p = session.placements
    row = np.flatnonzero(np.asarray(p["placement"]) == number)[0]
    name = target_of(session, number)
    if name not in scene.T_body_target:
        return np.zeros((0, 3))
    T_markers_body = se3.from_xyz_quat(p["xyz"][row], p["quat"][row])
    T = scene.T_parent_robot @ session.T_robot_body @ T_markers_body @ scene.T_body_target[name]
    target = target_shapes.from_config(scene.targets[name])
    ends, along = target.edges(), np.linspace(0, 1, SPACING)[:, None]
    outline = [a + along * (b - a) for a, b in ends]
    points = np.concatenate(outline) if len(ends) else target.template(2 * target.reach / SPACING)
    corners = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    return se3.transform(T, np.concatenate([points, corners]))


def pixels(sensor, points):
    """(pixels (m, 2) as whole numbers, rows (m,)) of points (n, 3), parent frame, in an image."""
    uv, valid = sensor.camera.project(se3.transform(se3.inverse(sensor.T), points))
    rows = np.flatnonzero(valid & sensor.camera.in_image(uv))
    last = np.subtract(sensor.camera.size, 1)
    return np.clip(np.rint(uv[rows]).astype(int), 0, last), rows


def coloured(scene, lidar, view, seen):
    """BGR (n, 3) of a scan's returns: of the images {camera: View} that show them, else grey."""
    colours = np.tile(np.uint8(GREY), (len(view.xyz), 1))
    points = se3.transform(lidar.T, view.xyz)
    for name, other in seen.items():
        if scene.sensors[name].camera is not None:
            uv, rows = pixels(scene.sensors[name], points)
            shown = other.known[uv[:, 1], uv[:, 0]]
            colours[rows[shown]] = other.image[uv[shown, 1], uv[shown, 0]]
    return colours


def _of_camera(scene, topic, sensor, view, scans, target):
    """Messages of one image: as it is, with points drawn into it, and its CameraInfo."""
    out = [_image(view.t, f"{topic}/image", sensor.frame, view.image)]
    if sensor.camera is None:
        return out
    drawn = view.image.copy()
    _draw(drawn, pixels(sensor, target)[0], np.tile(GREEN, (len(target), 1)))
    for name, scan in scans.items():
        points = se3.transform(scene.sensors[name].T, scan.xyz)
        uv, rows = pixels(sensor, points)
        _draw(drawn, uv, by_range(np.linalg.norm(scan.xyz[rows], axis=1)))
    out.append(_image(view.t, f"{topic}/projected", sensor.frame, drawn))
    if sensor.camera.model in ros_camera_info.MODELS:
        info = _camera_info(view.t, sensor)
        out.append((view.t, f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", info))
    return out


def by_range(ranges):
    """BGR (n, 3) of returns at ranges (n,), m, from the nearest to the farthest."""
    span = np.ptp(ranges) if len(ranges) else 0.0
    share = (ranges - ranges.min()) / span if span > 0 else np.zeros(len(ranges))
    return np.rint(np.array(NEAR) + share[:, None] * np.subtract(FAR, NEAR)).astype(int)


def _draw(image, uv, colours):
    for (u, v), colour in zip(uv.tolist(), np.asarray(colours).tolist(), strict=False):
        cv2.circle(image, (u, v), 1, colour, -1)


def _image(t, topic, frame, image):
    data = cv2.imencode(".jpg", image, JPEG)[1].reshape(-1)
    name = "sensor_msgs/msg/CompressedImage"
    return (
        t,
        topic,
        name,
        mcap_writer.make(name, header=mcap_writer.header(t, frame), format="jpeg", data=data),
    )


def _camera_info(t, sensor):
    info = ros_camera_info.content(sensor)
    sizes = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    return mcap_writer.make(
        "sensor_msgs/msg/CameraInfo",
        header=mcap_writer.header(t, sensor.frame),
        height=info["image_height"],
        width=info["image_width"],
        distortion_model=info["distortion_model"],
        d=np.array(info["distortion_coefficients"]["data"]),
        k=np.array(info["camera_matrix"]["data"]),
        r=np.array(info["rectification_matrix"]["data"]),
        p=np.array(info["projection_matrix"]["data"]),
        binning_x=0,
        binning_y=0,
        roi=mcap_writer.make("sensor_msgs/msg/RegionOfInterest", **sizes, do_rectify=False),
    )
