"""The benchmark measures what it says: errors, costs, the reference, and what falls short."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import benchmark
from calib import estimation, geometry, reference, targets
from calib.benchmark import chart, cost, measure, page, plan, rows
from calib.rig import Lidar

ROOT = Path(__file__).parents[1]
T = geometry.from_rpy([0.2, -0.1, 0.6], [0.1, -0.2, 0.3])


def row(key):
    return next(r for r in rows.ROWS if r.key == key)


def sensor(T_found, covariance):
    """One sensor of calibration.json."""
    pose = {"matrix": T_found.tolist()}
    return {"T_robot_sensor": pose, "covariance": covariance.tolist(), "status": {"reason": ""}}


# --- errors


def test_an_error_is_the_norm_of_the_shift_and_the_geodesic_angle():
    found = T.copy()
    found[:3, 3] += [0.001, -0.002, 0.002]
    found[:3, :3] = T[:3, :3] @ geometry.so3_exp(np.radians([0.3, 0.0, -0.4]))
    assert measure.error(T, found) == pytest.approx((3.0, 0.5))


def test_two_rotations_of_one_angle_about_different_axes_are_not_alike():
    a, b = (geometry.pose(geometry.so3_exp(w)) for w in ([0.1, 0, 0], [0, 0.1, 0]))
    assert measure.error(a, b)[1] > 5


def test_nees_of_an_error_of_one_sigma_in_every_direction_is_1():
    sigma = np.array([1, 2, 3, 4, 5, 6]) * 1e-4
    found = T @ geometry.se3_exp(-sigma)
    assert measure.nees(T, found, np.diag(sigma**2)) == pytest.approx(1.0)


def test_a_line_is_the_root_mean_square_of_its_logs_and_keeps_what_was_lost():
    reasons = [measure.Outcome("", (e, e / 10), (1, 1), 1.0, (2, 2)) for e in (3.0, 4.0)]
    reasons.append(measure.Outcome("no view"))
    line = measure.line(row("diamond-lidar-noisy"), 30, "surface", reasons)
    assert line.error == pytest.approx((12.5**0.5, 12.5**0.5 / 10))
    assert line.worst == pytest.approx(2.0) and line.lost == ("no view",) and line.logs == 2


def test_a_sensor_without_a_pose_is_a_reason_not_a_number():
    lost = {"T_robot_sensor": None, "covariance": None, "status": {"reason": "saw nothing"}}
    assert measure.outcome(lost, T, (1, 1), np.nan).reason == "saw nothing"


# --- rows


def test_every_accuracy_row_of_the_goals_has_its_line_at_every_n():
    asked = {(r.key, n) for r in rows.ROWS for n in r.counts}
    lidar = {"diamond-lidar", "cylinder-lidar", "diamond-lidar-noisy", "cylinder-lidar-noisy"}
    expected = {(k, n) for k in lidar | {"diamond-camera"} for n in (30, 15, 5)}
    assert asked == expected | {("cylinder-camera", n) for n in (10, 5)}


def test_every_row_is_measured_by_the_default_method_and_lidars_by_points_too():
    for r in rows.ROWS:
        assert r.methods[0] == rows.DEFAULT
        assert "points" in r.methods or r.key == "diamond-camera"
        assert r.goal is None or set(r.goal) == set(r.counts)


def test_quick_takes_the_smallest_n_of_every_row_once():
    quick = rows.cases(quick=True, seeds=3)
    assert {(c.row.key, c.n) for c in quick} == {(r.key, min(r.counts)) for r in rows.ROWS}
    assert {c.seed for c in quick} == {1}
    assert len({c.name for c in rows.cases(False, 3)}) == len(rows.cases(False, 3))


def test_names_of_cases_are_names_that_a_config_may_hold():
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    pattern = re.compile(schema["$defs"]["name"]["pattern"])
    for case in rows.cases(False, 1):
        assert pattern.match(case.name) and pattern.match(case.target)


# --- what the pipeline is given


SIMULATED = {
    "body": "mocap/robot",
    "mocap": {"topics": ["/tf"], "map": "mocap/world"},
    "sensors": {
        "velodyne": {"kind": "lidar", "topic": "/velodyne_points"},
        "camera": {"kind": "camera", "topic": "/camera/image_raw"},
    },
    "truth": {"velodyne": {"xyz_m": [1, 2, 3], "quat_xyzw": [0, 0, 0, 1]}},
}


@pytest.fixture
def logs(tmp_path):
    """Folders as simulate.py leaves them, without a log's content."""
    for name in plan.simulations(rows.cases(True, 1), 10):
        files = {"rigs/sim.yaml": SIMULATED, "truth.json": {"secret": 1}}
        for target in ("board", "cylinder"):
            path = ROOT / f"config/targets/{target}.yaml"
            files[f"targets/{target}.yaml"] = yaml.safe_load(path.read_text())
        for file, content in files.items():
            path = tmp_path / name / ("" if file == "truth.json" else "config") / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(content))
        (tmp_path / name / "logs").mkdir()
        (tmp_path / name / "logs" / "sim.mcap").touch()
    return tmp_path


def test_the_config_of_the_run_holds_guesses_and_no_word_of_the_truth(logs, tmp_path):
    cases = rows.cases(True, 1)
    benchmark.write_config(tmp_path / "run", logs, cases)
    files = list((tmp_path / "run").rglob("*.yaml"))
    assert len(files) == 1 + len(cases) + len({c.target for c in cases})
    for path in files:
        assert "truth" not in path.read_text() and "secret" not in path.read_text()
    rig = yaml.safe_load((tmp_path / "run/config/rigs" / f"{cases[0].name}.yaml").read_text())
    assert list(rig["sensors"]) == [cases[0].row.sensor]
    for name, found in rig["sensors"].items():
        assert found == SIMULATED["sensors"][name]


def test_guesses_are_off_by_as_much_as_the_goals_ask():
    for arguments in plan.simulations(rows.cases(False, 2), 30).values():
        at = arguments.index("--guess-error-m")
        assert arguments[at : at + 4] == ["--guess-error-m", "0.03", "--guess-error-deg", "5"]


# --- costs

LOG = """kept 41 of 380 moments
decode took 3.21 s, 2.90 s CPU, 212 MB
"""


def test_costs_add_up_over_the_jobs_of_a_stage_and_keep_the_largest_memory():
    found = cost.costs([LOG, "decode took 1.00 s, 0.50 s CPU, 300 MB\n", "no such line"])
    assert found == {"decode": cost.Cost(2, 4.21, 3.4, 300)}


def test_costs_come_in_the_order_in_which_the_data_flow():
    texts = [f"{stage} took 1.0 s, 1.0 s CPU, 1 MB\n" for stage in ("solve", "gate", "decode")]
    assert list(cost.costs(texts)) == ["decode", "gate", "solve"]


# --- the page


def made_up(key, n, error, method="surface", reference=(0.1, 0.01), **more):
    outcome = measure.Outcome("", error, (0.1, 0.01), more.pop("nees", 1.0), reference)
    return measure.line(row(key), n, method, [outcome])


RUN = cost.Speed("1 lidar", {"solve": cost.Cost(1, 2.5, 2, 90)}, 11.0, 2.0, [(20, 95), (300, 97)])


def test_the_table_states_error_goal_their_ratio_and_what_others_reach():
    line = made_up("diamond-camera", 5, (0.02, 0.0003))
    head, _, cells = page.accuracy([line]).splitlines()
    found = dict(zip(head.split(" | "), cells.split(" | "), strict=True))
    assert found["error"] == "0.02 mm 0.0003°" and found["goal"] == "0.01 mm 0.0003°"
    assert found["error / goal"] == "2 1" and found["paper"] == "0.14 mm 0.034°"


def test_what_is_not_reached_is_said_with_its_factor_and_nothing_else_is():
    reached = made_up("diamond-camera", 5, (0.009, 0.0003))
    missed = made_up("diamond-lidar", 30, (0.003, 0.00005))
    text = page.missed([reached, missed], RUN)
    assert "N = 30: 0.003 mm is 3 × the goal, 0.001 mm" in text
    assert "camera" not in text and "°" not in text.split("N = 30")[1].splitlines()[0]
    assert "solve: 2.5 s, goal 1 s" in text and "not estimated by this version" in text


def test_noisy_lines_are_held_against_the_reference_and_their_covariance():
    bad = made_up("diamond-lidar-noisy", 15, (0.25, 0.011), nees=4.0)
    found = page.short_of(bad)
    assert any("1.15 × the reference" in s for s in found)
    assert any("one log errs by 2.5 ×" in s for s in found)
    assert any("NEES/6 is 4" in s for s in found)
    assert page.short_of(made_up("diamond-lidar-noisy", 15, (0.1, 0.01))) == []


def test_the_baseline_is_shown_but_not_held_to_the_goals():
    line = made_up("diamond-lidar", 5, (5.0, 0.6), method="points, corners")
    assert page.short_of(line) == [] and "5 mm 0.6°" in page.accuracy([line])


def test_the_page_holds_all_parts_and_the_chart_is_the_same_bytes_twice():
    lines = [made_up("diamond-lidar", 5, (5.0, 0.6)), made_up("diamond-camera", 5, (0.1, 0.01))]
    text = page.whole(lines, RUN, quick=True, seeds=1)
    assert "make benchmark-quick" in text and "95 MB on a log of 20 MB" in text
    assert chart.svg(lines) == chart.svg(lines)


# --- the reference

BOARD = targets.from_config(
    {"shape": "board", "outline_m": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}
    | {"thickness_m": 0.0}
)
RANGE_SIGMA, SIGMA = 0.01, np.repeat([2e-4, 3e-4], 3)
OPTIONS = {"gate_sigma": 6, "edge_margin_m": 0.02, "min_cosine": 0.3}


def hand_made():
    """A Setup of a lidar that sees a board three times, and its true T_robot_sensor."""
    rng = np.random.default_rng(0)
    lidar = Lidar(0.003, 0.03, None, None, (0.3, 100), RANGE_SIGMA)
    places, groups = [], []
    for k, tilt in enumerate(([0.2, -1.3, 0.1], [-0.3, -1.8, 0.3], [0.6, -1.5, -0.5])):
        T_sensor_target = geometry.pose(geometry.so3_exp(tilt), [2.0, 0.3 * k, 0.1])
        body = geometry.se3_exp([0.01, 0.02, 0, 0, 0.1, 0])
        T_robot_body = T @ T_sensor_target @ geometry.inverse(body)
        places.append(estimation.Placement("s", "board", T_robot_body, body, SIGMA))
        flat = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), np.zeros(40)])
        keypoints = {
            "xyz": geometry.transform(T_sensor_target, flat),
            "sigma": np.full(40, RANGE_SIGMA),
            "view": np.zeros(40, int),
            "index": np.zeros(40, int),
        }
        groups.append(estimation.Group("lidar", k, "surface", keypoints))
    models, shapes = {"lidar": lidar}, {"board": BOARD}
    return estimation.Setup(models, shapes, places, groups, OPTIONS, {})


def residuals(setup, x):
    """Distances from the plane over σ, and the MCS errors, of the unknowns x (6 + 36,)."""
    out = [x[6:]]
    for g in setup.groups:
        place = setup.placements[g.placement]
        y = x[6 + 12 * g.placement :][:12].reshape(2, 6) * SIGMA
        robot, body = geometry.se3_exp(y)
        T_robot_target = geometry.inverse(robot) @ place.T_robot_body @ body @ place.T_body_target
        p_robot = geometry.transform(T @ geometry.se3_exp(x[:6]), g.keypoints["xyz"])
        p = geometry.transform(geometry.inverse(T_robot_target), p_robot)
        origin = geometry.transform(geometry.inverse(T_robot_target), T[:3, 3])
        cosine = (origin[2] - p[:, 2]) / np.linalg.norm(p - origin, axis=1)
        out.append(p[:, 2] / (RANGE_SIGMA * cosine))
    return np.concatenate(out)


def test_the_reference_is_the_inverse_information_by_finite_differences():
    setup, h = hand_made(), 1e-6
    steps = h * np.eye(42)
    J = np.column_stack([(residuals(setup, s) - residuals(setup, -s)) / (2 * h) for s in steps])
    expected = np.linalg.inv(J.T @ J)[:6, :6]
    found, sigmas = reference.evaluate(setup, {"lidar": T}, RANGE_SIGMA)
    assert found["lidar"] == pytest.approx(expected, rel=0.01, abs=1e-3 * expected.max())
    assert measure.spread(found["lidar"]) == pytest.approx(measure.spread(expected), rel=1e-3)
    assert sigmas["lidar", "surface"] == pytest.approx(RANGE_SIGMA)


def test_four_times_the_noise_of_everything_is_four_times_the_reference():
    setup = hand_made()
    near, _ = reference.evaluate(setup, {"lidar": T}, RANGE_SIGMA)
    louder = [estimation.Placement(p.session, p.target, p.T_robot_body, p.T_body_target, 4 * SIGMA)
              for p in setup.placements]  # fmt: skip
    setup = estimation.Setup(setup.models, setup.targets, louder, setup.groups, OPTIONS, {})
    far, _ = reference.evaluate(setup, {"lidar": T}, 4 * RANGE_SIGMA)
    assert far["lidar"] == pytest.approx(16 * near["lidar"], rel=1e-6)
