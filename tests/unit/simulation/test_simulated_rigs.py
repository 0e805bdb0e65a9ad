"""Every sensor, disturbance and rig of the simulator is what it is said to be."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    pose_from_xyz_quat,
    transform_points,
)
from calib.io.logs.ros_messages import COMPRESSED_IMAGE_TYPE
from calib.sensors.camera.camera_info_writer import make_camera_info_message
from calib.sensors.camera.camera_model import CAMERA_MODELS, CameraModel
from calib.sensors.camera.images.image_messages import read_bgr
from calib.sensors.lidar.clouds import cloud_messages
from calib.sensors.lidar.clouds.cloud_layout import infer_cloud_layout
from calib.sensors.lidar.clouds.cloud_messages import read_raw_cloud
from calib.sensors.lidar.clouds.point_time_inference import CloudSample
from simulate import draw_sessions, parse_simulation_arguments
from simulation import simulated_rigs
from simulation.config_and_truth import make_target_config, write_simulated_config
from simulation.ros_log import make_cloud_message, make_image_message
from simulation.sensors.camera_exposure import (
    N_EXPOSURE_INSTANTS,
    Shutter,
    blur_image,
    digitize_image,
)
from simulation.sensors.cloud_formats import make_point_array
from simulation.sensors.image_renderer import compute_ray_grid, render_image
from simulation.sensors.lidar_scanner import scan_scene
from simulation.sensors.mocap_errors import MCS_PERIOD_NS, draw_dropouts
from simulation.sensors.scan_patterns import SCAN_PATTERNS
from simulation.session_recording import (
    LIDAR_SEED,
    generate_tf_messages,
    image_stamps,
    mcs_time_span,
)
from simulation.simulated_rigs import SIMULATED_RIGS
from simulation.world import room_scene
from simulation.world.ray_casting import PosedScene
from simulation.world.room_scene import (
    SIMULATED_TARGETS,
    build_scene,
    find_surface_index,
    place_surfaces,
    visibility_points,
)
from simulation.world.smooth_motion import find_motion_progress, schedule_placements

STAMP = 1_700_000_000_123_456_789
DEMO = parse_simulation_arguments(["nowhere", "--rig", "demo"])


def draw(*arguments):
    """The only session of the arguments, without a file."""
    return draw_sessions(parse_simulation_arguments(["nowhere", *arguments]))[0][0]


def decoded(driver, echoes):
    """xyz (n, 3), ring (n,) and dt (n,), ns, of a cloud of that driver, ring by ring."""
    message = make_cloud_message(STAMP, "lidar", driver, echoes)
    layout = infer_cloud_layout([CloudSample(read_raw_cloud(message), STAMP)], 0, {})[0]
    xyz, ring, dt, _ = cloud_messages.read_points(message, layout)
    order = np.lexsort([xyz[:, 2], xyz[:, 1], xyz[:, 0]])
    return xyz[order], ring[order], dt[order]


@pytest.fixture(scope="module")
def still():
    """Scene, T_world_surface and T_world_lidar of a placement, and its session."""
    session = draw("--placements", "1")
    surfaces = place_surfaces({k: session.placement_poses[k][0] for k in session.T_body_target})
    T_world_lidar = session.placement_poses["robot"][0] @ session.rig.T_robot_sensor["velodyne"]
    return SimpleNamespace(
        session=session, posed=PosedScene(session.scene, surfaces, T_world_lidar)
    )


@pytest.fixture(scope="module")
def echoes(still):
    """What 16 beams meet within ±40° of azimuth; some see no wall."""
    firing = SCAN_PATTERNS["beams16"].make_firing(np.deg2rad(40), 0)
    return scan_scene(still.posed, firing, STAMP)


def test_an_ouster_cloud_holds_the_points_of_a_velodyne_one_and_zeros_elsewhere(echoes):
    """Times agree to 10 ns: a velodyne's are float32."""
    one, two = decoded("velodyne", echoes), decoded("ouster", echoes)
    assert np.array_equal(one[0], two[0]) and np.array_equal(one[1], two[1])
    assert np.abs(one[2] - two[2]).max() < 10
    message = make_cloud_message(STAMP, "lidar", "ouster", echoes)
    assert (message.height, message.width, message.point_step) == (16, 401, 48)
    assert 0 < len(two[0]) < 16 * 401
    assert (message.data.reshape(-1, 48)[:, [12, 13, 14, 15, 30, 31, *range(36, 48)]] == 0).all()


def test_a_plain_cloud_has_neither_ring_nor_time(echoes):
    xyz, _, dt = decoded("plain", echoes)
    assert np.array_equal(xyz, decoded("velodyne", echoes)[0])
    assert (dt == 0).all()
    names = [f.name for f in make_cloud_message(STAMP, "lidar", "plain", echoes).fields]
    assert names == ["x", "y", "z", "intensity"]


def test_the_rings_of_an_ouster_count_from_above():
    beams = SCAN_PATTERNS["beams32"].make_firing(np.deg2rad(30), 0).beam_directions
    elevation = np.rad2deg(np.arcsin(beams[0, :, 2]))
    assert elevation == pytest.approx(np.linspace(16.6, -16.6, 32))
    assert SCAN_PATTERNS["beams32"].make_firing(np.pi, 0).beam_directions.shape == (1025, 32, 3)


def test_a_rosette_covers_its_field_within_a_second_and_never_repeats():
    """Cells of 2° by 2°: 98 % of those inside its ellipse of ±40° by ±15°."""
    rosette, hit = SCAN_PATTERNS["rosette"], np.zeros((40, 16), bool)
    firings = [rosette.make_firing(np.deg2rad(40), i) for i in range(10)]
    for firing in firings:
        azimuth = np.rad2deg(
            np.arctan2(firing.beam_directions[..., 1], firing.beam_directions[..., 0])
        )
        elevation = np.rad2deg(np.arcsin(firing.beam_directions[..., 2]))
        assert np.abs(azimuth).max() <= 40.001 and np.abs(elevation).max() <= 15.001
        hit[(azimuth / 2 + 20).astype(int).clip(0, 39), (elevation / 2 + 8).astype(int)] = True
    centre = np.meshgrid(np.arange(-39, 40, 2) / 40, np.arange(-15, 16, 2) / 15, indexing="ij")
    assert hit[np.hypot(*centre) < 0.9].mean() > 0.98
    assert np.abs(firings[0].beam_directions - firings[1].beam_directions).max(-1).min() > 1e-4


def test_a_livox_cloud_has_lines_and_absolute_times(still):
    firing = SCAN_PATTERNS["rosette"].make_firing(np.deg2rad(40), 3)
    met = scan_scene(still.posed, firing, STAMP)
    message = make_cloud_message(STAMP, "lidar", "livox", met)
    points = read_raw_cloud(message).fields
    assert message.point_step == 26 and set(points["line"]) == set(range(6))
    after = points["timestamp"] - STAMP
    assert np.all(np.diff(after) >= 0) and after.min() >= -256 and after.max() < 1e8


def test_every_beam_keeps_its_bias(still, echoes):
    firing = SCAN_PATTERNS["beams16"].make_firing(np.deg2rad(40), 0)
    bias = 0.01 * np.arange(16)
    biased = scan_scene(still.posed, firing, range_bias_m=bias)
    assert np.array_equal(biased.has_return, echoes.has_return)
    added = (biased.distance_m - echoes.distance_m)[echoes.has_return]
    assert added == pytest.approx(np.tile(bias, (401, 1))[echoes.has_return], abs=1e-12)
    drawn = draw("--placements", "1", "--beam-bias-m", "0.02").rig.beam_bias_m["velodyne"]
    assert drawn.shape == (16,) and 0.01 < np.std(drawn) < 0.04


def test_wide_beams_mix_returns_at_edges_only_and_make_the_board_wider(still, echoes):
    """A cone of 0.4°: what a beam meets farther than that from an outline is as with lines."""
    spread, firing = np.deg2rad(0.4), SCAN_PATTERNS["beams16"].make_firing(np.deg2rad(40), 0)
    wide = scan_scene(still.posed, firing, beam_divergence_rad=spread)
    scene, surfaces = still.posed.scene, still.posed.T_world_surfaces
    T_world_lidar = still.posed.T_world_sensor
    board = scene.surfaces[find_surface_index(scene, "board")]
    T = invert_pose(surfaces["board"]) @ T_world_lidar
    thin, wider = (transform_points(T, e.xyz) for e in (echoes, wide))
    inside = np.min(board.shape_params[1] - thin[..., :2] @ board.shape_params[0].T, axis=-1)
    reach = spread / 2 * echoes.distance_m * 1.5  # the board is turned by up to 35°
    on_board = echoes.has_return & (np.abs(thin[..., 2]) < 1e-9)
    deep = on_board & (inside / np.linalg.norm(board.shape_params[0], axis=1).max() > reach)
    assert deep.sum() > 500
    assert np.array_equal(echoes.distance_m[deep], wide.distance_m[deep])
    mixed = wide.has_return & (np.abs(wider[..., 2]) < 0.02)
    beyond = np.min(board.shape_params[1] - wider[..., :2] @ board.shape_params[0].T, axis=-1) < 0
    assert np.sum(mixed & beyond & ~on_board) > 20
    assert np.sum(echoes.distance_m != wide.distance_m) < 0.2 * echoes.distance_m.size


def test_blur_leaves_the_place_of_an_edge_within_a_hundredth_of_a_pixel():
    """An edge 20.3 px from the left border, exactly integrated, blurred by 0.7 px."""
    row = 40 + 160 * np.clip(20.3 - np.arange(40), 0, 1)
    image = np.tile(row[None, :, None], (40, 1, 3))
    soft = blur_image(image, 0.7)
    place = (soft[20, :, 0] - 40).sum() / 160
    assert place == pytest.approx(20.3, abs=0.01)
    assert np.ptp(np.diff(soft[20, :, 0])) < 0.8 * np.ptp(np.diff(row))


def test_an_image_is_exact_at_rest_and_the_mean_over_its_exposure_in_motion():
    times = schedule_placements([0, 1], 1.0, 1.0)
    seen = []

    def image_at(t, points):
        seen.append(t)
        return np.full((2, 2, 3), (t - times[0, 1]) / 1e6)

    shutter = Shutter(image_at, times, 0.02, 0.0)
    for t in times[0, 0] + np.array([300_000_000, 600_000_000]):
        shutter.capture_image(t)
    assert len(seen) == 1
    moving = shutter.capture_image(times[0, 1] + 500_000_000)
    assert len(seen) == 1 + N_EXPOSURE_INSTANTS and moving == pytest.approx(500)
    assert np.ptp(seen[1:]) == pytest.approx(20_000_000 * 7 / 8)


@pytest.mark.parametrize("name", sorted(CAMERA_MODELS))
def test_a_camera_of_every_model_shows_corners_where_its_projection_says(name):
    """The parameters of --camera-model at a third of their size; OpenCV's corners, 0.2 px."""
    params = simulated_rigs.LENS_PARAMS[name]
    params = (*(p / 3 for p in params[:4]), *params[4:])
    camera = CameraModel(name, params, (300, 234))
    T_world_camera = pose_from_rpy([-1, 0, 2.0], np.deg2rad([-90, 0, -90]))
    T_camera_board = make_pose(np.diag([1.0, -1, -1]), [0.05, 0.02, 1.1]) @ pose_from_rpy(
        [0] * 3, [0.2, 0.3, 0.1]
    )
    surfaces = place_surfaces({"board": T_world_camera @ T_camera_board})
    image = render_image(
        compute_ray_grid(camera),
        PosedScene(build_scene(["board"]), surfaces, T_world_camera),
        64,
        8,
    )
    p = visibility_points("board")[0].reshape(7, 8, 3)[1:-1, 1:-1].reshape(-1, 3)
    uv, ok = camera.project(transform_points(T_camera_board, p))
    grey = digitize_image(image, "mono8", 0, None)
    found = uv.astype(np.float32)[:, None].copy()
    cv2.cornerSubPix(grey, found, (4, 4), (-1, -1), (3, 50, 1e-4))
    assert ok.all() and len(uv) == 30
    assert np.abs(found[:, 0] - uv).max() < 0.2


@pytest.mark.parametrize(
    ("model", "called", "count"),
    [("radtan", "plumb_bob", 5), ("kannala_brandt", "equidistant", 4)],
)
def test_camera_info_holds_the_parameters_of_the_camera(model, called, count):
    camera = CameraModel(model, simulated_rigs.LENS_PARAMS[model], (900, 700))
    info = make_camera_info_message(STAMP, "left", camera)
    assert (info.width, info.height, info.distortion_model) == (900, 700, called)
    assert info.d.tolist() == list(camera.params[4:]) and len(info.d) == count
    assert info.k.reshape(3, 3)[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == list(camera.params[:4])
    assert (info.header.frame_id, info.header.stamp.nanosec) == ("left", 123_456_789)


def test_arguments_for_all_lidars_and_cameras_reach_the_rig():
    session = draw("--lidar", "ouster", "--sector-deg", "30", "--camera-hz", "2")
    spec = session.rig.lidar_spec("velodyne")
    assert (spec.cloud_format, spec.pattern_name, spec.sector_deg) == ("ouster", "beams32", 30)
    assert session.rig.camera_spec("camera").rate_hz == 2


def test_a_bump_moves_the_last_sensor_alone_and_not_the_placements():
    still = draw("--placements", "2")
    bumped = draw("--placements", "2", "--bump-m", "0.01", "--bump-deg", "1")
    before, after = still.rig.T_robot_sensor, bumped.rig.T_robot_sensor
    assert np.array_equal(before["velodyne"], after["velodyne"])
    moved = invert_pose(before["camera"]) @ after["camera"]
    assert np.linalg.norm(moved[:3, 3]) == pytest.approx(0.01)
    for name, poses in still.placement_poses.items():
        assert np.array_equal(poses, bumped.placement_poses[name])


def test_gaps_in_the_layout_of_a_point_are_zero(still):
    firing = SCAN_PATTERNS["beams16"].make_firing(np.deg2rad(100), 0)
    points = make_point_array("nebula_legacy", scan_scene(still.posed, firing, STAMP))
    assert not points.view("u1").reshape(-1, 48)[:, 33:40].any()


def test_a_model_that_ros_has_no_name_for_comes_without_camera_info():
    camera = CameraModel("double_sphere", simulated_rigs.LENS_PARAMS["double_sphere"], (900, 700))
    assert make_camera_info_message(STAMP, "left", camera) is None


def test_a_compressed_image_is_the_image_exactly_as_png_and_nearly_as_jpeg():
    pixels = cv2.GaussianBlur(
        np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8), (0, 0), 6
    )
    spec = SIMULATED_RIGS["demo"].sensors["right_camera"]
    topic, kind, message = make_image_message(STAMP, "right", spec, pixels)
    assert (topic, kind) == ("/right/image_raw/compressed", COMPRESSED_IMAGE_TYPE)
    assert np.array_equal(read_bgr(message), pixels)
    message = make_image_message(STAMP, "right", spec._replace(encoding="jpeg"), pixels)[2]
    assert np.abs(read_bgr(message).astype(int) - pixels).max() < 8


def test_a_cylinder_is_shaded_mildly_in_one_hue():
    """Brightness between 0.7 and 1 of its colour."""
    camera = CameraModel("radtan", (200, 200, 99.5, 74.5, 0, 0, 0, 0), (200, 150))
    T_world_camera = pose_from_rpy([-1.5, 0, 1.0], np.deg2rad([-90, 0, -90]))
    surfaces = place_surfaces({"cylinder": pose_from_rpy([0, 0, 1.0], np.deg2rad([0, 0, 80]))})
    image = render_image(
        compute_ray_grid(camera),
        PosedScene(build_scene(["cylinder"]), surfaces, T_world_camera),
        64,
        8,
    )
    side = image[68:81, 60:140] / room_scene.GREEN
    assert np.ptp(side, axis=-1).max() < 1e-12
    assert side.min() > 0.7 and side.max() <= 1 and np.ptp(side) > 0.1


def test_motion_capture_loses_the_share_of_samples_asked_for_in_bursts():
    """10 % of 200 000 samples, 8 in a row on average."""
    lost = draw_dropouts(np.random.default_rng(0), 200_000, 0.1)
    begins = np.sum(lost[1:] & ~lost[:-1])
    assert lost.mean() == pytest.approx(0.1, abs=0.005)
    assert lost.sum() / begins == pytest.approx(8, rel=0.05)


def test_lost_samples_are_missing_from_tf_body_by_body():
    session = draw("--placements", "3", "--mcs-dropout", "0.2")
    sizes = [len(m[3].transforms) for m in generate_tf_messages(session)]
    assert set(sizes) >= {1, 2, 3} and sum(sizes) < 0.95 * 3 * len(sizes)


def test_two_bodies_bear_each_others_names_during_a_swap():
    session = draw("--placements", "2", "--label-swaps", "2", "--mcs-late-s", "0.01")
    names, wrong = session.names_by_body(), set()
    for _, _, _, message in generate_tf_messages(session):
        for item in message.transforms:
            t = item.header.stamp.sec * 10**9 + item.header.stamp.nanosec - 10_000_000
            p, q = item.transform.translation, item.transform.rotation
            T = pose_from_xyz_quat([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
            true = session.true_body_poses(names[item.child_frame_id], np.array([t]))[0]
            if np.abs(T - true).max() > 0.1:
                wrong.add((t, item.child_frame_id))
    for start, end, pair in session.label_swaps:
        assert 100_000_000 <= end - start <= 300_000_000
        t = np.arange(mcs_time_span(session.placement_times_ns)[0], end, MCS_PERIOD_NS)
        assert {(x, body) for x in t[t >= start].tolist() for body in pair} <= wrong
    assert len(wrong) <= 2 * sum(
        (end - start) // MCS_PERIOD_NS + 1 for start, end, _ in session.label_swaps
    )


def test_targets_are_built_to_scale_and_written_without_it():
    session = draw("--placements", "1", "--target-scale", "1.01")
    plain = draw("--placements", "1")
    sizes = [
        [s.bounding_radius_m for s in x.scene.surfaces if s.name in SIMULATED_TARGETS]
        for x in (session, plain)
    ]
    assert np.divide(*sizes) == pytest.approx([1.01, 1.01])
    assert make_target_config("cylinder", session.arguments)["radius_m"] == 0.1
    assert np.array_equal(session.placement_poses["board"], plain.placement_poses["board"])


@pytest.mark.parametrize(
    "noise",
    [
        ("--beam-bias-m", "0.01"),
        ("--mcs-dropout", "0.1"),
        ("--label-swaps", "3"),
        ("--target-scale", "1.02"),
        ("--guess-error-m", "0"),
        ("--lidar", "ouster"),
    ],
)
def test_a_disturbance_leaves_mounts_as_they_are(noise, still):
    session = draw("--placements", "1", *noise)
    for name, T in still.session.rig.T_robot_sensor.items():
        assert np.array_equal(T, session.rig.T_robot_sensor[name])


@pytest.fixture(scope="module")
def demo():
    """Sessions of the demo, without a file."""
    return draw_sessions(DEMO)[0]


def seen_at_all(session, k, sensor, name):
    """Whether any part of a target is in a sensor's field of view at placement k."""
    T = (
        invert_pose(session.placement_poses["robot"][k] @ session.rig.T_robot_sensor[sensor])
        @ session.placement_poses[name][k]
    )
    surface = session.scene.surfaces[find_surface_index(session.scene, name)]
    p = transform_points(T, np.concatenate([visibility_points(name)[0], surface.corners_m]))
    return in_field(session.rig, sensor, p).any()


def in_field(rig, sensor, p):
    """Which of the points p (n, 3), sensor frame, are in the sensor's field of view."""
    if sensor in rig.camera_models:
        uv, ok = rig.camera_models[sensor].project(p)
        return ok & rig.camera_models[sensor].is_in_image(uv)
    spec = rig.sensor_specs[sensor]
    azimuth = np.rad2deg(np.arctan2(p[:, 1], p[:, 0]))
    elevation = np.rad2deg(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1])))
    high = np.abs(elevation) <= max(spec.scan_pattern.elevation_deg)
    return high & (np.abs(azimuth) <= spec.sector_deg)


def test_in_the_demo_every_target_is_in_view_of_one_sensor_which_is_served_ten_times(demo):
    served = {}
    for session in demo:
        for k in range(15):
            for name in ("board", "cylinder"):
                seeing = [s for s in session.rig.T_robot_sensor if seen_at_all(session, k, s, name)]
                assert len(seeing) == 1
                served[seeing[0], name] = served.get((seeing[0], name), 0) + 1
    lidars = {(s, t): 10 for s in ("front_lidar", "rear_lidar") for t in ("board", "cylinder")}
    assert served == lidars | {("left_camera", "board"): 10, ("right_camera", "cylinder"): 10}


def test_the_fields_of_view_of_the_demo_do_not_overlap(demo):
    """No point within 6 m of the robot is in two of them, whatever the distance."""
    rng, rig = np.random.default_rng(0), demo[0].rig
    p_robot = rng.normal(size=(200_000, 3))
    p_robot *= (rng.uniform(0.5, 6, 200_000) / np.linalg.norm(p_robot, axis=1))[:, None]
    seen = [
        in_field(rig, s, transform_points(invert_pose(T), p_robot))
        for s, T in rig.T_robot_sensor.items()
    ]
    assert np.sum(seen, axis=0).max() == 1 and np.sum(seen, axis=1).min() > 1000


def test_the_demo_has_200_images_of_which_two_of_a_camera_at_every_placement(demo):
    total = 0
    for session in demo:
        for name in session.rig.camera_models:
            t = np.array(image_stamps(session, session.rig.sensor_specs[name]))
            total += len(t)
            k, way = find_motion_progress(t, session.placement_times_ns)
            assert np.bincount(k[way == 0]).tolist() == [2] * 15
    assert total <= 200


def test_the_demo_carries_its_targets_around_the_robot_at_a_persons_pace(demo):
    """Never nearer than 1 m, nor faster than 4 m/s; the robot turns by less than 12° a move."""
    for session in demo:
        t = np.arange(*mcs_time_span(session.placement_times_ns), 20_000_000)
        for name in session.T_body_target:
            p = session.true_body_poses(name, t)[:, :3, 3]
            assert np.hypot(p[:, 0], p[:, 1]).min() > 1.0
            assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() / 0.02 < 4
        steps = (
            invert_pose(session.placement_poses["robot"][:-1])
            @ session.placement_poses["robot"][1:]
        )
        assert np.rad2deg(np.arccos((np.trace(steps[:, :3, :3].T) - 1) / 2)).max() < 12


def test_the_two_sessions_of_the_demo_have_one_rig_and_other_placements(demo):
    one, two = demo
    assert (one.name, two.name) == ("morning", "evening") and one.rig is two.rig
    assert np.abs(one.placement_poses["board"] - two.placement_poses["board"]).max() > 0.1
    a, b = (s.make_rng(LIDAR_SEED, 0, 0).standard_normal() for s in demo)
    assert a != b


def test_the_configuration_of_the_demo_names_both_sessions_and_every_sensor(demo, tmp_path):
    guesses = draw_sessions(DEMO)[1]
    write_simulated_config(tmp_path, "demo", demo, guesses)
    config = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert config["sessions"] == {
        name: {"rig": "demo", "log": f"logs/{name}.mcap"} for name in ("morning", "evening")
    }
    rig = yaml.safe_load((tmp_path / "rigs/demo.yaml").read_text())
    assert rig["sensors"]["rear_lidar"]["elevation_step_deg"] == pytest.approx(33.2 / 31)
    assert rig["sensors"]["rear_lidar"]["azimuth_deg"] == [-38, 38]
    assert rig["sensors"]["right_camera"]["topic"] == "/right/image_raw/compressed"
    assert list(rig["truth"]) == list(rig["sensors"])
    for name, sensor in rig["sensors"].items():
        written = np.array(sensor["T_robot_sensor"]["xyz_m"])
        assert np.abs(written - rig["truth"][name]["xyz_m"]).max() > 0.001


def test_the_help_describes_every_rig(capsys):
    with pytest.raises(SystemExit):
        parse_simulation_arguments(["--help"])
    text = capsys.readouterr().out
    assert all(f"--rig {name}" in text for name in SIMULATED_RIGS)
