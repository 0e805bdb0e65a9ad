"""Each recording's placements as an MCAP to look at: what lidars saw, in the colours of the images,
images with what lidars saw and where the calibration puts the target drawn into them."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.export.formats import ros_camera_info
from calib.export.formats.ros_camera_info import camera_info_json
from calib.export.mcap_writer import (
    encode_mcap,
    make_colored_cloud_message,
    make_ros_header,
    make_ros_message,
    make_static_tf_message,
)
from calib.geometry.se3 import invert_pose, pose_from_xyz_quat, transform_points
from calib.io.parquet_tables import read_table
from calib.report.data.run_data import COLUMNS_WITHOUT_PAYLOAD, VIEW_SCHEMAS
from calib.sensors.camera.images.image_messages import decode_png
from calib.targets.target_shapes import target_from_config
from calib.views.pose_selection import space_evenly
from calib.views.view_payloads import read_view_payloads

TITLE = (
    "the placements for Foxglove: clouds in the colours of the images, points and targets drawn "
    "into the images (3D panel: /<target>/points, /<target>/<lidar>/points; image panel: "
    "/<target>/<camera>/projected)"
)
CONVENTION = (
    "clouds lie in the frames of their sensors, targets in the parent's; each transform of "
    "/tf_static maps points of child_frame_id into header.frame_id; metres"
)
JPEG_OPTIONS = [cv2.IMWRITE_JPEG_QUALITY, 85]
UNCOLORED_BGR, TARGET_BGR = (
    (150, 150, 150),
    (90, 230, 60),
)  # BGR of what no image shows, and of targets
NEAREST_BGR, FARTHEST_BGR = (
    (60, 60, 255),
    (255, 130, 40),
)  # BGR of the nearest and the farthest return
N_OUTLINE_POINTS = 60  # points of a target along its reach


@dataclass(frozen=True)
class FoxgloveView:
    """What one sensor saw of a placement: stamp, ns; returns xyz (n, 3), m, of a lidar, or the
    whole image (h, w, 3), BGR, black but for what was kept of it, and where that is (h, w)."""

    stamp_ns: int
    xyz: np.ndarray = None
    image: np.ndarray = None
    pixel_mask: np.ndarray = None


def render_files(scene):
    """foxglove_<session>.mcap of every session."""
    about = {"convention": CONVENTION, "worked_point": "\n".join(scene.describe_worked_points())}
    out = {}
    for name, session in scene.sessions.items():
        found = select_export_views(scene, session)
        sent = [
            m for n, rows in found.items() for m in make_placement_messages(scene, session, n, rows)
        ]
        start = min([session.start_ns, *(m[0] for m in sent)])
        out[f"foxglove_{name}.mcap"] = encode_mcap(
            [make_static_tf_message(start, scene.static_transforms()), *sent], about
        )
    return out


def select_export_views(scene, session):
    """{placement: {sensor: row of its views}} of some, what most sensors saw first."""
    first = {}
    for name, path in session.view_paths.items():
        if name in scene.sensors:
            for number, view in _find_first_views(path, scene.sensors[name].kind).items():
                first.setdefault(number, {})[name] = view
    together = max((len(v) for v in first.values()), default=0)
    numbers = []
    for count in range(together, 0, -1):
        some = sorted(n for n, v in first.items() if len(v) == count)
        numbers += [some[i] for i in space_evenly(len(some), scene.max_views - len(numbers))]
    found = {n: {} for n in sorted(numbers)}
    for name in sorted(session.view_paths):
        wanted = {first[n][name]: n for n in found if name in first[n]}
        for view, row in read_view_payloads(session.view_paths[name], wanted).items():
            found[wanted[view]][name] = row
    return found


def _find_first_views(path, kind):
    """{placement: number of its first view that was kept}."""
    columns, _, _ = read_table(path, VIEW_SCHEMAS[kind], COLUMNS_WITHOUT_PAYLOAD)
    out = {}
    for i in np.flatnonzero(columns["kept"]):
        out.setdefault(int(columns["placement"][i]), int(columns["view"][i]))
    return out


def _make_foxglove_view(sensor, row):
    if sensor.kind == "lidar":
        xyz = np.asarray(row["xyz"], float).reshape(-1, 3)
        return FoxgloveView(row["stamp_ns"], xyz=xyz[np.isfinite(xyz).all(1) & (xyz != 0).any(1)])
    part = decode_png(row["png"])
    v1, u1 = row["v0"] + part.shape[0], row["u0"] + part.shape[1]
    width, height = sensor.camera.size_px if sensor.camera else (u1, v1)
    image, known = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), bool)
    at = np.s_[row["v0"] : v1, row["u0"] : u1]
    image[at], known[at] = part, True
    return FoxgloveView(row["stamp_ns"], image=image, pixel_mask=known)


def make_placement_messages(scene, session, placement, rows):
    """[(t, topic, type, message)] of one placement."""
    views = {n: _make_foxglove_view(scene.sensors[n], row) for n, row in rows.items()}
    seen = {n: v for n, v in views.items() if scene.sensors[n].kind == "camera"}
    scans = {n: v for n, v in views.items() if n not in seen}
    topic = f"/{find_placement_target(session, placement)}"
    target = sample_target_points(scene, session, placement)
    out = []
    for name, view in scans.items():
        colours = color_lidar_returns(scene, scene.sensors[name], view, seen)
        message = make_colored_cloud_message(
            view.stamp_ns, scene.sensors[name].frame, view.xyz, colours
        )
        out.append(
            (view.stamp_ns, f"{topic}/{name}/points", "sensor_msgs/msg/PointCloud2", message)
        )
    for name, view in seen.items():
        out += _make_camera_messages(
            scene, f"{topic}/{name}", scene.sensors[name], view, scans, target
        )
    t = min(v.stamp_ns for v in views.values())
    message = make_colored_cloud_message(
        t, scene.parent_frame, target, np.tile(TARGET_BGR, (len(target), 1))
    )
    return [*out, (t, f"{topic}/points", "sensor_msgs/msg/PointCloud2", message)]


def find_placement_target(session, placement):
    """Name of the target of a placement."""
    p = session.placements
    return str(p["target"][np.asarray(p["placement"]) == placement][0])


def sample_target_points(scene, session, placement):
    """Points (n, 3) of a placement's target, parent frame, where the motion capture has it."""
    p = session.placements
    row = np.flatnonzero(np.asarray(p["placement"]) == placement)[0]
    name = find_placement_target(session, placement)
    if name not in scene.T_body_target:
        return np.zeros((0, 3))
    T_markers_body = pose_from_xyz_quat(p["xyz"][row], p["quat"][row])
    T = scene.T_parent_robot @ session.T_robot_body @ T_markers_body @ scene.T_body_target[name]
    target = target_from_config(scene.targets[name])
    ends, along = target.outline_edges(), np.linspace(0, 1, N_OUTLINE_POINTS)[:, None]
    outline = [a + along * (b - a) for a, b in ends]
    points = (
        np.concatenate(outline)
        if len(ends)
        else target.sample_surface(2 * target.bounding_radius / N_OUTLINE_POINTS)
    )
    corners = target.pattern.corners() if target.pattern else np.zeros((0, 3))
    return transform_points(T, np.concatenate([points, corners]))


def project_to_pixels(sensor, points):
    """(pixels (m, 2) as whole numbers, rows (m,)) of points (n, 3), parent frame, in an image."""
    uv, valid = sensor.camera.project(transform_points(invert_pose(sensor.T_parent_sensor), points))
    rows = np.flatnonzero(valid & sensor.camera.is_in_image(uv))
    last = np.subtract(sensor.camera.size_px, 1)
    return np.clip(np.rint(uv[rows]).astype(int), 0, last), rows


def color_lidar_returns(scene, lidar, view, camera_views):
    """BGR (n, 3) of a scan's returns: of the images {camera: View} that show them, else grey."""
    colours = np.tile(np.uint8(UNCOLORED_BGR), (len(view.xyz), 1))
    points = transform_points(lidar.T_parent_sensor, view.xyz)
    for name, other in camera_views.items():
        if scene.sensors[name].camera is not None:
            uv, rows = project_to_pixels(scene.sensors[name], points)
            shown = other.pixel_mask[uv[:, 1], uv[:, 0]]
            colours[rows[shown]] = other.image[uv[shown, 1], uv[shown, 0]]
    return colours


def _make_camera_messages(scene, topic, sensor, view, lidar_views, target):
    """Messages of one image: as it is, with points drawn into it, and its CameraInfo."""
    out = [_make_image_message(view.stamp_ns, f"{topic}/image", sensor.frame, view.image)]
    if sensor.camera is None:
        return out
    drawn = view.image.copy()
    _draw_points(drawn, project_to_pixels(sensor, target)[0], np.tile(TARGET_BGR, (len(target), 1)))
    for name, scan in lidar_views.items():
        points = transform_points(scene.sensors[name].T_parent_sensor, scan.xyz)
        uv, rows = project_to_pixels(sensor, points)
        _draw_points(drawn, uv, color_by_range(np.linalg.norm(scan.xyz[rows], axis=1)))
    out.append(_make_image_message(view.stamp_ns, f"{topic}/projected", sensor.frame, drawn))
    if sensor.camera.model in ros_camera_info.ROS_DISTORTION_MODELS:
        info = _make_camera_info_message(view.stamp_ns, sensor)
        out.append((view.stamp_ns, f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", info))
    return out


def color_by_range(ranges):
    """BGR (n, 3) of returns at ranges (n,), m, from the nearest to the farthest."""
    span = np.ptp(ranges) if len(ranges) else 0.0
    share = (ranges - ranges.min()) / span if span > 0 else np.zeros(len(ranges))
    return np.rint(
        np.array(NEAREST_BGR) + share[:, None] * np.subtract(FARTHEST_BGR, NEAREST_BGR)
    ).astype(int)


def _draw_points(image, uv, colours):
    for (u, v), colour in zip(uv.tolist(), np.asarray(colours).tolist(), strict=False):
        cv2.circle(image, (u, v), 1, colour, -1)


def _make_image_message(t, topic, frame, image):
    data = cv2.imencode(".jpg", image, JPEG_OPTIONS)[1].reshape(-1)
    name = "sensor_msgs/msg/CompressedImage"
    return (
        t,
        topic,
        name,
        make_ros_message(name, header=make_ros_header(t, frame), format="jpeg", data=data),
    )


def _make_camera_info_message(t, sensor):
    info = camera_info_json(sensor)
    sizes = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    return make_ros_message(
        "sensor_msgs/msg/CameraInfo",
        header=make_ros_header(t, sensor.frame),
        height=info["image_height"],
        width=info["image_width"],
        distortion_model=info["distortion_model"],
        d=np.array(info["distortion_coefficients"]["data"]),
        k=np.array(info["camera_matrix"]["data"]),
        r=np.array(info["rectification_matrix"]["data"]),
        p=np.array(info["projection_matrix"]["data"]),
        binning_x=0,
        binning_y=0,
        roi=make_ros_message("sensor_msgs/msg/RegionOfInterest", **sizes, do_rectify=False),
    )
