"""The simulator keeps its promises: exact surfaces, times and pixels, the same bytes."""

import hashlib
import json
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

import simulate
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    pose_from_xyz_quat,
    rotation_angle,
    se3_log,
    transform_points,
)
from calib.sensors.camera.camera_model import CameraModel
from simulate import draw_sessions, parse_simulation_arguments
from simulation.sensors.camera_exposure import digitize_image
from simulation.sensors.cloud_formats import CLOUD_FORMATS
from simulation.sensors.image_renderer import (
    COARSE_POINTS_PER_PIXEL,
    _interpolation_weights,
    compute_ray_grid,
    render_image,
)
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import measure_body_poses
from simulation.sensors.scan_patterns import SCAN_PATTERNS
from simulation.session_recording import MCS_MARGIN_NS, generate_tf_messages
from simulation.world.ray_casting import PosedScene
from simulation.world.ray_surfaces import intersect_cylinder
from simulation.world.room_scene import (
    ARM_M,
    POLE_M,
    SIMULATED_TARGETS,
    build_scene,
    place_surfaces,
)
from simulation.world.smooth_motion import (
    find_motion_progress,
    interpolate_placement_poses,
    schedule_placements,
)

SHORT = ["--placements", "2", "--hold-s", "0.4", "--move-s", "0.4"]
SCHEMAS = Path(__file__).parents[3] / "workflow" / "schemas"
ROUNDING_M = 2e-6  # of float32 coordinates below 8 m, and a margin
PIXEL_RMS = 0.001
DISTORTED = ["--distortion", "-0.1", "0", "0", "0"]


def draw(*arguments):
    """The only session of the arguments, without a file."""
    return draw_sessions(parse_simulation_arguments(["nowhere", *arguments]))[0][0]


def run(folder, *arguments):
    """Folder in which simulate.py has written a log."""
    simulate.main([str(folder), *arguments])
    return folder


def digest(folder):
    """Hash of each file below folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def read(folder):
    """(log time, message) of each topic of the log in folder."""
    messages = {}
    with AnyReader([folder / "logs" / "sim.mcap"]) as reader:
        for connection, log_t, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((log_t, message))
    return messages


def stamp(message):
    """Time of a message with a header, ns."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def read_points(message):
    """Positions (n, 3), m, lidar frame, and times (n,), ns on the log's clock, of a PointCloud2."""
    points = message.data.view(CLOUD_FORMATS["velodyne"].point_dtype)
    xyz = np.stack([points[c] for c in "xyz"], -1).astype(float)
    return xyz, stamp(message) + np.round(points["time"].astype(float) * 1e9).astype(np.int64)


def distances(scene, surfaces, p_world):
    """Distance (n,), m, of points (n, 3) to the nearest of all surfaces, taken analytically."""
    nearest = np.full(len(p_world), np.inf)
    for surface in scene.surfaces:
        p = transform_points(invert_pose(surfaces[surface.name]), p_world)
        nearest = np.minimum(nearest, DISTANCE[surface.shape](surface.shape_params, p))
    return nearest


def board_distance(size, p):
    outside = np.max((p[:, :2] @ size[0].T - size[1]) / np.linalg.norm(size[0], axis=1), axis=1)
    return np.hypot(np.maximum(outside, 0), p[:, 2])


def box_distance(half, p):
    return np.abs(np.max(np.abs(p) - half, axis=1))


def room_distance(size, p):
    return np.abs(np.stack([size[0] - np.abs(p[:, 0]), size[1] - np.abs(p[:, 1]), p[:, 2]])).min(0)


def cylinder_distance(size, p):
    gaps = np.hypot(p[:, 1], p[:, 2]) - size[1], np.abs(p[:, 0]) - size[0] / 2
    return np.abs(np.max(gaps, axis=0))


DISTANCE = {
    "board": board_distance,
    "box": box_distance,
    "room": room_distance,
    "cylinder": cylinder_distance,
}


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A short log without noise, its truth and its messages."""
    folder = run(tmp_path_factory.mktemp("short"), *SHORT)
    truth = json.loads((folder / "truth.json").read_text())
    return SimpleNamespace(folder=folder, truth=truth, messages=read(folder), session=draw(*SHORT))


def test_noise_free_points_lie_on_the_true_surfaces_at_their_own_times(short):
    T_robot_lidar = np.array(short.truth["sensors"]["velodyne"]["T_robot_sensor"]["matrix"])
    moving = 0
    for _, message in short.messages["/velodyne_points"]:
        xyz, t = read_points(message)
        surfaces = short.session.surface_poses(t)
        T_world_lidar = short.session.true_body_poses("robot", t) @ T_robot_lidar
        gap = distances(short.session.scene, surfaces, transform_points(T_world_lidar, xyz))
        assert gap.max() < ROUNDING_M
        moving += np.sum(find_motion_progress(t, short.session.placement_times_ns)[1] > 0)
    assert moving > 10_000


def test_points_of_a_moving_scan_are_off_the_surfaces_of_its_first_point_by_centimetres(short):
    start = short.session.placement_times_ns[0, 1] + 100_000_000
    message = next(m for _, m in short.messages["/velodyne_points"] if stamp(m) > start)
    xyz, t = read_points(message)
    when = np.full(len(t), t[0])
    surfaces = short.session.surface_poses(when)
    T = short.session.true_body_poses("robot", when) @ short.session.rig.T_robot_sensor["velodyne"]
    assert distances(short.session.scene, surfaces, transform_points(T, xyz)).max() > 0.01


def test_the_truth_file_alone_puts_the_points_of_a_placement_on_the_targets(short):
    """The cylinder at radius 0.1 m, the board in z = 0, from truth.json and the log only."""
    T_robot_lidar = pose_from_xyz_quat(
        *(short.truth["sensors"]["velodyne"]["T_robot_sensor"][k] for k in ("xyz_m", "quat_xyzw"))
    )
    for placement in short.truth["placements"]:
        for _, message in short.messages["/velodyne_points"]:
            xyz, t = read_points(message)
            if t[0] < placement["start_ns"] or t[-1] > placement["end_ns"]:
                continue
            T = {k: np.array(v["matrix"]) for k, v in placement["T_robot_target"].items()}
            on_board = transform_points(invert_pose(T["board"]) @ T_robot_lidar, xyz)
            face = (np.abs(on_board[:, :2]).sum(1) < 0.7) & (np.abs(on_board[:, 2]) < 0.02)
            assert np.sum(face) > 300
            assert np.abs(on_board[face, 2]).max() < ROUNDING_M
            on_cylinder = transform_points(invert_pose(T["cylinder"]) @ T_robot_lidar, xyz)
            radius = np.hypot(on_cylinder[:, 1], on_cylinder[:, 2])
            side = (np.abs(on_cylinder[:, 0]) < 0.395) & (radius < 0.15)
            assert np.sum(side) > 50
            assert np.abs(radius[side] - 0.1).max() < ROUNDING_M


def test_the_mcs_reports_the_true_poses_when_it_has_no_noise(short):
    bodies = {"mocap/robot": "robot", "mocap/board": "board", "mocap/cylinder": "cylinder"}
    for _, message in short.messages["/tf"][::10]:
        assert [item.child_frame_id for item in message.transforms] == list(bodies)
        for item in message.transforms:
            p, q = item.transform.translation, item.transform.rotation
            T = pose_from_xyz_quat([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
            true = short.session.true_body_poses(bodies[item.child_frame_id], [stamp(item)])[0]
            assert np.abs(se3_log(invert_pose(true) @ T)).max() < 1e-12
            assert item.header.frame_id == "mocap/world"


def test_the_log_holds_what_its_duration_and_rates_ask_for(short):
    """1.2 s: 1.4 s of /tf at 100 Hz, whole scans at 10 Hz, images at 4 Hz."""
    messages = short.messages
    assert {k: len(v) for k, v in messages.items()} == {
        "/tf": 141,
        "/velodyne_points": 12,
        "/camera/image_raw": 5,
        "/camera/camera_info": 5,
    }
    for topic, period in (("/velodyne_points", 10**8), ("/camera/image_raw", 25 * 10**7)):
        assert np.all(np.diff([stamp(m) for _, m in messages[topic]]) == period)
    for topic, latest in (("/tf", 0.01), ("/velodyne_points", 0.11), ("/camera/image_raw", 0.03)):
        first = [m.transforms[0] if topic == "/tf" else m for _, m in messages[topic]]
        late = [(t - stamp(m)) / 1e9 for (t, _), m in zip(messages[topic], first, strict=True)]
        assert min(late) > 0 and max(late) < latest


def test_every_image_comes_with_a_camera_info_of_its_stamp(short):
    images, infos = (short.messages[f"/camera/{k}"] for k in ("image_raw", "camera_info"))
    assert [stamp(m) for _, m in images] == [stamp(m) for _, m in infos]
    assert infos[0][1].k.tolist() == [802.3, 0, 452.6, 0, 801.1, 347.9, 0, 0, 1]


def test_the_messages_have_the_layout_of_the_drivers(short):
    cloud, image = (short.messages[k][0][1] for k in ("/velodyne_points", "/camera/image_raw"))
    layout = [(f.name, f.offset, f.datatype) for f in cloud.fields]
    assert layout == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("intensity", 12, 7),
        ("ring", 16, 4),
        ("time", 18, 7),
    ]
    assert (cloud.point_step, cloud.header.frame_id) == (22, "velodyne")
    assert (image.width, image.height, image.step) == (900, 700, 2700)
    assert (image.encoding, image.header.frame_id) == ("bgr8", "camera")


def test_point_times_start_at_the_stamp_and_span_the_sector(short):
    for _, message in short.messages["/velodyne_points"]:
        xyz, t = read_points(message)
        after = (t - stamp(message)) / 1e9
        assert after[0] == 0 and np.all(np.diff(after) >= 0)
        assert after[-1] == pytest.approx(0.1 * 200 / 360, abs=0.1 * 0.2 / 360)
        azimuth = np.rad2deg(np.arctan2(xyz[:, 1], xyz[:, 0]))
        assert azimuth == pytest.approx(100 - 3600 * after, abs=1e-3)


def test_placements_show_the_targets_as_far_and_as_clear_as_promised():
    session = draw("--placements", "12")
    for k in range(12):
        T = {name: knots[k] for name, knots in session.placement_poses.items()}
        T_lidar_robot = invert_pose(T["robot"] @ session.rig.T_robot_sensor["velodyne"])
        seen = {name: T_lidar_robot @ T[name] for name in session.T_body_target}
        reach = {name: np.linalg.norm(T_seen[:3, 3]) for name, T_seen in seen.items()}
        assert min(reach.values()) >= 1.4 and max(reach.values()) <= 3.2
        cosine = -seen["board"][:3, 2] @ seen["board"][:3, 3] / reach["board"]
        assert np.rad2deg(np.arccos(cosine)) < 35.001
        assert np.linalg.norm(T["board"][:3, 3] - T["cylinder"][:3, 3]) > 0.6 + 0.707 + 0.412


def test_robot_steps_between_placements_are_small():
    knots = draw("--placements", "12").placement_poses["robot"]
    steps = invert_pose(knots[:-1]) @ knots[1:]
    assert np.linalg.norm(steps[:, :3, 3], axis=1).max() < 0.3
    assert np.rad2deg(rotation_angle(steps)).max() < 11


@given(st.integers(0, 1000), st.floats(-45, 45), st.floats(-30, 30))
@settings(max_examples=30, deadline=None)
def test_the_stand_stays_behind_the_board_as_far_down_as_the_board_reaches(seed, lean, roll):
    height = 0.8 + 0.4 * np.random.default_rng(seed).uniform()
    facing = pose_from_rpy([2, 0, height], np.deg2rad([90, 0, -90]))
    T = facing @ pose_from_rpy([0, 0, 0], np.deg2rad([lean, 0, 0]))
    T = T @ pose_from_rpy([0, 0, 0], np.deg2rad([0, 0, roll]))
    for name, surface in place_surfaces({"board": T}).items():
        if name not in ("board_arm", "board_pole"):
            continue
        length = ARM_M if name == "board_arm" else POLE_M
        p = transform_points(
            surface, np.linspace(-length / 2, length / 2, 500)[:, None] * [1, 0, 0]
        )
        beside = p[:, 2] > height - 0.72
        assert transform_points(invert_pose(T), p[beside])[:, 2].max() < -0.02


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
@settings(max_examples=50, deadline=None)
def test_rays_meet_a_cylinder_on_its_side_or_on_its_caps(y, z, slope):
    o = np.array([[1.0], [2.0 + y], [z]])
    d = np.array([[slope - 0.5], [-1.0], [-0.3 * z]])
    t, face = intersect_cylinder((0.8, 0.1), o, d)
    if not np.isfinite(t[0]):
        return
    p = (o + t * d)[:, 0]
    radius = np.hypot(p[1], p[2])
    on_side = face[0] == 0 and abs(radius - 0.1) < 1e-12 and abs(p[0]) <= 0.4
    assert on_side or (abs(abs(p[0]) - 0.4) < 1e-12 and radius <= 0.1)


@given(st.lists(st.floats(0, 1), min_size=2, max_size=2))
@settings(max_examples=50, deadline=None)
def test_poses_are_continuous_and_still_during_a_placement(fractions):
    times = schedule_placements([0, 1], 1.0, 0.8)
    knots = np.stack(
        [pose_from_rpy([0, 0, 0], [0, 0, 0]), pose_from_rpy([1, 0, 0.5], [0.3, 0, 1.0])]
    )
    still = times[0, 0] + np.int64(1e9 * fractions[0])
    assert np.array_equal(interpolate_placement_poses([still], times, knots)[0], knots[0])
    t = times[0, 1] + np.int64(0.8e9 * fractions[1])
    near = interpolate_placement_poses([t, t + 1000], times, knots)
    assert np.abs(near[1] - near[0]).max() < 1e-5


def test_the_written_guess_is_off_the_truth_by_no_more_than_stated(short):
    rig = yaml.safe_load((short.folder / "config/rigs/sim.yaml").read_text())
    for name, sensor in rig["sensors"].items():
        written = sensor["T_robot_sensor"]
        guess = pose_from_rpy(written["xyz_m"], np.deg2rad(written["rpy_deg"]))
        true = np.array(short.truth["sensors"][name]["T_robot_sensor"]["matrix"])
        assert 0.001 < np.abs(guess[:3, 3] - true[:3, 3]).max() <= 0.03 + 1e-6
        turn = np.rad2deg(np.abs(se3_log(invert_pose(true) @ guess)[3:]))
        assert 0.1 < turn.max() <= 5 + 1e-5


def test_a_guess_without_error_is_the_truth(tmp_path):
    sessions, guesses = draw_sessions(
        parse_simulation_arguments(
            [str(tmp_path), "--guess-error-m", "0", "--guess-error-deg", "0"]
        )
    )
    session = sessions[0]
    for name, T in session.rig.T_robot_sensor.items():
        assert np.abs(guesses[name] - T).max() < 1e-15


@pytest.mark.parametrize("name", ["config", "rig", "target"])
def test_the_written_configuration_is_valid(short, name):
    schema = yaml.safe_load((SCHEMAS / f"{name}.schema.yaml").read_text())
    pattern = {"config": "config.yaml", "rig": "rigs/*.yaml", "target": "targets/*.yaml"}[name]
    for path in (short.folder / "config").glob(pattern):
        jsonschema.validate(yaml.safe_load(path.read_text()), schema)


EVERYTHING = """
    --image-noise 1.8 --range-noise-m 0.01 --beam-bias-m 0.005 --beam-divergence-deg 0.2
    --blur-px 0.7 --exposure-s 0.02 --compressed jpeg --camera-model kannala_brandt --lidar livox
    --mcs-noise-m 0.0002 --mcs-dropout 0.1 --label-swaps 2 --target-scale 1.001 --camera-hz 3
"""


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path):
    arguments = [*SHORT, *EVERYTHING.split()]
    one, two = (digest(run(tmp_path / name, *arguments)) for name in "ab")
    assert one == two and len(one) == 6
    plain, other = (draw(*SHORT, "--seed", seed) for seed in "12")
    assert np.abs(plain.placement_poses["board"] - other.placement_poses["board"]).max() > 0.01
    assert (
        np.abs(plain.rig.T_robot_sensor["camera"] - other.rig.T_robot_sensor["camera"]).max()
        > 0.001
    )


def test_noise_leaves_rig_and_placements_as_they_are():
    plain = draw("--placements", "3")
    noisy = draw("--placements", "3", "--mcs-bias-m", "0.001", "--mount-m", "0.01")
    for name, knots in plain.placement_poses.items():
        assert np.array_equal(knots, noisy.placement_poses[name])
    for name, T in plain.rig.T_robot_sensor.items():
        assert np.array_equal(T, noisy.rig.T_robot_sensor[name])


def test_range_noise_has_its_standard_deviation_along_the_beam():
    session = draw("--placements", "1")
    surfaces = place_surfaces({k: session.placement_poses[k][0] for k in session.T_body_target})
    T_world_lidar = session.placement_poses["robot"][0] @ session.rig.T_robot_sensor["velodyne"]
    firing, rng = (
        SCAN_PATTERNS["beams16"].make_firing(np.deg2rad(100), 0),
        np.random.default_rng(0),
    )
    exact, noisy = (
        scan_scene(
            PosedScene(session.scene, surfaces, T_world_lidar), firing, rng=rng, range_sigma_m=sigma
        )
        for sigma in (0.0, 0.01)
    )
    a, b = (echoes.xyz[exact.has_return] for echoes in (exact, noisy))
    beam = a / np.linalg.norm(a, axis=1)[:, None]
    along = np.sum((b - a) * beam, axis=1)
    assert np.std(along) == pytest.approx(0.01, rel=0.03)
    assert np.abs(np.cross(b - a, beam)).max() < ROUNDING_M


def test_image_noise_has_its_standard_deviation_after_rounding():
    flat = np.full((400, 400, 3), 120.0)
    image = digitize_image(flat, "bgr8", 1.8, np.random.default_rng(0)).astype(float)
    for channel in range(3):
        sigma = np.std(image[..., channel])
        assert sigma == pytest.approx(np.hypot(1.8, 12**-0.5), rel=0.01)
    assert np.abs(np.corrcoef(image.reshape(-1, 3).T) - np.eye(3)).max() < 0.02


def test_mcs_noise_is_white_and_its_bias_lasts_a_placement():
    """White: 0.2 mm and 0.02° per axis. Bias: 0.5 mm and 0.05° per axis, over 60 placements."""
    session = draw(
        *("--placements", "60", "--targets", "board", "--mcs-noise-m", "0.0002"),
        *("--mcs-noise-deg", "0.02", "--mcs-bias-m", "0.0005", "--mcs-bias-deg", "0.05"),
    )
    means, scatter = [], []
    for start in session.placement_times_ns[:, 0]:
        t = start + 10_000_000 * np.arange(100)
        T = measure_body_poses(session, np.random.default_rng(start), "robot", t)
        xi = se3_log(invert_pose(session.true_body_poses("robot", t)) @ T)
        means.append(xi.mean(0))
        scatter.append(xi - xi.mean(0))
    white, bias = np.std(np.concatenate(scatter), axis=0), np.std(means, axis=0)
    assert white[:3] == pytest.approx(0.0002, rel=0.05)
    assert white[3:] == pytest.approx(np.deg2rad(0.02), rel=0.05)
    assert bias[:3] == pytest.approx(0.0005, rel=0.35)
    assert bias[3:] == pytest.approx(np.deg2rad(0.05), rel=0.35)


def test_mcs_wanders_as_a_gauss_markov_process_of_the_time_constant_asked_for():
    """0.5 mm and 0.02, 0.07, 0.03° per axis over 1000 s; correlation e^-1 after 2 s."""
    session = draw(
        *("--placements", "2", "--targets", "board", "--mcs-wander-m", "0.0005"),
        *("--mcs-wander-deg", "0.02", "0.07", "0.03", "--mcs-wander-s", "2"),
    )
    t = session.placement_times_ns[0, 0] - np.arange(50_000)[::-1] * 20_000_000
    T = measure_body_poses(session, np.random.default_rng(0), "robot", t)
    xi = se3_log(invert_pose(session.true_body_poses("robot", t)) @ T)
    assert np.std(xi, 0)[:3] == pytest.approx(np.full(3, 0.0005), rel=0.15)
    assert np.std(xi, 0)[3:] == pytest.approx(np.deg2rad([0.02, 0.07, 0.03]), rel=0.15)
    after_2_s = [np.corrcoef(x[100:], x[:-100])[0, 1] for x in xi.T]
    assert np.mean(after_2_s) == pytest.approx(np.exp(-1), abs=0.08)


def test_the_rate_of_the_mcs_is_the_one_asked_for():
    session = draw("--placements", "2", "--mcs-hz", "8")
    stamps = [stamp(m[3].transforms[0]) for m in generate_tf_messages(session)]
    assert np.unique(np.diff(stamps)).tolist() == [125_000_000]


def test_a_wrong_scale_of_the_mcs_lengthens_all_distances_in_its_map():
    """By 0.4 %: those of robot and board to the map's origin and to each other."""
    arguments = ("--placements", "3", "--targets", "board")
    right, wrong = draw(*arguments), draw(*arguments, "--mcs-scale-error", "0.004")
    t = right.placement_times_ns[:, 0]
    rng = np.random.default_rng(0)
    for name in ("robot", "board"):
        T, scaled = (measure_body_poses(s, rng, name, t) for s in (right, wrong))
        np.testing.assert_allclose(scaled[:, :3, 3], 1.004 * T[:, :3, 3], rtol=1e-12)
        np.testing.assert_array_equal(scaled[:, :3, :3], T[:, :3, :3])


def test_a_knock_moves_the_robots_markers_from_the_placement_asked_for_on():
    """By 13 mm and 0.6° from the third of four placements on, and nothing before it."""
    arguments = ("--placements", "4", "--targets", "board", "--knock-m", "0.013")
    knocked = draw(*arguments, "--knock-deg", "0.6", "--knock-after", "0.5")
    t = knocked.placement_times_ns.mean(1).astype(np.int64)
    T = measure_body_poses(knocked, np.random.default_rng(0), "robot", t)
    moved = invert_pose(knocked.true_body_poses("robot", t)) @ T
    np.testing.assert_allclose(moved[:2], [np.eye(4)] * 2, atol=1e-9)
    xi = se3_log(moved[2:])
    np.testing.assert_allclose(np.linalg.norm(moved[2:, :3, 3], axis=1), 0.013, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(xi[:, 3:], axis=1), np.radians(0.6), rtol=1e-6)


def test_late_mcs_stamps_and_a_displaced_target_have_the_size_asked_for():
    session = draw("--mount-m", "0.006", "--mount-deg", "1", "--mcs-late-s", "0.025")
    for T in session.T_body_target.values():
        assert np.linalg.norm(T[:3, 3]) == pytest.approx(0.006)
        assert np.rad2deg(rotation_angle(T)) == pytest.approx(1)
    first = next(generate_tf_messages(session))[3].transforms[0]
    assert stamp(first) == session.placement_times_ns[0, 0] - MCS_MARGIN_NS + 25_000_000


def clip(polygon, normal, offset):
    """Part of a convex polygon, a list of (x, y), with normal · p ≤ offset."""
    out = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        at_a, at_b = (normal[0] * p[0] + normal[1] * p[1] - offset for p in (a, b))
        if at_a <= 0:
            out.append(a)
        if at_a * at_b < 0:
            s = at_a / (at_a - at_b)
            out.append((a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])))
    return out


def area(polygon):
    pairs = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs) / 2


def two_edges(corner, directions, u, v):
    """Exact part of the pixel (u, v) in two opposite quadrants of two lines through corner."""
    square = [(u - 0.5, v - 0.5), (u + 0.5, v - 0.5), (u + 0.5, v + 0.5), (u - 0.5, v + 0.5)]
    n, m = (np.array([-np.sin(a), np.cos(a)]) for a in directions)
    low = clip(clip(square, n, n @ corner), m, m @ corner)
    high = clip(clip(square, -n, -n @ corner), -m, -m @ corner)
    return area(low) + area(high)


def corner_error(image, corner, directions, half):
    """Shift (2,), px, of the corner that fits the image best, to first order, and angles left free.

    image holds 0 and 1 on the two colours; directions are the angles of the two grid lines.
    """
    at = np.array([*corner, *directions])
    model = lambda p, u, v: two_edges(p[:2], p[2:], u, v)  # noqa: E731
    rows, seen = [], []
    cu, cv = np.rint(corner).astype(int)
    for v in range(cv - half, cv + half + 1):
        for u in range(cu - half, cu + half + 1):
            part = model(at, u, v)
            if 0 < part < 1:
                rows.append([(model(at + step, u, v) - part) / 1e-4 for step in 1e-4 * np.eye(4)])
                seen.append((image[v, u], part))
    seen = np.array(seen)
    if np.corrcoef(seen.T)[0, 1] < 0:
        seen[:, 0] = 1 - seen[:, 0]
    return np.linalg.lstsq(np.array(rows), seen[:, 0] - seen[:, 1], rcond=None)[0][:2]


def corner_errors(image, camera, T_camera_board):
    """Errors (30, 2), px, of all inner corners of the board in a rendered image."""
    spec = SIMULATED_TARGETS["board"]["pattern"]
    project = lambda x, y: camera.project(transform_points(T_camera_board, [x, y, 0.0]))[0][0]  # noqa: E731
    errors = []
    for i in range(spec["inner_corners"][0]):
        for j in range(spec["inner_corners"][1]):
            x, y = np.array(spec["first_corner_m"]) + spec["square_m"] * np.array([i, j])
            along = project(x + 0.02, y) - project(x - 0.02, y)
            up = project(x, y + 0.02) - project(x, y - 0.02)
            half = int(min(8, 0.8 * min(np.linalg.norm(along), np.linalg.norm(up))))
            directions = [np.arctan2(*e[::-1]) for e in (along, up)]
            errors.append(corner_error(image, project(x, y), directions, half))
    return np.array(errors)


@pytest.fixture(scope="module")
def board_views():
    """Camera, and unrounded images of two placements of the board with T_camera_board (4, 4)."""
    session = draw("--placements", "2", "--targets", "board")
    view = compute_ray_grid(session.rig.camera_models["camera"])
    images = []
    for k in range(2):
        T_world_camera = session.placement_poses["robot"][k] @ session.rig.T_robot_sensor["camera"]
        surfaces = place_surfaces({"board": session.placement_poses["board"][k]})
        image = render_image(view, PosedScene(session.scene, surfaces, T_world_camera))[..., 0]
        images.append((image, invert_pose(T_world_camera) @ session.placement_poses["board"][k]))
    return session.rig.camera_models["camera"], images


def test_corners_of_a_rendered_board_are_true_to_a_thousandth_of_a_pixel(board_views):
    """Against squares clipped exactly by the two grid lines: 0.0005 px per axis RMS measured."""
    camera, images = board_views
    errors = np.concatenate([corner_errors((i - 40) / 160, camera, T) for i, T in images])
    assert np.sqrt(np.mean(errors**2, axis=0)).max() < PIXEL_RMS
    assert np.abs(errors.mean(0)).max() < 0.0003


def test_rounding_to_8_bits_adds_less_than_a_thousandth_of_a_pixel(board_views):
    camera, images = board_views
    shifts = []
    for image, T in images:
        exact, rounded = ((i - 40) / 160 for i in (image, np.rint(image)))
        shifts.append(corner_errors(rounded, camera, T) - corner_errors(exact, camera, T))
    rms = np.sqrt(np.mean(np.concatenate(shifts) ** 2, axis=0))
    assert rms.min() > 0.0002 and rms.max() < PIXEL_RMS


@given(st.floats(0, 0.0025))
@settings(max_examples=10, deadline=None)
def test_an_edge_along_the_rows_of_pixels_is_true_to_a_thousandth_of_a_pixel(small_view, shift):
    """A board square to the camera: the worst case of samples on a grid. One pixel is 2.5 mm."""
    camera, scene, view = small_view
    T_camera_board = make_pose(np.diag([1.0, -1.0, -1.0]), [shift, 0, 2.0])
    T_world_camera = pose_from_rpy([-1, 0, 2.0], np.deg2rad([-90, 0, -90]))
    surfaces = place_surfaces({"board": T_world_camera @ T_camera_board})
    image = render_image(view, PosedScene(scene, surfaces, T_world_camera))[..., 0]
    edge = camera.project(transform_points(T_camera_board, [0.04, 0.0, 0.0]))[0][0, 0]
    columns = slice(108, 124)  # from the middle of one square to that of the next
    left, right = image[105, columns][[0, -1]]
    found = (image[102:110, columns] - right) / (left - right)
    expected = np.clip(edge - np.arange(108, 124) + 0.5, 0, 1)
    assert {left, right} == {40.0, 200.0}
    assert np.abs(found - expected).max() <= 0.001


@pytest.fixture(scope="module")
def small_view():
    camera = CameraModel("radtan", (800, 800, 99.5, 99.5, 0, 0, 0, 0), (200, 200))
    return camera, build_scene(["board"]), compute_ray_grid(camera)


def test_interpolated_rays_of_a_distorted_camera_are_true_to_a_millionth_of_a_pixel():
    """Every sampled ray projects to its point in the pixel, the same one for all pixels."""
    camera = CameraModel(
        "radtan", (802.3, 801.1, 452.6, 347.9, -0.28, 0.09, 6e-4, -4e-4), (900, 700)
    )
    view = compute_ray_grid(camera)
    rng = np.random.default_rng(0)
    v, u = rng.integers(0, 690, 200), rng.integers(0, 890, 200)
    nodes = np.array([view.rays[v + i, u + j] for i in range(3) for j in range(3)])
    for weights in _interpolation_weights(COARSE_POINTS_PER_PIXEL)[0]:
        uv, _ = camera.project(np.einsum("p,pnc->nc", weights, nodes))
        within = uv - np.stack([u, v], -1)
        assert np.abs(within - within[0]).max() < 1e-6
        assert np.abs(within).max() <= 0.5


def test_the_camera_that_is_drawn_depends_on_the_distortion_alone():
    one, two = (draw("--placements", "1", *k).rig for k in ((), DISTORTED))
    assert one.camera_models["camera"].params[:4] == two.camera_models["camera"].params[:4]
    assert two.camera_models["camera"].params[4] == -0.1
    assert np.array_equal(one.T_robot_sensor["camera"], two.T_robot_sensor["camera"])
