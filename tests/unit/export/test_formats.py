"""Every format of export/ through a reader that is not ours: the same SE(3), and the direction."""

import ast
import io
import json
import shlex
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import xacro
import yaml
import yourdfpy
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.export.calibrated_scene import ExportSession
from calib.export.export_readme import README_FILE_NAME, render_export_readme
from calib.export.formats import tf_static
from calib.export.formats.format_registry import FORMATS, is_export_file
from calib.export.placement_views import (
    UNCOLORED_BGR,
    CameraView,
    LidarView,
    color_lidar_returns,
    make_camera_view,
)
from calib.export.scene_from_calibration import build_export_scene
from calib.geometry.se3 import invert_pose, make_pose, pose_from_rpy, se3_log, transform_points
from calib.io.parquet_tables import read_table
from calib.io.pose_block import pose_from_config, pose_json
from calib.io.safe_names import safe_name
from calib.io.stage_cli import read_json
from calib.io.status import Status
from calib.io.table_schemas import FRAMES_SCHEMA
from calib.io.urdf.urdf_file import origin_attributes
from calib.sensors.camera.images.image_messages import encode_png
from calib.sensors.sensor_models import camera_from_config
from helpers.small_run import (
    SMALL_ARGUMENTS,
    list_job_commands,
    run_to_completion,
    simulate_into,
    simulated_rig_path,
)
from simulation import simulated_rigs

POINT = np.array([0.3, -1.2, 2.5])
BODY = "mocap/robot"
POSES = {
    "front": pose_from_rpy([0.3, 0.02, 0.61], [0.01, -0.03, 0.4]),
    # Where yaw and roll turn about one axis.
    "down": pose_from_rpy([0.1, 0.5, 0.4], [0.3, np.pi / 2 - 1e-8, -0.7]),
    "left": pose_from_rpy([0.05, 0.2, 0.59], [-1.6, 0.01, 0.02]),
    "right": pose_from_rpy([-0.06, -0.21, 0.6], [-1.5, 0.05, 3.1]),
    "fish": pose_from_rpy([0.2, 0.0, 0.5], [np.pi / 2, -3.0, 1.0]),
}
FRAMES = {
    "front": "velodyne",
    "down": "/os_sensor",
    "left": "left_camera_optical_frame",
    "right": "right",
    "fish": "fish_optical",
}
MODELS = {
    "left": ("radtan", (802.3, 801.1, 452.6, 347.9, -0.21, 0.07, 4e-4, -3e-4, 0.0)),
    "right": ("kannala_brandt", simulated_rigs.LENS_PARAMS["kannala_brandt"]),
    "fish": ("double_sphere", simulated_rigs.LENS_PARAMS["double_sphere"]),
}
SIZE = (900, 700)
PARENT = {
    "frame": "base_link",
    "T_parent_robot": {"xyz_m": [0.4, -0.1, 1.2], "rpy_deg": [3, -5, 80]},
}


def sensor_of(name):
    kind = "camera" if name in MODELS else "lidar"
    config = {"kind": kind, "topic": f"/{name}/data"}
    if name in MODELS:
        model, params = MODELS[name]
        config |= {"model": model, "params": list(params), "size_px": list(SIZE)}
    return config


def described(parent=PARENT, frames=FRAMES, sessions=None, **export):
    """The calibration.json of POSES, as far as exports read it, and its Scene."""
    sensors = {
        n: {
            "kind": sensor_of(n)["kind"],
            "frame": frames[n],
            "status": Status().to_dict(),
            "T_robot_sensor": pose_json(T),
            "intrinsics": None,
        }
        for n, T in POSES.items()
    }
    gone = Status(False, "rear has no view of a target").to_dict()
    rear = {"kind": "lidar", "frame": "rear", "status": gone, "T_robot_sensor": None}
    calibration = {
        "rig": "robo",
        "verdict": "pass",
        "reasons": [],
        "sensors": sensors | {"rear": rear},
        "targets": {},
        "sessions": {},
    }
    options = {
        "export": {"parent": parent, "body_frames": {}, "max_views": 12} | export,
        "body": BODY,
        "sensors": {n: sensor_of(n) for n in POSES} | {"rear": {"kind": "lidar", "topic": "/rear"}},
    }
    return calibration, build_export_scene(calibration, options, sessions)


def T_parent_sensor(calibration, name, parent=PARENT):
    """What a file must say, by calibration.json and the config alone."""
    T = np.array(calibration["sensors"][name]["T_robot_sensor"]["matrix"])
    return pose_from_config(parent["T_parent_robot"]) @ T


def same(found, expected):
    """The same SE(3) to 1e-9 m and rad; and a point goes where it should, not back."""
    found, expected = np.asarray(found, float), np.asarray(expected)
    assert np.abs(se3_log(invert_pose(expected) @ found)).max() < 1e-9
    there = found[:3, :3] @ POINT + found[:3, 3]
    assert there == pytest.approx(transform_points(expected, POINT), abs=1e-9)
    assert np.linalg.norm(there - transform_points(invert_pose(expected), POINT)) > 0.1


def matrix(xyz, quat=None, rpy=None):
    """(4, 4) by SciPy alone."""
    T = np.eye(4)
    turn = Rotation.from_quat(quat) if quat is not None else Rotation.from_euler("xyz", rpy)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), xyz
    return T


def chained(edges, parent, child):
    """T_parent_child of {child: (parent, T_parent_child)}, up from the child."""
    T = np.eye(4)
    while child != parent:
        child, above = edges[child]
        T = above @ T
    return T


def frame_of(name):
    return FRAMES[name].lstrip("/")


def check_tree(calibration, edges, parent="base_link"):
    """Every sensor's frame below the parent; bodies of cameras by REP 103."""
    for name in POSES:
        same(chained(edges, parent, frame_of(name)), T_parent_sensor(calibration, name))
    # One metre before a camera is one metre along its body's x axis; its right is the body's -y.
    optical, (body, T) = "left_camera_optical_frame", edges["left_camera_optical_frame"]
    assert body == "left_camera_link" and edges["fish_optical"][0] == "fish_link", optical
    assert T[:3, :3] @ [0, 0, 1] == pytest.approx([1, 0, 0], abs=1e-12)
    assert T[:3, :3] @ [1, 0, 0] == pytest.approx([0, -1, 0], abs=1e-12)
    assert edges["right"][0] == parent


# --- one reader for every format


def read_static_transforms(calibration, files):
    items = yaml.safe_load(files["static_transforms.yaml"])["transforms"]
    edges = {}
    for item in items:
        move, turn = item["transform"]["translation"], item["transform"]["rotation"]
        T = matrix([move[k] for k in "xyz"], [turn[k] for k in "xyzw"])
        edges[item["child_frame_id"]] = item["header"]["frame_id"], T
    check_tree(calibration, edges)


def read_launch(calibration, files):
    edges = {}
    for node in ElementTree.fromstring(files["static_transforms.launch.xml"]).iter("node"):
        assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
        words = shlex.split(node.get("args"))
        said = dict(zip(words[::2], words[1::2], strict=True))
        xyz = [float(said[f"--{k}"]) for k in "xyz"]
        T = matrix(xyz, [float(said[f"--q{k}"]) for k in "xyzw"])
        edges[said["--child-frame-id"]] = said["--frame-id"], T
    check_tree(calibration, edges)


def edges_of_urdf(text):
    robot = yourdfpy.URDF.load(io.StringIO(text), load_meshes=False, build_scene_graph=True)
    return {
        joint.child: (joint.parent, robot.get_transform(joint.child, joint.parent))
        for joint in robot.joint_map.values()
    }


def read_urdf(calibration, files):
    edges = edges_of_urdf(files["sensors.urdf"])
    check_tree(calibration, edges)


def read_xacro(calibration, files, tmp_path):
    (tmp_path / "sensors.urdf.xacro").write_text(files["sensors.urdf.xacro"])
    for given, parent in (("", "base_link"), (' parent="chassis"', "chassis")):
        (tmp_path / "robot.xacro").write_text(
            '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">'
            f'<xacro:include filename="{tmp_path}/sensors.urdf.xacro"/><link name="{parent}"/>'
            f"<xacro:calibrated_sensors{given}/></robot>"
        )
        text = xacro.process_file(str(tmp_path / "robot.xacro")).toxml()
        check_tree(calibration, edges_of_urdf(text), parent)


def read_opencv(calibration, files):
    flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
    file = cv2.FileStorage(files["opencv.yaml"], flags)
    assert file.getNode("parent").string() == "base_link"
    found = file.getNode("sensors")
    nodes = {found.at(i).getNode("name").string(): found.at(i) for i in range(found.size())}
    assert set(nodes) == set(POSES)
    for name, node in nodes.items():
        T = node.getNode("T_parent_sensor").mat()
        same(T, T_parent_sensor(calibration, name))
        assert node.getNode("frame").string() == frame_of(name)
        if name in ("left", "right"):
            functions = {"cv": cv2, "cv::fisheye": cv2.fisheye}[node.getNode("functions").string()]
            K, d = (node.getNode(k).mat() for k in ("camera_matrix", "distortion_coefficients"))
            project(name, lambda p, f=functions, K=K, d=d: f.projectPoints(
                p[None], np.zeros(3), np.zeros(3), K, d)[0])  # fmt: skip
            assert node.getNode("image_width").real() == SIZE[0]
    assert nodes["fish"].getNode("camera_matrix").empty()
    assert "double_sphere" in files["opencv.yaml: intrinsics of fish"].reason


def project(name, function):
    """That a reader's projection puts points of a camera's frame into the pixels of ours."""
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.2], [0.0, 0.0, 1.0], [0.4, -0.3, 0.9]])
    uv, _ = camera_from_config(sensor_of(name)).project(points)
    assert np.reshape(function(points), (-1, 2)) == pytest.approx(uv, abs=1e-6)


def by_opencv(name, model, K, d):
    K = np.array(K, float).reshape(3, 3)
    functions = {"radtan": cv2, "kannala_brandt": cv2.fisheye}[model]
    zero = np.zeros(3)
    project(name, lambda p: functions.projectPoints(p[None], zero, zero, K, np.array(d))[0])


def read_camera_info(calibration, files):
    for name, model in (("left", "plumb_bob"), ("right", "equidistant")):
        info = yaml.safe_load(files[f"camera_info_{name}.yaml"])
        assert info["distortion_model"] == model and info["camera_name"] == name
        d = info["distortion_coefficients"]
        assert len(d["data"]) == d["cols"] == {"plumb_bob": 5, "equidistant": 4}[model]
        by_opencv(name, MODELS[name][0], info["camera_matrix"]["data"], d["data"])
        P = np.reshape(info["projection_matrix"]["data"], (3, 4))
        assert P[:, :3].ravel().tolist() == info["camera_matrix"]["data"]
        assert (info["image_width"], info["image_height"]) == SIZE
    assert "double_sphere" in files["camera_info_fish.yaml"].reason


def read_kalibr(calibration, files):
    chain = yaml.safe_load(files["camchain.yaml"])
    names = ["fish", "left", "right"]
    assert [chain[f"cam{i}"]["rostopic"] for i in range(3)] == [f"/{n}/data" for n in names]
    for i in (1, 2):
        before, after = (T_parent_sensor(calibration, n) for n in names[i - 1 : i + 1])
        same(chain[f"cam{i}"]["T_cn_cnm1"], np.linalg.inv(after) @ before)
    # The numbers of its ds come first: xi, alpha.
    assert chain["cam0"]["camera_model"] == "ds"
    assert chain["cam0"]["intrinsics"] == [*MODELS["fish"][1][4:], *MODELS["fish"][1][:4]]
    for i, model in ((1, "radtan"), (2, "equidistant")):
        cam = chain[f"cam{i}"]
        assert (cam["camera_model"], cam["distortion_model"]) == ("pinhole", model)
        fu, fv, pu, pv = cam["intrinsics"]
        K = [fu, 0, pu, 0, fv, pv, 0, 0, 1]
        by_opencv(names[i], MODELS[names[i]][0], K, cam["distortion_coeffs"])
        assert cam["resolution"] == list(SIZE)


def read_mrcal(calibration, files):
    model = ast.literal_eval(files["left.cameramodel"])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(model["extrinsics"][:3]).as_matrix()
    T[:3, 3] = model["extrinsics"][3:]
    same(T, np.linalg.inv(T_parent_sensor(calibration, "left")))
    assert model["lensmodel"] == "LENSMODEL_OPENCV5" and model["imagersize"] == list(SIZE)
    fx, fy, cx, cy, *d = model["intrinsics"]
    by_opencv("left", "radtan", [fx, 0, cx, 0, fy, cy, 0, 0, 1], d)
    assert "kannala_brandt" in files["right.cameramodel"].reason
    assert "double_sphere" in files["fish.cameramodel"].reason


def test_mrcal_itself_reads_its_cameras(tmp_path):
    mrcal = pytest.importorskip("mrcal", reason="mrcal is not installed here")
    calibration, shown = described()
    files = FORMATS["mrcal"].render_files(shown)
    (tmp_path / "left.cameramodel").write_text(files["left.cameramodel"])
    model = mrcal.cameramodel(str(tmp_path / "left.cameramodel"))
    same(make_pose(*np.split(model.Rt_ref_cam(), [3])), T_parent_sensor(calibration, "left"))
    project("left", lambda p: mrcal.project(p, *model.intrinsics()))


def read_koide3(calibration, files):
    for lidar in ("front", "down"):
        assert "double_sphere" in files[f"koide3/{lidar}/fish/calib.json"].reason
        for camera, model in (("left", "plumb_bob"), ("right", "fisheye")):
            content = json.loads(files[f"koide3/{lidar}/{camera}/calib.json"])
            x, y, z, *quat = content["results"]["T_lidar_camera"]
            T_l, T_c = (T_parent_sensor(calibration, n) for n in (lidar, camera))
            same(matrix([x, y, z], quat), np.linalg.inv(T_l) @ T_c)
            cam = content["camera"]
            assert cam["camera_model"] == model
            fx, fy, cx, cy = cam["intrinsics"]
            K = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
            by_opencv(camera, MODELS[camera][0], K, cam["distortion_coeffs"])


def read_autoware(calibration, files):
    content = yaml.safe_load(files["sensor_kit_calibration.yaml"])["base_link"]
    names = {"velodyne": "front", "os_sensor": "down", "left_camera_link": "left"}
    names |= {"right/camera_link": "right", "fish_link": "fish"}
    assert set(content) == set(names)
    # x forward, y left, z up of a body; z forward, x right, y down of its image.
    T_body_optical = matrix([0, 0, 0], rpy=[-np.pi / 2, 0, -np.pi / 2])
    for frame, name in names.items():
        p = content[frame]
        T = matrix([p[k] for k in "xyz"], rpy=[p[k] for k in ("roll", "pitch", "yaw")])
        same(T @ T_body_optical if name in MODELS else T, T_parent_sensor(calibration, name))


def edges_of_bag(path, topic="/tf_static"):
    edges = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic == topic:
                for item in reader.deserialize(data, connection.msgtype).transforms:
                    t, q = item.transform.translation, item.transform.rotation
                    T = matrix([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
                    edges[item.child_frame_id] = item.header.frame_id, T
    return edges


READERS = {
    "ros2_static_transforms": read_static_transforms,
    "ros2_launch": read_launch,
    "urdf": read_urdf,
    "xacro": read_xacro,
    "opencv": read_opencv,
    "ros_camera_info": read_camera_info,
    "kalibr": read_kalibr,
    "mrcal": read_mrcal,
    "koide3": read_koide3,
    "autoware": read_autoware,
}


@pytest.mark.parametrize("name", sorted(READERS))
def test_a_format_says_the_same_poses_to_another_reader(name, tmp_path):
    calibration, shown = described()
    files = FORMATS[name].render_files(shown)
    more = (tmp_path,) if name == "xacro" else ()
    READERS[name](calibration, files, *more)


def test_every_format_has_a_reader_here():
    assert set(READERS) | {"tf_static", "foxglove"} == set(FORMATS)


@pytest.mark.parametrize("name", sorted(READERS))
def test_every_text_names_its_convention_and_a_worked_point_that_is_so(name):
    _, shown = described()
    module = FORMATS[name]
    for file, content in module.render_files(shown).items():
        if isinstance(content, Status):
            assert not content.ok and content.reason
            continue
        assert " ".join(module.CONVENTION.split()) in " ".join(content.split()), file
        assert "the point (1, 0, 0) of " in content, file


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_a_format_writes_only_files_that_a_later_run_may_remove(name):
    session = ExportSession("anew", 5_000_000_000, np.eye(4), {}, {})
    _, shown = described(sessions={"anew": session})
    for file, content in FORMATS[name].render_files(shown).items():
        assert isinstance(content, Status) or is_export_file(file)


def test_files_of_others_are_no_export_files():
    for name in ("notes.txt", "README.md", "sub/opencv.yaml", "koide3/a/calib.json", "../a.mcap"):
        assert not is_export_file(name)


def test_a_worked_point_is_that_of_the_pose():
    calibration, shown = described()
    x, y, z = transform_points(T_parent_sensor(calibration, "down"), [1, 0, 0])
    line = f"down: the point (1, 0, 0) of os_sensor is ({x:.6f}, {y:.6f}, {z:.6f}) in base_link"
    assert line in shown.describe_worked_points()
    assert "rear is left out: rear has no view of a target" in shown.describe_worked_points()


# --- recordings


@pytest.fixture
def exported(finished_run):
    return finished_run / "results/sim/export"


def test_tf_static_opens_beside_the_recording_latched_and_stamped_at_its_start(
    finished_run, exported
):
    path = exported / "tf_static_sim.mcap"
    with path.open("rb") as stream:
        reader = make_reader(stream)
        (found,) = list(reader.iter_messages())
        (about,) = list(reader.iter_metadata())
    schema, channel, message = found
    assert (channel.topic, schema.name) == ("/tf_static", "tf2_msgs/msg/TFMessage")
    (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    transient_local, reliable = 1, 1
    assert (qos["durability"], qos["reliability"]) == (transient_local, reliable)
    frames, _, _ = read_table(finished_run / "results/sim/sim/frames.parquet", FRAMES_SCHEMA)
    assert message.log_time == frames["log_time_ns"].min()
    assert "maps points of child_frame_id into header.frame_id" in about.metadata["convention"]
    assert "the point (1, 0, 0) of velodyne is" in about.metadata["worked_point"]
    # The schema in the file is enough to read it.
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    said = store.deserialize_cdr(message.data, schema.name).transforms
    assert {t.header.frame_id for t in said} == {"mocap/robot"}
    edges = edges_of_bag(path)
    result = read_json(finished_run / "results/sim/calibration.json")["sensors"]
    for name in ("camera", "velodyne"):
        expected = np.array(result[name]["T_robot_sensor"]["matrix"])
        same(chained(edges, "mocap/robot", name), expected)


@pytest.mark.parametrize("parent", ["", PARENT])
def test_tf_static_hangs_on_the_markers_as_they_were_in_its_session(parent, tmp_path):
    T_robot_body = pose_from_rpy([0.02, -0.03, 0.01], [0.1, 0.05, -0.2])
    anew = ExportSession("anew", 5_000_000_000, T_robot_body, {}, {})
    calibration, shown = described(parent=parent, sessions={"anew": anew})
    (tmp_path / "a.mcap").write_bytes(tf_static.render_files(shown)["tf_static_anew.mcap"])
    edges = edges_of_bag(tmp_path / "a.mcap")
    for name, T_robot_sensor in POSES.items():
        expected = np.linalg.inv(T_robot_body) @ T_robot_sensor
        same(chained(edges, BODY, frame_of(name)), expected)
    assert ("base_link" in edges) == bool(parent)


def points_of(message):
    """xyz (n, 3) and RGB (n, 3) of a PointCloud2, by its own fields."""
    names = {f.name: f.offset for f in message.fields}
    rows = np.asarray(message.data).reshape(message.width, message.point_step)
    xyz = np.stack([rows[:, names[k] : names[k] + 4].copy().view("<f4")[:, 0] for k in "xyz"], 1)
    packed = rows[:, names["rgb"] : names["rgb"] + 4].copy().view("<u4")[:, 0]
    return xyz, np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], 1)


def messages_of(path):
    """{topic: [(log time, message)]} of an MCAP, by rosbags."""
    out = {}
    with AnyReader([path]) as reader:
        for connection, t, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            out.setdefault(connection.topic, []).append((t, message))
    return out


def test_the_mcap_for_foxglove_holds_coloured_clouds_and_points_drawn_into_the_images(
    finished_run, exported
):
    found = messages_of(exported / "foxglove_sim.mcap")
    result = read_json(finished_run / "results/sim/calibration.json")["sensors"]
    T = {n: np.array(s["T_robot_sensor"]["matrix"]) for n, s in result.items()}
    same(chained(edges_of_bag(exported / "foxglove_sim.mcap"), BODY, "camera"), T["camera"])
    assert len(found["/board/camera/image"]) == len(found["/board/camera/projected"]) == 4
    assert len(found["/board/camera/camera_info"]) == 4
    assert found["/tf_static"][0][0] <= min(t for m in found.values() for t, _ in m)
    camera = camera_from_config(
        sensor_of("left") | {"params": list(simulated_rigs.LENS_PARAMS["radtan"])}
    )
    coloured, drawn = 0, 0
    for (_, image), (_, marked) in zip(
        found["/board/camera/image"], found["/board/camera/projected"], strict=True
    ):
        plain, marked = (cv2.imdecode(m.data, cv2.IMREAD_COLOR) for m in (image, marked))
        assert plain.shape == (700, 900, 3) and marked.shape == plain.shape
        drawn += (np.abs(plain.astype(int) - marked).max(2) > 60).sum()
    assert drawn > 2000
    # A board that both saw is grey, black or white, and what lies there is not left without colour.
    for _, cloud in found["/board/velodyne/points"] + found["/cylinder/velodyne/points"]:
        assert cloud.header.frame_id == "velodyne"
        xyz, rgb = points_of(cloud)
        in_camera = transform_points(invert_pose(T["camera"]) @ T["velodyne"], xyz)
        uv, valid = camera.project(in_camera)
        away = ~(valid & camera.is_in_image(uv))
        assert (rgb[away] == 150).all()
        coloured += (rgb[~away] != 150).any(1).sum()
    assert coloured > 300
    # The target lies where the lidar saw it.
    for name in ("board", "cylinder"):
        where = dict(found[f"/{name}/points"])
        for t, cloud in found[f"/{name}/velodyne/points"]:
            scan = cKDTree(transform_points(T["velodyne"], points_of(cloud)[0]))
            nearest = scan.query(points_of(where[t])[0])[0]
            assert np.quantile(nearest, 0.1) < 0.03


def test_a_return_has_the_colour_of_the_pixel_that_shows_it():
    calibration, shown = described(parent="")
    image = np.zeros((*SIZE[::-1], 3), np.uint8)
    image[..., 0] = np.arange(SIZE[0]) % 251
    image[..., 1] = (np.arange(SIZE[1]) % 251)[:, None]
    known = np.ones(SIZE[::-1], bool)
    known[:, :450] = False
    p_left = np.array([[0.1, 0.2, 1.0], [-0.2, 0.1, 1.5], [0.1, 0.2, -1.0]])
    T_front_left = invert_pose(POSES["front"]) @ POSES["left"]
    scan = LidarView(0, xyz=transform_points(T_front_left, p_left))
    seen = {"left": CameraView(0, image=image, pixel_mask=known)}
    colours = color_lidar_returns(shown, shown.sensors["front"], scan, seen)
    uv, _ = shown.sensors["left"].camera.project(p_left[:1])
    u, v = np.rint(uv[0]).astype(int)
    assert colours.tolist() == [[u % 251, v % 251, 0], list(UNCOLORED_BGR), list(UNCOLORED_BGR)]


@pytest.fixture(scope="module")
def told_by_the_log(tmp_path_factory):
    """Exports of a camera that the rig gives no lens: CameraInfo in the log has it."""
    folder = simulate_into(tmp_path_factory.mktemp("heard"), f"{SMALL_ARGUMENTS} --camera-info")
    assert (
        "params" not in yaml.safe_load(simulated_rig_path(folder).read_text())["sensors"]["camera"]
    )
    run_to_completion(folder)
    return folder / "results/sim/export"


def pinhole(fx, fy, cx, cy):
    return [fx, 0, cx, 0, fy, cy, 0, 0, 1]


def lens_of_opencv(folder):
    file = cv2.FileStorage(str(folder / "opencv.yaml"), cv2.FILE_STORAGE_READ)
    found = file.getNode("sensors")
    nodes = (found.at(i) for i in range(found.size()))
    (node,) = (n for n in nodes if n.getNode("name").string() == "camera")
    return node.getNode("camera_matrix").mat(), node.getNode("distortion_coefficients").mat()


def lens_of_camera_info(folder):
    info = yaml.safe_load((folder / "camera_info_camera.yaml").read_text())
    return info["camera_matrix"]["data"], info["distortion_coefficients"]["data"]


def lens_of_kalibr(folder):
    cam = yaml.safe_load((folder / "camchain.yaml").read_text())["cam0"]
    return pinhole(*cam["intrinsics"]), cam["distortion_coeffs"]


def lens_of_mrcal(folder):
    model = ast.literal_eval((folder / "camera.cameramodel").read_text())
    return pinhole(*model["intrinsics"][:4]), model["intrinsics"][4:]


def lens_of_koide3(folder):
    cam = json.loads((folder / "koide3/velodyne/camera/calib.json").read_text())["camera"]
    return pinhole(*cam["intrinsics"]), cam["distortion_coeffs"]


def lens_of_foxglove(folder):
    (_, info), *_ = messages_of(folder / "foxglove_sim.mcap")["/board/camera/camera_info"]
    return info.k, info.d


LENSES = {
    "opencv": lens_of_opencv,
    "ros_camera_info": lens_of_camera_info,
    "kalibr": lens_of_kalibr,
    "mrcal": lens_of_mrcal,
    "koide3": lens_of_koide3,
    "foxglove": lens_of_foxglove,
}


@pytest.mark.parametrize("name", sorted(LENSES))
@pytest.mark.slow
def test_a_lens_that_the_log_tells_is_in_every_format_that_holds_one(name, told_by_the_log):
    """To 1e-6 px, by OpenCV, against the lens that the simulated camera has."""
    K, d = (np.array(v, float) for v in LENSES[name](told_by_the_log))
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.2], [0.0, 0.0, 1.0], [0.4, -0.3, 0.9]])
    found = cv2.projectPoints(points[None], np.zeros(3), np.zeros(3), K.reshape(3, 3), d)[0]
    lens = {"model": "radtan", "params": simulated_rigs.LENS_PARAMS["radtan"], "size_px": SIZE}
    uv, _ = camera_from_config(lens).project(points)
    assert np.reshape(found, (-1, 2)) == pytest.approx(uv, abs=1e-6)


def test_exports_come_out_the_same_byte_for_byte(finished_run, exported, monkeypatch):
    import export

    monkeypatch.chdir(finished_run)
    before = {p: p.read_bytes() for p in sorted(exported.rglob("*")) if p.is_file()}
    export.main(list_job_commands(finished_run)["export", ""])
    assert before == {p: p.read_bytes() for p in sorted(exported.rglob("*")) if p.is_file()}
    assert len(before) == 13


# --- parents and frames


def test_the_parent_may_be_a_sensor(tmp_path):
    _, shown = described(parent={"sensor": "front"})
    assert shown.parent_frame == "velodyne"
    assert "velodyne" not in {e.child for e in shown.static_transforms()}
    same(shown.sensors["down"].T_parent_sensor, np.linalg.inv(POSES["front"]) @ POSES["down"])
    assert pytest.approx(np.eye(4), abs=1e-12) == shown.sensors["front"].T_parent_sensor


def test_the_parent_may_be_a_link_known_from_a_sensor():
    T_base_lidar = pose_from_rpy([1.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    parent = {"frame": "base_link", "sensor": "front"}
    parent["T_parent_sensor"] = {"matrix": T_base_lidar.tolist()}
    _, shown = described(parent=parent)
    assert shown.parent_frame == "base_link"
    same(shown.sensors["front"].T_parent_sensor, T_base_lidar)
    relative = np.linalg.inv(POSES["front"]) @ POSES["left"]
    same(shown.sensors["left"].T_parent_sensor, T_base_lidar @ relative)


def test_frames_that_are_empty_taken_or_the_parent_s_go_by_the_sensor_and_that_is_said():
    frames = {"front": "", "down": "lidar", "left": "lidar", "right": "base_link", "fish": "/fish"}
    _, shown = described(frames=frames)
    found = {n: s.frame for n, s in shown.sensors.items()}
    assert found == {n: n for n in POSES} and len(shown.notes) == 4
    assert "the frame of front is exported as front: its messages have no frame_id" in shown.notes
    assert "the frame of down is exported as down: 2 sensors use lidar" in shown.notes
    assert "the frame of right is exported as right: base_link is the parent frame" in shown.notes


def test_the_body_of_a_camera_goes_by_the_name_that_the_rig_gives_it():
    _, shown = described(body_frames={"left": "", "right": "right_mount"})
    above = {e.child: e.parent for e in shown.static_transforms()}
    assert above["left_camera_optical_frame"] == "base_link"
    assert above["right"] == "right_mount" and above["right_mount"] == "base_link"


def test_intrinsics_that_were_estimated_go_before_those_configured():
    calibration, _ = described()
    params = [*MODELS["left"][1]]
    params[0] = 805.25
    found = {"model": "radtan", "params": params, "sigma": [0.1] * 9}
    calibration["sensors"]["left"]["intrinsics"] = found
    options = {
        "export": {"parent": "", "body_frames": {}, "max_views": 0},
        "body": BODY,
        "sensors": {n: sensor_of(n) for n in (*POSES, "rear")},
    }
    text = FORMATS["ros_camera_info"].render_files(build_export_scene(calibration, options))
    assert yaml.safe_load(text["camera_info_left.yaml"])["camera_matrix"]["data"][0] == 805.25


def test_kalibr_leaves_out_a_camera_with_a_k3_and_says_so():
    calibration, shown = described()
    left = shown.sensors["left"].camera
    object.__setattr__(left, "params", (*left.params[:8], 0.02))
    files = FORMATS["kalibr"].render_files(shown)
    assert "no k3, but left has k3 = 0.02" in files["camchain.yaml: left"].reason
    chain = yaml.safe_load(files["camchain.yaml"])
    assert [c["rostopic"] for c in chain.values()] == ["/fish/data", "/right/data"]
    fish, right = (T_parent_sensor(calibration, n) for n in ("fish", "right"))
    same(chain["cam1"]["T_cn_cnm1"], np.linalg.inv(right) @ fish)


@pytest.mark.parametrize("name", sorted(READERS))
def test_names_from_a_log_are_data_in_every_format(name, tmp_path):
    bad = "a\"b'c --> ${1/0} & <x> \n# y: [ $(cwd) "
    _, shown = described(frames=FRAMES | {"front": bad, "left": bad + "2"})
    files = FORMATS[name].render_files(shown)
    for file, content in files.items():
        if isinstance(content, Status):
            continue
        if file.endswith((".xml", ".urdf", ".xacro")):
            ElementTree.fromstring(content)
        elif file == "opencv.yaml":
            cv2.FileStorage(content, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        elif file.endswith(".cameramodel"):
            assert set(ast.literal_eval(content)) == {
                "lensmodel", "intrinsics", "extrinsics", "imagersize",
            }  # fmt: skip
        else:
            yaml.safe_load(content)
    if name == "xacro":
        (tmp_path / "s.xacro").write_text(
            files["sensors.urdf.xacro"].replace(
                "</robot>", '<link name="base_link"/><xacro:calibrated_sensors/></robot>'
            )
        )
        links = ElementTree.fromstring(xacro.process_file(str(tmp_path / "s.xacro")).toxml())
        names = {" ".join(e.get("name").split()) for e in links.iter("link")}
        assert {safe_name(bad), safe_name(bad + "2")} <= names


def test_the_index_names_every_file_and_what_could_not_be_written(finished_run, exported):
    text = (exported / README_FILE_NAME).read_text()
    for path in exported.rglob("*"):
        if path.is_file() and path.name != README_FILE_NAME:
            assert f"`{path.relative_to(exported)}`" in text
    _, shown = described()
    written = {n: {} for n in FORMATS}
    written["mrcal"] = {"fish.cameramodel": Status(False, "mrcal has no lens model")}
    judged = {"verdict": "warn", "reasons": ["left: placements 4, warn below 5"]}
    text = render_export_readme(shown, written, judged, {})
    assert "not written: fish.cameramodel: mrcal has no lens model" in text
    assert "left: placements 4, warn below 5" in text


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_every_file_of_a_warned_result_states_the_warning(tmp_path, name):
    """In its comments, or as data where the format has none; a passed one says nothing of it."""
    reason = "left: placements 4, warn below 5"
    session = ExportSession("s", 1, np.eye(4), {"placement": np.zeros(0, int)}, {})
    _, passed = described(sessions={"s": session})
    warned = replace(passed, verdict="warn", reasons=(reason,))
    files = {
        f: c for f, c in FORMATS[name].render_files(warned).items() if isinstance(c, str | bytes)
    }
    assert files
    for content in files.values():
        data = content if isinstance(content, bytes) else content.encode()
        assert f"WARN: {reason}".encode() in data
    for content in FORMATS[name].render_files(passed).values():
        assert not isinstance(content, str) or "WARN" not in content


def test_images_are_what_was_kept_of_them_and_black_elsewhere():
    part = np.full((20, 30, 3), 200, np.uint8)
    _, shown = described()
    row = {"stamp_ns": 7, "u0": 100, "v0": 50, "png": encode_png(part)}
    view = make_camera_view(shown.sensors["left"], row)
    assert (
        view.pixel_mask.sum() == 600 and view.pixel_mask[50, 100] and not view.pixel_mask[49, 100]
    )
    assert (view.image[50:70, 100:130] == 200).all() and view.image[:50].max() == 0


def test_urdf_numbers_hold_every_digit():
    T = POSES["down"]
    assert [float(w) for w in origin_attributes(T)["xyz"].split()] == T[:3, 3].tolist()
