"""First guesses found in the data: cameras by patterns and colours, lidars by what moved."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import decode
import gate
import guess
from calib.geometry.se3 import invert_pose, make_pose, se3_exp, se3_log, so3_exp, transform_points
from calib.initial_guess import camera_from_blobs
from calib.initial_guess.camera_from_blobs import blob_features, find_best_blob_pose, fit_blob_pose
from calib.initial_guess.camera_from_patterns import solve_pattern_poses, vote_pattern_pose
from calib.initial_guess.candidate_matches import CandidateMatches, make_match
from calib.initial_guess.hand_eye import solve_mount
from calib.initial_guess.initial_guess import InitialGuess
from calib.initial_guess.lidar_candidates import ShapeSignature, TargetCandidate
from calib.initial_guess.lidar_matching import match_pose
from calib.initial_guess.pose_voting import PoseTolerance, vote_for_pose
from calib.io.config import validate_and_complete
from calib.io.stage_cli import read_json
from calib.sensors.camera.camera_model import CameraModel
from calib.targets.target_shapes import target_from_config
from helpers.small_run import (
    edit_yaml,
    list_job_commands,
    simulated_rig_path,
)
from simulation import simulated_rigs
from simulation.simulated_rigs import simulated_camera_models
from simulation.world.room_scene import SIMULATED_TARGETS

HOME = "results/sim/sim"
TOLERANCE = PoseTolerance(0.15, np.radians(12))
OPTIONS = validate_and_complete("config", {"sessions": {"a": {"rig": "a", "log": "a"}}}, "config")[
    "guess"
]
T_TRUE = make_pose(so3_exp([0.4, -1.1, 0.7]), [0.3, -0.2, 0.6])


@pytest.fixture(scope="module")
def here(small_log, tmp_path_factory):
    """A small log whose rig states no pose, decoded and gated; works in its folder."""
    folder = shutil.copytree(small_log, tmp_path_factory.mktemp("guess"), dirs_exist_ok=True)
    edit_yaml(simulated_rig_path(folder), unstated)
    commands = list_job_commands(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for sensor in ("camera", "velodyne"):
            (Path(HOME) / sensor).mkdir(parents=True)
        decode.main(commands["decode", ""])
        gate.main(commands["gate", ""])
        yield commands


def unstated(config):
    for sensor in config["sensors"].values():
        del sensor["T_robot_sensor"]


def guessed(arguments, **changes):
    """guess.json of the stage with changed options."""
    options = json.loads(arguments[-1]) | changes
    guess.main([*arguments[:-1], json.dumps(options)])
    return read_json(f"{HOME}/{options['name']}/guess.json")


def error(found, sensor):
    truth = read_json("truth.json")["sensors"][sensor]["T_robot_sensor"]["matrix"]
    return se3_log(invert_pose(np.array(truth)) @ np.array(found))


@pytest.mark.parametrize(("sensor", "mm", "deg"), [("camera", 2, 0.05), ("velodyne", 50, 2)])
def test_a_sensor_without_a_guess_is_found(here, sensor, mm, deg):
    found = guessed(here["guess", sensor])
    assert found["source"] == "found in the data"
    assert "of" in found["basis"]
    xi = error(found["T_robot_sensor"]["matrix"], sensor)
    assert 1000 * np.linalg.norm(xi[:3]) < mm and np.degrees(np.linalg.norm(xi[3:])) < deg
    # What crop allows for.
    assert (np.abs(xi) < 2 * np.array(found["sigma"])).all()


def test_a_target_that_is_not_in_view_is_refused_in_words_with_counts(here):
    options = json.loads(here["guess", "camera"][-1])
    cylinder = {"cylinder": options["targets"]["cylinder"]}
    found = guessed(here["guess", "camera"], targets=cylinder)
    assert found["T_robot_sensor"] is None
    status = found["status"]
    assert status["reason"].startswith("no initial guess for camera: no pose found in the data")
    assert status["found"].startswith("coloured body found at 0 of 4 placements")
    assert status["expected"] == "4 or more that agree"
    assert "sensors.camera.T_robot_sensor" in status["remedy"]


def test_where_the_pose_is_stated_and_no_clock_wanted_nothing_of_the_log_is_read(here):
    options = json.loads(here["guess", "velodyne"][-1])
    stated = {"xyz_m": [0.1, 0, 0.5], "rpy_deg": [0, 0, 3]}
    arguments = ["--audit", f"{HOME}/log.json", "--mocap", "--placements", "--frames", "--output"]
    arguments += [f"{HOME}/velodyne/guess.json", "--options", ""]
    sensor = options["sensor"] | {"T_robot_sensor": stated}
    slim = {k: v for k, v in options.items() if k not in ("log", "targets")}
    guess.main([*arguments[:-1], json.dumps(slim | {"sensor": sensor})])
    assert read_json(f"{HOME}/velodyne/guess.json")["source"] == "config"


def board():
    """A board whose pattern can be read from either end."""
    config = json.loads(json.dumps(SIMULATED_TARGETS["board"]))
    config["pattern"]["inner_corners"] = [7, 5]
    del config["pattern"]["first_square"]
    return target_from_config(validate_and_complete("target", config, "board"))


def looks(n, seed=0):
    """Looks at a target at n places all round the front of T_TRUE's z axis, and the poses of the
    target in its frame."""
    rng, out = np.random.default_rng(seed), []
    for k in range(n):
        turn = so3_exp([np.pi, 0, 0]) @ so3_exp(rng.uniform(-0.5, 0.5, 3))
        T = make_pose(turn, [*rng.uniform(-0.45, 0.45, 2), rng.uniform(1.8, 2.8)])
        out.append((SimpleNamespace(target="it", placement=k, T_robot_target=T_TRUE @ T), T))
    return out


@pytest.mark.parametrize("model", simulated_camera_models())
def test_the_corners_of_one_image_give_the_pose_for_every_camera_model(model):
    lens = CameraModel(model, simulated_rigs.LENS_PARAMS[model], (900, 700))
    shape = board()
    corners = shape.pattern.corners()
    for _, T in looks(4):
        uv, ok = lens.project(transform_points(T, corners))
        assert ok.all()
        # The detector may begin at the other end.
        found = solve_pattern_poses(lens, shape, uv[::-1])
        errors = [np.abs(se3_log(invert_pose(T) @ F)).max() for F in found]
        assert min(errors) < 1e-6
        assert all(shape.check_facing(invert_pose(F)[:3, 3])[0] for F in found)


def test_of_two_readings_per_image_those_that_agree_win_and_wrong_images_are_left_out():
    half_turn = make_pose(so3_exp([0, 0, np.pi]), [0.1, 0.05, 0])
    readings = []
    for look, T in looks(6):
        wrong = look.T_robot_target @ half_turn @ invert_pose(T)
        readings += [(look.placement, wrong), (look.placement, T_TRUE)]
    readings.append((6, T_TRUE @ make_pose(t=[0.5, 0, 0])))
    found = vote_pattern_pose(readings, 7, 8, OPTIONS)
    assert found.status.ok
    np.testing.assert_allclose(found.value, T_TRUE, atol=1e-9)
    assert found.basis.startswith("the pattern in 6 of 7 images that show one, 8 placements")


@pytest.mark.parametrize("model", ["radtan", "kannala_brandt"])
def test_coloured_bodies_give_the_pose_although_one_blob_is_another_thing(model):
    lens = CameraModel(model, simulated_rigs.LENS_PARAMS[model], (900, 700))
    shapes = {
        "it": target_from_config(
            validate_and_complete("target", SIMULATED_TARGETS["cylinder"], "cylinder")
        )
    }
    seen = []
    for look, T in looks(6):
        uv, _ = lens.project(transform_points(T, shapes["it"].outline_points()))
        hull = camera_from_blobs.cv2.convexHull(uv.astype(np.float32), returnPoints=False)[:, 0]
        seen.append((look, blob_features(uv[hull])))
    seen[3] = seen[3][0], seen[3][1] + [150, 40, 0, 0, 0]
    T, rows = find_best_blob_pose(lens, shapes, seen)
    assert rows.tolist() == [0, 1, 2, 4, 5]
    off = se3_log(invert_pose(T_TRUE) @ fit_blob_pose(lens, shapes, seen[:3], T).T_robot_camera)
    assert np.abs(off).max() < 1e-6


def scattered(n, clutter, noise, seed, spread=1.0):
    """Pairs of n placements with their true candidate and `clutter` others each."""
    rng = np.random.default_rng(seed)
    form = ShapeSignature(np.zeros(3), np.array([0, 0, 1.0]), 0, True, True)
    rows = []
    for k in range(n):
        turn = so3_exp(spread * rng.uniform(-0.6, 0.6, 3))
        T = make_pose(turn, [2, 0, 0] + spread * rng.uniform(-1, 1, 3))
        inside = invert_pose(T_TRUE) @ T
        centre = inside[:3, 3] + noise * rng.standard_normal(3)
        rows.append(make_match(TargetCandidate(centre, inside[:3, 2]), form, T, k))
        for _ in range(clutter):
            direction = so3_exp(rng.uniform(-2, 2, 3))[:, 2]
            rows.append(make_match(TargetCandidate(rng.uniform(-4, 4, 3), direction), form, T, k))
    return CandidateMatches.from_rows(rows)


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_is_found_among_candidates_of_which_most_are_something_else(seed):
    found = match_pose(scattered(10, 6, 0.02, seed), 10, "a thing", OPTIONS)
    assert found.status.ok, found.status
    off = se3_log(invert_pose(T_TRUE) @ found.value)
    assert np.linalg.norm(off[:3]) < 0.06 and np.degrees(np.linalg.norm(off[3:])) < 2
    assert (np.abs(off) < 2 * found.sigma).all()


def test_without_noise_the_pose_is_exact_and_what_is_furniture_is_no_part_of_it():
    found = match_pose(scattered(8, 4, 0.0, 3), 8, "a thing", OPTIONS)
    np.testing.assert_allclose(found.value, T_TRUE, atol=1e-6)
    assert found.basis == "a thing at 8 of 8 placements, 8 of them with a candidate"


def test_placements_that_are_all_alike_are_refused_with_what_to_record():
    found = match_pose(scattered(6, 0, 0.01, 1, spread=0.01), 6, "a thing", OPTIONS)
    assert not found.status.ok and found.value is None
    assert "Record" in found.status.remedy or "Hold" in found.status.remedy


def test_two_poses_with_as_many_placements_are_refused():
    here, there = T_TRUE, T_TRUE @ make_pose(t=[1.0, 0, 0])
    readings = [(k, here if k < 4 else there) for k in range(8)]
    status = vote_pattern_pose(readings, 8, 8, OPTIONS).status
    assert status.reason == "the data fit more than one pose"
    assert "4 agree on a pose, 4 on another" in status.found


def test_the_number_of_agreeing_placements_counts_each_once():
    T = np.array([T_TRUE] * 5)
    rows, rival = vote_for_pose(T, np.array([0, 0, 1, 1, 2]), TOLERANCE)
    assert len(rows) == 3 and rival == 0


def rotations(rng, about, n):
    """Rotations (n, 3, 3) by up to 40 deg about the axes `about` (k, 3) one after the other."""
    w = rng.uniform(-0.7, 0.7, (n, len(about)))
    return np.array([so3_exp(np.array(about).T @ one) for one in w])


def by_camera(axes, noise=0.0, n=8):
    """What a camera sees of a target of unknown mount, each time with its half turn as another
    reading; the mount, and T_robot_body of the placements."""
    rng = np.random.default_rng(2)
    mount = make_pose(so3_exp([0.2, -0.4, 0.9]), [0.05, -0.12, 0.03])
    half = make_pose(so3_exp([0, 0, np.pi]))
    seen = []
    for R in rotations(rng, axes, n):
        body = make_pose(R, [2, 0, 0.5] + rng.uniform(-0.5, 0.5, 3))
        T = invert_pose(T_TRUE) @ body @ mount @ se3_exp(noise * rng.normal(size=6))
        seen.append((body, [T @ half, T] if len(seen) % 2 else [T, T @ half]))
    return seen, mount


def mount_error(found, mount):
    """Twist from the true mount, or from it half turned, which is the same pattern."""
    half = make_pose(so3_exp([0, 0, np.pi]))
    found = found.value
    errors = [se3_log(invert_pose(mount @ H) @ found) for H in (np.eye(4), half)]
    return min(errors, key=lambda e: np.abs(e).max())


def test_a_mount_is_found_with_the_camera_s_pose_unknown():
    seen, mount = by_camera([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    found = solve_mount(seen, None, TOLERANCE)
    assert found.status.ok
    assert np.abs(mount_error(found, mount)).max() < 1e-7


def test_a_mount_from_noisy_poses_is_as_near_as_its_sigma_says():
    seen, mount = by_camera([[1, 0, 0], [0, 1, 0]], noise=0.003, n=12)
    found = solve_mount(seen, None, TOLERANCE)
    assert (np.abs(mount_error(found, mount)) < 4 * found.sigma).all()
    assert found.sigma[:3].max() < 0.02


def test_rotations_about_one_axis_leave_a_mount_open_in_words():
    seen, _ = by_camera([[0, 0, 1]])
    status = solve_mount(seen, None, TOLERANCE).status
    assert not status.ok
    assert status.remedy.startswith(("Turn the target about two axes", "Record placements tilted"))


def test_what_is_known_of_the_camera_finds_a_mount_by_one_axis():
    seen, mount = by_camera([[0, 0, 1]])
    start = T_TRUE @ se3_exp([0.02, 0, 0.01, 0.02, 0, 0.01])
    sigma = np.repeat([0.05, np.radians(5)], 3)
    found = solve_mount(seen, InitialGuess(start, sigma), TOLERANCE)
    assert found.status.ok
    error = mount_error(found, mount)
    assert (np.abs(error) < 2 * found.sigma).all() and np.linalg.norm(error[:3]) < 0.1
