"""Names and texts of every kind of mischief in a calibration: real readers find data alone."""

import ast
import io
import json
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import xacro
import yaml
import yourdfpy
from markdown_it import MarkdownIt

from calib.export.export_readme import render_export_readme
from calib.export.formats.format_registry import FORMATS
from calib.export.scene_from_calibration import build_export_scene
from calib.geometry.se3 import pose_from_rpy
from calib.io.pose_block import pose_json
from calib.io.safe_names import SAFE_NAME_PATTERN, safe_name
from calib.io.status import Status, failure_status
from calib.io.urdf.sensor_joints import SensorJoints
from helpers.mischief import MISCHIEF

BINARY_FORMATS = {"tf_static", "foxglove"}
POSE = pose_json(pose_from_rpy([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]))
LENS = {
    "model": "radtan",
    "params": [800.0, 800.0, 450.0, 350.0, 0, 0, 0, 0],
    "size_px": [900, 700],
}
LAUNCH_SUBSTITUTION = re.compile(r"\$\(")  # how the launch grammar opens a substitution


def hostile_sensor(kind, frame, name):
    """A sensor of calibration.json whose frame and status a stranger wrote."""
    status = failure_status(name, name, name, name).to_dict()
    return {
        "kind": kind,
        "frame": frame,
        "status": status,
        "T_robot_sensor": POSE,
        "intrinsics": None,
    }


def hostile_scene(name):
    """The scene of a calibration whose every name and text is mischief."""
    sensors = {
        "front": hostile_sensor("lidar", name, name),
        "left": hostile_sensor("camera", f"{name}_optical_frame", name),
        "rear": hostile_sensor("lidar", name, name) | {"T_robot_sensor": None},
    }
    calibration = {"rig": name, "verdict": "warn", "reasons": [name], "sensors": sensors}
    calibration |= {"targets": {}, "sessions": {}}
    topics = {n: {"kind": s["kind"], "topic": safe_name(f"/{name}")} for n, s in sensors.items()}
    topics["left"] |= LENS
    export = {"parent": {"frame": f"base {name}", "T_parent_robot": POSE}, "body_frames": {}}
    options = {"export": export | {"max_views": 1}, "body": name, "sensors": topics}
    return build_export_scene(calibration, options)


@pytest.fixture(scope="module", params=MISCHIEF)
def hostile_files(request):
    """The scene of one name of mischief and the text files of all formats."""
    scene = hostile_scene(request.param)
    formats = [FORMATS[n] for n in FORMATS if n not in BINARY_FORMATS]
    found = {k: v for f in formats for k, v in f.render_files(scene).items()}
    return request.param, scene, {k: v for k, v in found.items() if not isinstance(v, Status)}


def frames_of(scene):
    return {t.child for t in scene.static_transforms()} | {scene.parent_frame}


def test_every_frame_is_a_name_that_ros_allows(hostile_files):
    _, scene, _ = hostile_files
    assert len(frames_of(scene)) >= 3
    assert all(
        SAFE_NAME_PATTERN.fullmatch(f) for f in [*frames_of(scene), scene.rig, scene.robot_body]
    )


def test_a_launch_file_has_no_substitution_and_names_its_frames(hostile_files):
    _, scene, files = hostile_files
    root = ElementTree.fromstring(files["static_transforms.launch.xml"])
    assert root.tag == "launch" and {n.tag for n in root} == {"node"}
    children = set()
    for node in root:
        assert set(node.attrib) == {"pkg", "exec", "name", "args"}
        assert not any(LAUNCH_SUBSTITUTION.search(v) for v in node.attrib.values())
        words = shlex.split(node.get("args"))
        assert len(words) == 18 and all(w.startswith("--") for w in words[::2])
        children.add(words[words.index("--child-frame-id") + 1])
    assert children | {scene.parent_frame} == frames_of(scene)


def test_urdf_and_xacro_hold_the_links_and_nothing_else(hostile_files, tmp_path):
    _, scene, files = hostile_files
    robot = yourdfpy.URDF.load(io.StringIO(files["sensors.urdf"]), load_meshes=False)
    assert set(robot.link_map) == frames_of(scene)
    (tmp_path / "sensors.xacro").write_text(files["sensors.urdf.xacro"])
    (tmp_path / "robot.xacro").write_text(
        '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:include filename="{tmp_path}/sensors.xacro"/><link name="{scene.parent_frame}"/>'
        "<xacro:calibrated_sensors/></robot>"
    )
    text = xacro.process_file(str(tmp_path / "robot.xacro")).toxml()
    assert {e.get("name") for e in ElementTree.fromstring(text).iter("link")} == frames_of(scene)


def test_yaml_readers_find_plain_data(hostile_files):
    _, scene, files = hostile_files
    transforms = yaml.safe_load(files["static_transforms.yaml"])["transforms"]
    assert {t["child_frame_id"] for t in transforms} | {scene.parent_frame} == frames_of(scene)
    assert set(yaml.safe_load(files["sensor_kit_calibration.yaml"])) == {scene.parent_frame}
    assert yaml.safe_load(files["camchain.yaml"])["cam0"]["resolution"] == [900, 700]
    assert yaml.safe_load(files["camera_info_left.yaml"])["camera_name"] == "left"
    flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
    opencv = cv2.FileStorage(files["opencv.yaml"], flags)
    assert opencv.getNode("parent").string() == scene.parent_frame


def test_literals_and_json_are_read(hostile_files):
    _, _, files = hostile_files
    assert ast.literal_eval(files["left.cameramodel"])["lensmodel"] == "LENSMODEL_OPENCV5"
    assert json.loads(files["koide3/front/left/calib.json"])["results"]["T_lidar_camera"]


def test_the_readme_is_text_without_html_links_or_headings_of_others(hostile_files):
    name, scene, files = hostile_files
    status = failure_status(name, name, name, name)
    joints = SensorJoints({"velodyne": np.eye(4)}, {"front": status})
    verdict = {"verdict": "warn", "reasons": [name]}
    by_format = {"urdf": {"sensors.urdf": Status(), "other": status}}
    text = render_export_readme(scene, by_format, verdict, {Path(f"{name[:99]}.urdf"): joints})
    tokens = MarkdownIt("commonmark").parse(text)
    kinds = [t.type for b in tokens for t in [b, *(b.children or ())]]
    assert not {"html_block", "html_inline", "link_open", "image", "fence"} & set(kinds)
    assert kinds.count("heading_open") == 3 and all(c.isprintable() or c == "\n" for c in text)
