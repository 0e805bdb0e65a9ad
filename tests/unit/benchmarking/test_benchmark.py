"""The benchmark measures what it says: errors, costs, the reference, and what falls short."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmark import write_run_config
from benchmarking.accuracy.accuracy_cases import (
    ACCURACY_ROWS,
    DEFAULT_METHOD,
    find_draw_source,
    list_accuracy_cases,
)
from benchmarking.accuracy.covariance_coverage import CoverageResult
from benchmarking.accuracy.cramer_rao_bound import compute_cramer_rao_bound
from benchmarking.accuracy.draw_statistics import (
    DrawResult,
    compute_draw_statistics,
    compute_nees_band,
)
from benchmarking.accuracy.error_metrics import (
    CalibrationOutcome,
    compute_nees,
    compute_pose_error,
    evaluate_sensor_result,
    sigma_mm_deg,
    summarize_logs,
)
from benchmarking.accuracy.simulation_plan import plan_simulations
from benchmarking.decode_cost.decode_cost import (
    DecodeCostRow,
    build_decode_section,
    format_decode_table,
)
from benchmarking.decode_cost.process_cost import RunSpeed, StageCost, parse_stage_costs
from benchmarking.fuzzing.case_runner import FuzzOutcome
from benchmarking.fuzzing.fuzzing_page import build_fuzz_section
from benchmarking.page.benchmark_page import (
    check_line_goals,
    format_accuracy_table,
    format_missed_goals,
    render_benchmark_page,
)
from benchmarking.page.error_chart import render_error_chart_svg
from benchmarking.page.markdown import PageSection
from benchmarking.page.statistics_tables import check_draw_goals, format_draw_table
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.geometry.se3 import (
    invert_pose,
    make_pose,
    pose_from_rpy,
    se3_exp,
    so3_exp,
    transform_points,
)
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.target_shapes import target_from_config

ROOT = Path(__file__).parents[3]
T = pose_from_rpy([0.2, -0.1, 0.6], [0.1, -0.2, 0.3])


def row(key):
    return next(r for r in ACCURACY_ROWS if r.key == key)


def sensor(T_found, covariance):
    """One sensor of calibration.json."""
    pose = {"matrix": T_found.tolist()}
    return {"T_robot_sensor": pose, "covariance": covariance.tolist(), "status": {"reason": ""}}


# --- errors


def test_an_error_is_the_norm_of_the_shift_and_the_geodesic_angle():
    found = T.copy()
    found[:3, 3] += [0.001, -0.002, 0.002]
    found[:3, :3] = T[:3, :3] @ so3_exp(np.radians([0.3, 0.0, -0.4]))
    assert compute_pose_error(T, found) == pytest.approx((3.0, 0.5))


def test_two_rotations_of_one_angle_about_different_axes_are_not_alike():
    a, b = (make_pose(so3_exp(w)) for w in ([0.1, 0, 0], [0, 0.1, 0]))
    assert compute_pose_error(a, b)[1] > 5


def test_nees_of_an_error_of_one_sigma_in_every_direction_is_1():
    sigma = np.array([1, 2, 3, 4, 5, 6]) * 1e-4
    found = T @ se3_exp(-sigma)
    assert compute_nees(T, found, np.diag(sigma**2)) == pytest.approx(1.0)


def test_a_line_is_the_root_mean_square_of_its_logs_and_keeps_what_was_lost():
    reasons = [CalibrationOutcome("", (e, e / 10), (1, 1), 1.0, (2, 2)) for e in (3.0, 4.0)]
    reasons.append(CalibrationOutcome("no view"))
    line = summarize_logs(row("diamond-lidar-noisy"), 30, "surface", reasons)
    assert line.error == pytest.approx((12.5**0.5, 12.5**0.5 / 10))
    assert (
        line.worst_error_ratio == pytest.approx(2.0)
        and line.failure_reasons == ("no view",)
        and line.n_logs == 2
    )


def test_a_sensor_without_a_pose_is_a_reason_not_a_number():
    lost = {"T_robot_sensor": None, "covariance": None, "status": {"reason": "saw nothing"}}
    assert evaluate_sensor_result(lost, T, (1, 1), np.nan).failure_reason == "saw nothing"


# --- rows


def test_every_accuracy_row_of_the_goals_has_its_line_at_every_n():
    asked = {(r.key, n) for r in ACCURACY_ROWS for n in r.placement_counts}
    lidar = {"diamond-lidar", "cylinder-lidar", "diamond-lidar-noisy", "cylinder-lidar-noisy"}
    expected = {(k, n) for k in lidar | {"diamond-camera"} for n in (30, 15, 5)}
    assert asked == expected | {("cylinder-camera", n) for n in (10, 5)}


def test_every_row_is_measured_by_the_default_method_and_lidars_by_points_too():
    for r in ACCURACY_ROWS:
        assert r.methods[0] == DEFAULT_METHOD
        assert "points" in r.methods or r.key == "diamond-camera"
        assert r.goals is None or set(r.goals) == set(r.placement_counts)


def test_quick_takes_the_smallest_n_of_every_row_once():
    quick = list_accuracy_cases(is_quick=True)
    assert {(c.row.key, c.n_placements) for c in quick} == {
        (r.key, min(r.placement_counts)) for r in ACCURACY_ROWS
    }
    assert {c.seed for c in quick} == {1}
    assert len({c.case_name for c in list_accuracy_cases(False)}) == len(list_accuracy_cases(False))


def test_names_of_cases_are_names_that_a_config_may_hold():
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    pattern = re.compile(schema["$defs"]["name"]["pattern"])
    for case in list_accuracy_cases(False):
        assert pattern.match(case.case_name) and pattern.match(case.target_name)


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
    for name in plan_simulations(list_accuracy_cases(True), 10, 1):
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
    cases = list_accuracy_cases(True)
    write_run_config(tmp_path / "run", logs, cases)
    files = list((tmp_path / "run").rglob("*.yaml"))
    assert len(files) == 1 + len(cases) + len({c.target_name for c in cases})
    for path in files:
        assert "truth" not in path.read_text() and "secret" not in path.read_text()
    rig = yaml.safe_load((tmp_path / "run/config/rigs" / f"{cases[0].case_name}.yaml").read_text())
    assert list(rig["sensors"]) == [cases[0].row.sensor]
    for name, found in rig["sensors"].items():
        assert found == SIMULATED["sensors"][name]


def test_guesses_are_off_by_as_much_as_the_goals_ask():
    for arguments in plan_simulations(list_accuracy_cases(False), 30, 2).values():
        at = arguments.index("--guess-error-m")
        assert arguments[at : at + 4] == ["--guess-error-m", "0.03", "--guess-error-deg", "5"]


# --- costs

LOG = """kept 41 of 380 moments
decode took 3.21 s, 2.90 s CPU, 212 MB
"""


def test_costs_add_up_over_the_jobs_of_a_stage_and_keep_the_largest_memory():
    found = parse_stage_costs([LOG, "decode took 1.00 s, 0.50 s CPU, 300 MB\n", "no such line"])
    assert found == {"decode": StageCost(2, 4.21, 3.4, 300)}


def test_costs_come_in_the_order_in_which_the_data_flow():
    texts = [f"{stage} took 1.0 s, 1.0 s CPU, 1 MB\n" for stage in ("solve", "gate", "decode")]
    assert list(parse_stage_costs(texts)) == ["decode", "gate", "solve"]


# --- the page


def made_up(key, n, error, method="surface", reference=(0.1, 0.01), **more):
    outcome = CalibrationOutcome("", error, (0.1, 0.01), more.pop("nees", 1.0), reference)
    return summarize_logs(row(key), n, method, [outcome])


def drawn(factor, count=100, size=1.0):
    """Statistics of draws: errors are factor times the reported σ, which is size times the
    reference."""
    rng = np.random.default_rng(5)
    reference = np.diag(np.repeat([1e-4, 2e-4], 3) ** 2)
    reported = size**2 * reference
    errors = factor * rng.multivariate_normal(np.zeros(6), reported, count)
    draws = [DrawResult(error, reported) for error in errors]
    return compute_draw_statistics(draws, reference, 4 * reference)


RUN = RunSpeed("1 lidar", {"solve": StageCost(1, 2.5, 2, 90)}, 11.0, 2.0, [(20, 95), (300, 97)])
COVERED = CoverageResult("lidar", 1000, {"velodyne": 0.95}, {"velodyne": 1.0}, {"velodyne": 6})
INGESTED = DecodeCostRow("zstd", 1e10, 36000, StageCost(1, 9, 8, 510), StageCost(1, 5, 4, 30))
INPUTS = [
    FuzzOutcome("config", 1, "refused", "no name", 0.02, 120.0),
    FuzzOutcome("hostile log", 7, "broken", "Traceback\nKeyError: 'x'\n", 2.5, 640.0),
]
FOUND = ({("diamond-lidar-noisy", 15): drawn(1.0)}, [COVERED], {"camera": drawn(1.0, 20)})


def cells(text, n=0):
    """{heading: cell} of row n of a Markdown table."""
    head, _, *lines = text.splitlines()
    return dict(zip(head.split(" | "), lines[n].split(" | "), strict=True))


def test_the_table_states_error_goal_their_ratio_and_what_others_reach():
    found = cells(format_accuracy_table([made_up("diamond-lidar", 5, (0.002, 0.0001))]))
    assert found["error"] == "0.002 mm 0.0001°" and found["goal"] == "0.001 mm 0.0001°"
    assert found["error / goal"] == "2 1" and found["paper"] == "0.3 mm 0.0038°"


def test_one_log_with_noise_is_shown_but_held_to_no_goal():
    line = made_up("diamond-camera", 5, (9.0, 9.0))
    assert cells(format_accuracy_table([line]))["goal"] == "–" and check_line_goals(line) == []


def test_what_is_not_reached_is_said_with_its_factor_and_nothing_else_is():
    missed = made_up("diamond-lidar", 30, (0.003, 0.00005))
    text = format_missed_goals([missed], RUN, FOUND, [PageSection("x", "", ["all else fails"])])
    assert "* all else fails." in text
    assert "N = 30: 0.003 mm is 3 × the goal, 0.001 mm" in text
    assert "°" not in text.split("N = 30")[1].splitlines()[0]
    assert "solve: 2.5 s, goal 1 s" in text and "not yet measured here" in text


def test_the_baseline_is_shown_but_not_held_to_the_goals():
    line = made_up("diamond-lidar", 5, (5.0, 0.6), method="points, corners")
    assert check_line_goals(line) == [] and "5 mm 0.6°" in format_accuracy_table([line])


def test_the_page_holds_all_parts_and_the_chart_is_the_same_bytes_twice():
    lines = [made_up("diamond-lidar", 5, (5.0, 0.6)), made_up("diamond-lidar-noisy", 15, (0.1, 1))]
    sections = build_decode_section([INGESTED]), build_fuzz_section(INPUTS)
    text = render_benchmark_page(lines, RUN, FOUND, sections, is_quick=True)
    assert "make benchmark-quick" in text and "95 MB on a log of 20 MB" in text
    found = cells(format_decode_table([INGESTED]))
    assert (found["MB/s"], found["decode / reader |"]) == ("2500", "2 |")
    assert format_decode_table([INGESTED]) in text
    assert "decode of 10 GB, chunks zstd: 2 × mcap's own reader, goal 1.5 ×" in text
    assert "decode of 10 GB, chunks zstd: 510 MB, goal 500 MB" in text
    assert (
        "| hostile log | 1 | 0 | 0 | 0 | 1 |" in text and "| config | 1 | 0 | 0 | 1 | 0 |" in text
    )
    assert "took 2.5 s" in text and "* damaged input took 640 MB, goal 500 MB." in text
    assert "* 1 cases of damaged input broke, first 7: KeyError: 'x'." in text
    assert render_error_chart_svg(lines, FOUND[0]) == render_error_chart_svg(lines, FOUND[0])


# --- many draws


def test_draws_as_their_sigma_says_have_nees_1_in_its_band_and_95_percent_hold():
    found = drawn(1.0, 2000)
    low, high = compute_nees_band(2000)
    assert low < found.mean_nees < high and high - low == pytest.approx(
        4 * (2 / (6 * 2000)) ** 0.5, 0.03
    )
    assert found.share_covered == pytest.approx(0.95, abs=0.015)
    assert found.rms_error == pytest.approx(found.reference, rel=0.03)
    assert found.reference_without_outlines == pytest.approx(np.multiply(2, found.reference))


def test_the_share_above_twice_the_reference_is_that_of_an_efficient_estimator():
    found = drawn(1.0, 4000)
    assert (
        found.outlier_share == pytest.approx(found.gaussian_outlier_share, abs=0.006)
        and 0.005 < found.gaussian_outlier_share < 0.06
    )


def test_a_shift_of_a_sigma_that_no_draw_shows_alone_is_seen_in_their_mean():
    rng, one = np.random.default_rng(1), np.eye(6)
    shifted = [DrawResult(x + [0.5, 0, 0, 0, 0, 0], one) for x in rng.normal(size=(100, 6))]
    found = compute_draw_statistics(shifted, one, one)
    assert found.mean_nees < 1.15 and found.mean_error_nees > 3


def test_draws_are_held_against_the_reference_and_their_covariance():
    bad = {("diamond-lidar-noisy", 15): drawn(2.0)}
    said = check_draw_goals(bad, [], {})
    assert any("1.15 × the reference" in s for s in said)
    assert any("err by more than 2 ×" in s and "efficient estimator" in s for s in said)
    assert any("NEES over its degrees of freedom is" in s for s in said)
    good = check_draw_goals({("diamond-lidar-noisy", 15): drawn(1.0)}, [], {})
    assert all("err by more than 2 ×" in s for s in good) and len(good) == 1


def test_ellipsoids_that_hold_too_seldom_are_said_where_chance_does_not_explain_it():
    def said(count, held):
        found = CoverageResult("lidar", count, {"a": held}, {"a": 1.0}, {"a": 6})
        return check_draw_goals({}, [found], {})

    assert said(1000, 0.94) == [] and said(40, 0.9) == []
    assert "hold 92 %, goal 93 % to 97 %" in said(1000, 0.92)[0] and len(said(40, 0.8)) == 1


def test_a_draw_without_a_pose_is_counted_not_averaged():
    draws = [
        DrawResult(None, None),
        DrawResult(np.full(6, 1e-4), 1e-8 * np.eye(6)),
    ]
    found = compute_draw_statistics(draws, 1e-8 * np.eye(6), 1e-8 * np.eye(6))
    assert (found.n_results, found.n_failures) == (1, 1) and np.isfinite(found.rms_error).all()
    text = format_draw_table({("diamond-camera", 5): found})
    assert cells(text)["draws"] == "1 of 2"


def test_the_table_of_draws_states_both_references_and_both_shares():
    found = cells(format_draw_table(FOUND[0]))
    assert found["reference"] == "0.17 mm 0.02°" and found["without outlines"] == "0.35 mm 0.04°"
    assert found["goal"] == "0.2 mm 0.023°" and "%" in found["above 2 ×"]


def test_every_row_with_noise_is_drawn_from_a_recording_that_the_run_makes():
    cases = set(c.case_name for c in list_accuracy_cases(True))
    for r in ACCURACY_ROWS:
        source = find_draw_source(r, r.placement_counts[-1])
        assert (source is None) == r.is_noise_free
        assert source is None or (source.case_name in cases and source.row.sensor == r.sensor)


# --- the reference

BOARD = target_from_config(
    {"shape": "board", "outline_m": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}
    | {"thickness_m": 0.0}
)
RANGE_SIGMA, SIGMA = 0.01, np.repeat([2e-4, 3e-4], 3)
OPTIONS = {"gate_sigma": 6, "edge_margin_m": 0.02, "min_cosine": 0.3}


def hand_made():
    """A Setup of a lidar that sees a board three times, and its true T_robot_sensor."""
    rng = np.random.default_rng(0)
    lidar = LidarModel(0.003, 0.03, None, None, (0.3, 100), RANGE_SIGMA)
    places, groups = [], []
    for k, tilt in enumerate(([0.2, -1.3, 0.1], [-0.3, -1.8, 0.3], [0.6, -1.5, -0.5])):
        T_sensor_target = make_pose(so3_exp(tilt), [2.0, 0.3 * k, 0.1])
        body = se3_exp([0.01, 0.02, 0, 0, 0.1, 0])
        T_robot_body = T @ T_sensor_target @ invert_pose(body)
        places.append(Placement("s", "board", T_robot_body, body, SIGMA))
        flat = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), np.zeros(40)])
        keypoints = {
            "xyz": transform_points(T_sensor_target, flat),
            "sigma": np.full(40, RANGE_SIGMA),
            "view": np.zeros(40, int),
            "feature_index": np.zeros(40, int),
        }
        groups.append(MeasurementGroup("lidar", k, "target_surface", keypoints))
    models, shapes = {"lidar": lidar}, {"board": BOARD}
    return Setup(models, shapes, places, groups, OPTIONS, {})


def residuals(setup, x):
    """Distances from the plane over σ, and the MCS errors, of the unknowns x (6 + 36,)."""
    out = [x[6:]]
    for g in setup.groups:
        place = setup.placements[g.placement]
        y = x[6 + 12 * g.placement :][:12].reshape(2, 6) * SIGMA
        robot, body = se3_exp(y)
        T_robot_target = invert_pose(robot) @ place.T_robot_body @ body @ place.T_body_target
        p_robot = transform_points(T @ se3_exp(x[:6]), g.keypoints["xyz"])
        p = transform_points(invert_pose(T_robot_target), p_robot)
        origin = transform_points(invert_pose(T_robot_target), T[:3, 3])
        cosine = (origin[2] - p[:, 2]) / np.linalg.norm(p - origin, axis=1)
        out.append(p[:, 2] / (RANGE_SIGMA * cosine))
    return np.concatenate(out)


def test_the_reference_is_the_inverse_information_by_finite_differences():
    setup, h = hand_made(), 1e-6
    steps = h * np.eye(42)
    J = np.column_stack([(residuals(setup, s) - residuals(setup, -s)) / (2 * h) for s in steps])
    expected = np.linalg.inv(J.T @ J)[:6, :6]
    found = compute_cramer_rao_bound(setup, {"lidar": T}, RANGE_SIGMA)
    whole = found.covariance["lidar"]
    assert whole == pytest.approx(expected, rel=0.01, abs=1e-3 * expected.max())
    assert sigma_mm_deg(whole) == pytest.approx(sigma_mm_deg(expected), rel=1e-3)
    assert found.measurement_sigma["lidar", "target_surface"] == pytest.approx(RANGE_SIGMA)


def test_four_times_the_noise_of_everything_is_four_times_the_reference():
    setup = hand_made()
    near = compute_cramer_rao_bound(setup, {"lidar": T}, RANGE_SIGMA).covariance
    louder = [replace(p, mocap_sigma=4 * SIGMA) for p in setup.placements]
    setup = Setup(setup.models, setup.targets, louder, setup.groups, OPTIONS, {})
    far = compute_cramer_rao_bound(setup, {"lidar": T}, 4 * RANGE_SIGMA).covariance
    assert far["lidar"] == pytest.approx(16 * near["lidar"], rel=1e-6)
