"""A robot's URDF: read, patched in place with every other byte as it was, and read as a guess."""

import io
import json
import stat

import numpy as np
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st

import guess
from calib.export.calibrated_scene import ExportScene, ExportSensor
from calib.geometry.se3 import invert_pose, pose_from_rpy, se3_exp, se3_log, transform_points
from calib.initial_guess.previous_calibration import read_previous_calibration
from calib.initial_guess.stated_pose import read_stated_pose
from calib.io import config
from calib.io.pose_block import pose_from_config, pose_json
from calib.io.stage_cli import read_json, write_json
from calib.io.status import InputError
from calib.io.urdf import patch_urdf as patch_urdf_module
from calib.io.urdf.patch_urdf import patch_urdf
from calib.io.urdf.sensor_joints import T_BODY_OPTICAL, compute_joint_origins
from calib.io.urdf.urdf_file import fixed_joint_transforms, read_urdf_joints, replace_joint_origins
from helpers.small_run import (
    edit_yaml,
    list_job_commands,
    list_planned_jobs,
    run_snakemake,
    run_to_completion,
    simulated_config_path,
    simulated_rig_path,
)

ROBOT = """\
<?xml version='1.0'  encoding="utf-8"?>
<!DOCTYPE robot>
<!-- Our robot. <origin xyz="1 1 1"/> is no origin. -->
<robot   name="husky">
\t<link name="base_link"><visual><origin xyz="9 9 9" rpy="0 0 0"/><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="mast"/> <link name="velodyne"/>
  <joint name="mast_joint" type="fixed">
    <parent link="base_link"/><child link="mast"/>
    <origin xyz="0.1 0 0.5" rpy="0 0 0.2"/>
  </joint>
  <joint name='lidar' type='fixed'   >
    <!-- measured by Bob, ±2 cm -->
    <origin
        rpy = '0 0.1 0'
        xyz="0.2 0 0.1"   />
    <parent link="mast"/>
    <child link="velodyne"/>
  </joint>
  <link name="camera_link"/><link name="camera"/>
  <joint type="fixed" name="camera_mount">
    <parent link="velodyne"/>
    <child link="camera_link"/>
  </joint>
  <joint type="fixed" name="camera_optical">
    <origin xyz="0 0.01 0" rpy="-1.5707963267948966 0 -1.5707963267948966"/>
    <parent link="camera_link"/>
    <child link="camera"/>
  </joint>
  <link name="wheel"/>
  <joint name="wheel_joint" type="continuous"><parent link="base_link"/><child link="wheel"/><origin xyz="0 1 0"/></joint>
  <transmission name="t"><joint name="wheel_joint"><origin xyz="7 7 7"/></joint></transmission>
</robot>

"""  # noqa: E501
T_BASE_LIDAR = pose_from_rpy([0.31, 0.02, 0.64], [0.02, -0.03, 0.25])
T_BASE_CAMERA = pose_from_rpy([0.4, -0.1, 0.6], [-1.6, 0.03, -1.5])


def described(parent="base_link", **poses):
    """A Scene of sensors T_parent_sensor (4, 4) by name; cameras are called so."""
    sensors = {
        n: ExportSensor(n, "camera" if "camera" in n else "lidar", f"/{n}", n, T)
        for n, T in poses.items()
    }
    return ExportScene("husky", parent, np.eye(4), "mocap/robot", sensors)


def patch_file(path, scene):
    """Place the sensors of a scene in the URDF at a path."""
    return patch_urdf(path, scene.sensors.values(), scene.parent_frame)


def robot_of(text):
    return yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)


def patched(text, shown):
    data = text.encode()
    joints = read_urdf_joints(data, "robot.urdf")
    placed, unplaced = compute_joint_origins(joints, shown.sensors.values(), shown.parent_frame)
    return replace_joint_origins(data, joints, placed).decode(), placed, unplaced


def same(found, expected):
    """The same SE(3) to 1e-9, and a point goes where it should."""
    assert np.abs(se3_log(invert_pose(expected) @ found)).max() < 1e-9
    p = np.array([0.3, -1.2, 2.5])
    assert found[:3, :3] @ p + found[:3, 3] == pytest.approx(
        transform_points(expected, p), abs=1e-9
    )


# --- reading


def test_joints_are_read_as_another_reader_reads_them():
    robot = robot_of(ROBOT)
    joints = {j.name: j for j in read_urdf_joints(ROBOT.encode(), "robot.urdf")}
    assert set(joints) == set(robot.joint_map)
    for name, joint in joints.items():
        theirs = robot.joint_map[name]
        assert (joint.type, joint.parent, joint.child) == (theirs.type, theirs.parent, theirs.child)
        if joint.type == "fixed":
            same(joint.T_parent_child, robot.get_transform(joint.child, joint.parent))


@pytest.mark.parametrize(
    "text, words",
    [
        ("<robot", "robot.urdf: not valid XML: "),
        ("<sdf/>", "robot.urdf: its root is <sdf>, expected <robot>"),
        ("<robot><joint name='j'/></robot>", "joint 'j' has no parent link or no child link"),
        (
            ROBOT.replace('<child link="mast"/>', '<child link="velodyne"/>'),
            "robot.urdf: link velodyne is the child of two joints, expected a tree",
        ),
    ],
)
def test_what_is_no_urdf_is_refused_in_words(text, words):
    with pytest.raises(InputError) as caught:
        read_urdf_joints(text.encode(), "robot.urdf")
    assert words in str(caught.value)


def test_an_encoding_in_which_tags_cannot_be_found_is_refused():
    text = ROBOT.replace("utf-8", "utf-16")
    with pytest.raises(InputError, match="encoded as neither UTF-8 nor ASCII; convert it"):
        read_urdf_joints(text.encode("utf-16"), "robot.urdf")


# --- patching


def test_the_sensors_sit_where_the_calibration_has_them_and_all_else_stays():
    text, placed, unplaced = patched(ROBOT, described(velodyne=T_BASE_LIDAR, camera=T_BASE_CAMERA))
    assert set(placed) == {"velodyne", "camera_link"} and not unplaced
    before, after = robot_of(ROBOT), robot_of(text)
    same(after.get_transform("velodyne", "base_link"), T_BASE_LIDAR)
    same(after.get_transform("camera", "base_link"), T_BASE_CAMERA)
    # REP 103's turn to the optical frame stays as it was: the mount above it moved.
    optical = ("camera", "camera_link")
    same(after.get_transform(*optical), before.get_transform(*optical))
    same(after.get_transform("mast", "base_link"), before.get_transform("mast", "base_link"))


def test_only_the_origins_of_the_sensors_joints_change():
    text, _, _ = patched(ROBOT, described(velodyne=T_BASE_LIDAR, camera=T_BASE_CAMERA))
    old, new = ROBOT.splitlines(), text.splitlines()
    lidar = next(i for i, line in enumerate(old) if "rpy = '0 0.1 0'" in line)
    camera = next(i for i, line in enumerate(old) if "camera_mount" in line)
    assert new[: lidar - 1] == old[: lidar - 1]
    assert new[lidar - 1] == old[lidar - 1] == "    <origin"
    assert new[lidar].startswith('        rpy="') and new[lidar + 1].startswith('        xyz="')
    assert new[lidar + 1].endswith('"   />')
    assert new[lidar + 2 : camera + 1] == old[lidar + 2 : camera + 1]
    assert new[camera + 1].startswith('    <origin xyz="')  # it had none
    assert new[camera + 2 :] == old[camera + 1 :]
    assert text.endswith("</robot>\n\n")


def test_a_patched_file_is_patched_no_more():
    shown = described(velodyne=T_BASE_LIDAR, camera=T_BASE_CAMERA)
    once, _, _ = patched(ROBOT, shown)
    assert patched(once, shown)[0] == once


def test_line_ends_and_a_byte_order_mark_stay():
    text = "\ufeff" + ROBOT.replace("\n", "\r\n")
    new, _, _ = patched(text, described(velodyne=T_BASE_LIDAR))
    assert new.count("\r\n") == text.count("\r\n") == new.count("\n")
    assert new.startswith("\ufeff<?xml")
    same(robot_of(new[1:]).get_transform("velodyne", "base_link"), T_BASE_LIDAR)


def test_the_parent_may_hang_below_the_base():
    T_mast_lidar = pose_from_rpy([0.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    text, _, unplaced = patched(ROBOT, described("mast", velodyne=T_mast_lidar))
    assert not unplaced
    same(robot_of(text).get_transform("velodyne", "mast"), T_mast_lidar)


def test_the_parent_may_be_a_sensor_of_the_robot():
    T_lidar_camera = invert_pose(T_BASE_LIDAR) @ T_BASE_CAMERA
    shown = described("velodyne", velodyne=np.eye(4), camera=T_lidar_camera)
    text, placed, unplaced = patched(ROBOT, shown)
    assert set(placed) == {"camera_link"} and not unplaced
    same(robot_of(text).get_transform("camera", "velodyne"), T_lidar_camera)


def test_a_camera_without_an_optical_joint_is_placed_itself():
    tilted = ROBOT.replace('rpy="-1.5707963267948966 0', 'rpy="-1.4 0')
    text, placed, _ = patched(tilted, described(camera=T_BASE_CAMERA))
    assert set(placed) == {"camera"}
    same(robot_of(text).get_transform("camera", "base_link"), T_BASE_CAMERA)


numbers = st.floats(-3, 3, allow_nan=False)


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=12, max_size=12))
def test_any_pose_comes_back_from_the_file(values):
    lidar, camera = se3_exp(np.reshape(values, (2, 6)))
    text, _, _ = patched(ROBOT, described(velodyne=lidar, camera=camera))
    joints = read_urdf_joints(text.encode(), "robot.urdf")
    edges = fixed_joint_transforms(joints)
    T = edges["base_link", "mast"] @ edges["mast", "velodyne"]
    assert np.abs(T - lidar).max() < 1e-12
    T = T @ edges["velodyne", "camera_link"] @ edges["camera_link", "camera"]
    assert np.abs(T - camera).max() < 1e-12


@pytest.mark.parametrize(
    "old, new, parent, words",
    [
        (
            '<child link="velodyne"/>',
            '<child link="velodyne_2"/>',
            "base_link",
            "no joint has the child link velodyne; expected the frame of its messages. "
            "Did you mean velodyne_2?",
        ),
        ("type='fixed'", "type='revolute'", "base_link", "joint lidar is revolute"),
        (
            'xyz="0.2 0 0.1"',
            'xyz="${x} 0 0"',
            "base_link",
            "joint lidar: its origin is an expression of xacro, xyz='${x} 0 0'",
        ),
        (
            'xyz="0.2 0 0.1"',
            'xyz="0.2 0"',
            "base_link",
            "joint lidar: its origin has xyz='0.2 0', expected three numbers",
        ),
        (
            'xyz="0.2 0 0.1"',
            'xyz="0 0 0" quat_xyzw="0 0 0 1"',
            "base_link",
            "joint lidar: its origin has quat_xyzw beside xyz and rpy",
        ),
        ("", "", "mocap/robot", "no fixed joints lead from mocap/robot to mast"),
        ("", "", "wheel", "no fixed joints lead from wheel to mast"),
        ("", "", "camera_link", "no fixed joints lead from camera_link to mast"),
    ],
)
def test_a_joint_that_cannot_be_placed_stays_and_the_reason_is_given(old, new, parent, words):
    text = ROBOT.replace(old, new) if old else ROBOT
    after, placed, unplaced = patched(text, described(parent, velodyne=T_BASE_LIDAR))
    assert after == text and not placed
    assert words in str(unplaced["velodyne"])


# --- the file on disk


def test_the_first_state_of_the_file_stays_beside_it(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(ROBOT)
    path.chmod(0o640)
    patch_file(path, described(velodyne=T_BASE_LIDAR))
    once = path.read_text()
    assert once != ROBOT and (tmp_path / "robot.urdf.before-calibration").read_text() == ROBOT
    patch_file(path, described(velodyne=T_BASE_CAMERA))
    assert path.read_text() not in (ROBOT, once)
    assert (tmp_path / "robot.urdf.before-calibration").read_text() == ROBOT
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert len(list(tmp_path.iterdir())) == 2


def test_a_file_that_already_holds_the_calibration_is_not_touched(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(patched(ROBOT, described(velodyne=T_BASE_LIDAR))[0])
    before = path.stat()
    patch_file(path, described(velodyne=T_BASE_LIDAR))
    assert path.stat().st_mtime_ns == before.st_mtime_ns and path.stat().st_ino == before.st_ino
    assert len(list(tmp_path.iterdir())) == 1


def test_a_write_that_fails_leaves_the_file_whole(tmp_path, monkeypatch):
    path = tmp_path / "robot.urdf"
    path.write_text(ROBOT)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(patch_urdf_module.os, "fsync", full)
    with pytest.raises(InputError, match="no space left on the disk. Free some space"):
        patch_file(path, described(velodyne=T_BASE_LIDAR))
    assert path.read_text() == ROBOT and len(list(tmp_path.iterdir())) == 1


def test_a_link_to_the_file_is_refused_and_the_file_stays(tmp_path):
    (tmp_path / "real.urdf").write_text(ROBOT)
    (tmp_path / "robot.urdf").symlink_to("real.urdf")
    with pytest.raises(InputError, match="robot.urdf: a symbolic link to real.urdf"):
        patch_file(tmp_path / "robot.urdf", described(velodyne=T_BASE_LIDAR))
    assert (tmp_path / "real.urdf").read_text() == ROBOT


# --- in the pipeline

T_BASE_ROBOT = {"xyz_m": [0.05, -0.1, 0.2], "rpy_deg": [1, 2, -30]}


@pytest.fixture
def mounted(finished_run_copy):
    """A finished run whose rig now names a URDF."""
    (finished_run_copy / "robot.urdf").write_text(ROBOT)
    block = {
        "urdf": "robot.urdf",
        "parent": {"frame": "base_link", "T_parent_robot": T_BASE_ROBOT},
    }
    edit_yaml(simulated_rig_path(finished_run_copy), lambda r: r.update(export=block))
    return finished_run_copy


def result(folder):
    sensors = json.loads((folder / "results/sim/calibration.json").read_text())["sensors"]
    return {n: np.array(s["T_robot_sensor"]["matrix"]) for n, s in sensors.items()}


@pytest.mark.slow
def test_a_run_writes_the_calibration_into_the_urdf_and_then_plans_nothing(mounted):
    assert {rule for rule, _ in list_planned_jobs(mounted)} == {"export"}
    run_to_completion(mounted)
    text = (mounted / "robot.urdf").read_text()
    for name, T_robot_sensor in result(mounted).items():
        found = robot_of(text).get_transform(name, "base_link")
        same(found, pose_from_config(T_BASE_ROBOT) @ T_robot_sensor)
    assert not list_planned_jobs(mounted)
    index = (mounted / "results/sim/export/README.md").read_text()
    assert "## robot.urdf" in index and "the joint above link `camera_link`" in index
    # Put back by its owner, it is patched again.
    (mounted / "robot.urdf").write_text(ROBOT)
    assert {rule for rule, _ in list_planned_jobs(mounted)} == {"export"}
    run_to_completion(mounted)
    assert (mounted / "robot.urdf").read_text() == text


@pytest.mark.slow
def test_a_failed_verdict_leaves_the_urdf_as_it_was(mounted):
    limits = {"fail_placements": 99, "warn_placements": 99}
    edit_yaml(simulated_config_path(mounted), lambda c: c.update(judge=limits))
    assert run_snakemake(mounted).returncode == 1
    assert (mounted / "robot.urdf").read_text() == ROBOT


@pytest.mark.slow
def test_a_urdf_in_which_no_sensor_can_be_placed_ends_the_run_with_the_reason(mounted):
    edit_yaml(simulated_rig_path(mounted), lambda r: r["export"]["parent"].update(frame="base"))
    run = run_snakemake(mounted)
    assert run.returncode == 1
    last = run.stderr.split("sim: STOPPED")[1]
    assert (
        "robot.urdf: no sensor can be placed in it: camera: no fixed joints lead from base" in last
    )
    assert "velodyne: no fixed joints lead from base to mast. Set export.parent to" in last
    assert (mounted / "robot.urdf").read_text() == ROBOT


@pytest.mark.slow
def test_guesses_come_from_the_urdf_as_it_was_before_the_calibration(mounted, monkeypatch):
    def forget(r):
        r["guess_from"] = "robot.urdf"
        for sensor in r["sensors"].values():
            sensor.pop("T_robot_sensor")

    edit_yaml(simulated_rig_path(mounted), forget)
    before = list_job_commands(mounted)["guess", "camera"]
    joints = read_urdf_joints(ROBOT.encode(), "")
    shown = described(**{n: pose_from_config(T_BASE_ROBOT) @ T for n, T in result(mounted).items()})
    patch_file(mounted / "robot.urdf", shown)
    assert (mounted / "robot.urdf").read_text() != ROBOT
    assert list_job_commands(mounted)["guess", "camera"] == before
    found = mounted / "found.json"
    arguments = list(before)
    arguments[arguments.index("--output") + 1] = str(found)
    arguments[arguments.index("--audit") + 1] = str(mounted / "results/sim/sim/log.json")
    monkeypatch.chdir(mounted)
    guess.main(arguments)
    told = read_json(found)
    assert told["source"] == "robot.urdf"
    T = np.eye(4)
    for joint in joints[:4]:
        T = T @ joint.T_parent_child
    expected = invert_pose(pose_from_config(T_BASE_ROBOT)) @ T
    same(np.array(told["T_robot_sensor"]["matrix"]), expected)


# --- first guesses

RIG = {"body": "mocap/robot", "export": {}, "sensors": {"velodyne": {}, "camera": {}}}


def test_an_earlier_calibration_gives_its_poses_by_sensor(tmp_path):
    old = tmp_path / "old.json"
    poses = {"velodyne": pose_json(T_BASE_LIDAR), "camera": None, "gone": None}
    write_json(old, {"sensors": {n: {"T_robot_sensor": T} for n, T in poses.items()}})
    found = read_previous_calibration(str(old), RIG)
    assert set(found) == {"velodyne"} and found["velodyne"]["source"] == "old.json"
    same(np.array(found["velodyne"]["T_robot_sensor"]["matrix"]), T_BASE_LIDAR)
    options = {"name": "velodyne", "sensor": {}, "previous_poses": found, "body": "mocap/robot"}
    options["guess"] = {"sigma": {"xyz_m": 0.05, "rpy_deg": 5}}
    audit = {"sensors": {"velodyne": {"frame": "velodyne"}}, "static": []}
    guessed = read_stated_pose("velodyne", {}, options, audit)
    assert guessed.source == "old.json"
    same(guessed.value, T_BASE_LIDAR)


def test_the_rig_s_own_pose_goes_before_the_file_and_the_file_before_the_log():
    own, given = (
        {"T_robot_sensor": pose_json(T_BASE_LIDAR)},
        pose_json(T_BASE_CAMERA),
    )
    own = {"T_robot_sensor": {"matrix": T_BASE_LIDAR.tolist()}}
    options = {
        "previous_poses": {"s": {"source": "old.json", "T_robot_sensor": given}},
        "body": "b",
    }
    options["guess"] = {"sigma": {"xyz_m": 0.05, "rpy_deg": 5}}
    static = [{"parent": "b", "child": "f", "T": {"xyz_m": [0, 0, 0], "quat_xyzw": [0, 0, 0, 1]}}]
    audit = {"sensors": {"s": {"frame": "f"}}, "static": static}
    assert read_stated_pose("s", own, options, audit).source == "config"
    assert read_stated_pose("s", {}, options, audit).source == "old.json"
    assert read_stated_pose("s", {}, options | {"previous_poses": {}}, audit).source == "tf_static"
    lost = {"s": {"source": "robot.urdf", "static": [static[0] | {"child": "elsewhere"}]}}
    assert (
        read_stated_pose("s", {}, options | {"previous_poses": lost}, audit).source == "tf_static"
    )


@pytest.mark.parametrize(
    "content, words",
    [
        ("{}", "old.json is not a calibration.json: KeyError('sensors')"),
        ("[", "old.json is not a calibration.json: "),
        (
            '{"sensors": {"other": {"T_robot_sensor": null}}}',
            "old.json has no pose of a sensor of this rig; found no pose, ",
        ),
    ],
)
def test_a_file_that_gives_no_guess_is_refused_in_words(tmp_path, content, words):
    (tmp_path / "old.json").write_text(content)
    with pytest.raises(InputError) as caught:
        read_previous_calibration(str(tmp_path / "old.json"), RIG)
    assert words in str(caught.value)


def test_a_result_is_not_its_own_first_guess(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="Copy the file out of results/"):
        read_previous_calibration("results/sim/calibration.json", RIG)


def test_a_urdf_that_does_not_know_the_robot_s_body_says_what_to_write(tmp_path):
    (tmp_path / "robot.urdf").write_text(ROBOT)
    with pytest.raises(
        InputError, match="Set export.parent in the rig: `frame`, a link of this URDF, and T_p"
    ):
        read_previous_calibration(str(tmp_path / "robot.urdf"), RIG)


# --- what the rig's file says


def complete(**more):
    content = {
        "body": "mocap/robot",
        "mocap": {"topics": ["/tf"], "map": "world"},
        "sensors": {"velodyne": {"kind": "lidar", "topic": "/points"}},
    }
    return content | more


@pytest.mark.parametrize(
    "more, words",
    [
        ({"guess_from": "none.urdf"}, "sim.yaml: guess_from: no file none.urdf in "),
        ({"export": {"urdf": "none.urdf"}}, "sim.yaml: export.urdf: no file none.urdf in "),
        (
            {"export": {"parent": {"sensor": "velodine"}}},
            "sim.yaml: export.parent: no sensor velodine. Did you mean velodyne?",
        ),
        (
            {"export": {"body_frames": {"left": "x"}}},
            "sim.yaml: export.body_frames: no sensor left. Known: velodyne",
        ),
        (
            {"export": {"parent": {"frame": "base_link"}}},
            "export.parent: {'frame': 'base_link'}; expected Parent frame of the exports: frame "
            "with T_parent_robot",
        ),
        ({"export": {"parents": {}}}, "export: unknown key parents. Did you mean parent?"),
    ],
)
def test_a_wrong_export_block_is_refused_before_anything_runs(tmp_path, more, words):
    path = tmp_path / "sim.yaml"
    write_json(path, complete(**more))
    with pytest.raises(InputError) as caught:
        config._load_rig(str(path))
    assert words in str(caught.value)


def test_rep_103_turns_the_optical_frame_into_the_body():
    T = pose_from_rpy([0, 0, 0], [-np.pi / 2, 0, -np.pi / 2])
    assert np.abs(T - T_BODY_OPTICAL).max() < 1e-15
