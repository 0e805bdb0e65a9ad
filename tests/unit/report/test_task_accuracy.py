"""What σ means for a task, which directions are told, where residuals depend on something."""

import copy

import numpy as np
import pytest

from calib.geometry.se3 import invert_pose, se3_exp, transform_points
from calib.io.parquet_tables import select_rows
from calib.io.pose_block import pose_json
from calib.report.data.run_loader import read_report_run
from calib.report.figures.scene_3d_data import collect_scene_sensors, scene_3d_json
from calib.report.overlays.lidar_on_image import draw_lidar_on_images
from calib.report.sections.diagnostics import tabulate_diagnostics
from calib.report.sections.observability import tabulate_observability
from calib.report.sections.pairs import (
    TASK_RANGES_M,
    list_sensor_pairs,
    point_uncertainty_m,
    projection_uncertainty_px,
    tabulate_task_accuracy,
)
from calib.report.sections.residual_splits import tabulate_residual_splits
from calib.sensors.sensor_models import camera_from_config
from helpers.report_inputs import (
    CAMERA_CONFIG,
    POSE_SIGMA,
    T_ROBOT_SENSOR,
    ReportInputs,
    extract_page_text,
    extract_section,
)
from report import parse_report_arguments


def read(files):
    """The Run of the files as they stand."""
    return read_report_run(parse_report_arguments(files.write_inputs()))


def test_a_shift_alone_is_as_many_mm_at_every_distance():
    covariance = np.diag([0.002, 0.001, 0.001, 0, 0, 0]) ** 2
    found = [point_uncertainty_m(T_ROBOT_SENSOR["left"], covariance, r) for r in TASK_RANGES_M]
    np.testing.assert_allclose(found, 0.002)


def test_a_turn_alone_moves_a_point_by_angle_times_distance():
    covariance = np.diag([0, 0, 0, 1e-3, 0, 0]) ** 2
    found = np.array(
        [point_uncertainty_m(T_ROBOT_SENSOR["top"], covariance, r) for r in TASK_RANGES_M]
    )
    np.testing.assert_allclose(found, 1e-3 * np.array(TASK_RANGES_M), rtol=2e-2)


def test_pixels_are_those_of_points_moved_by_draws_of_the_pose():
    """Monte Carlo of 4000 relative poses, at 5 m, along the worst direction in each pixel."""
    model, T_s_c = (
        camera_from_config(CAMERA_CONFIG),
        invert_pose(T_ROBOT_SENSOR["top"]) @ T_ROBOT_SENSOR["left"],
    )
    rng = np.random.default_rng(4)
    uv, sigma = projection_uncertainty_px(model, np.diag(POSE_SIGMA**2), 5.0)
    for k in (0, 70, 191):
        ray, _ = model.unproject(uv[k : k + 1])
        p_s = transform_points(T_s_c, 5.0 * ray)
        drawn = T_s_c @ se3_exp(POSE_SIGMA * rng.standard_normal((4000, 6)))
        seen = model.project([transform_points(invert_pose(T), p_s)[0] for T in drawn])[0]
        worst = np.sqrt(np.linalg.eigvalsh(np.cov(seen.T))[-1])
        assert sigma[k] == pytest.approx(worst, rel=0.06)


def test_every_pair_is_told_in_mm_and_with_a_camera_in_px(report_files, skip_figures):
    run = read(report_files)
    (row,) = tabulate_task_accuracy(run, list_sensor_pairs(run))
    mm = [float(v) for v in row["mm"]]
    # Across each other: positions unsure by 3 and 2 mm, turns by 0.3 and 0.2 mrad.
    assert mm == sorted(mm) and 3.6 < mm[0] < 4.0 and 7.2 < mm[3] < 8.2
    assert [c for c, _ in row["px"]] == ["left"]
    assert f"left – top {' '.join(row['mm'])}" in extract_page_text(
        extract_section(report_files.render_report(), "pairs")
    )
    assert all(float(worst) >= float(middle) > 0 for middle, worst in row["px"][0][1])


def test_the_least_certain_direction_comes_first_with_what_to_record_next(report_files):
    run = read(report_files)
    row = next(r for r in tabulate_observability(run) if r["name"] == "top")
    assert row["principal_directions"][0] == ("translation along z of the robot body", "3 mm")
    assert row["principal_directions"][-1][1].endswith("°")
    assert row["advice"] == "Tilt the board."


def test_residuals_are_split_by_what_they_may_depend_on(report_files):
    worse = (report_files.residuals["sensor"] == "top") & (
        report_files.residuals["feature_index"] == 3
    )
    report_files.residuals["value"][worse & ~report_files.residuals["is_moving"], 0] += 0.04
    rows = tabulate_residual_splits(read(report_files), "top")
    by = {r["by"] for r in rows}
    assert by == {"target", "session", "range", "incidence", "ring", "speed"}
    rings = {r["group"]: r for r in rows if r["by"] == "ring"}
    assert float(rings["3"]["mean_sigma"]) == pytest.approx(4, abs=0.5)
    assert float(rings["4"]["mean_sigma"].replace("−", "-")) == pytest.approx(0, abs=0.5)
    speeds = [r["group"] for r in rows if r["by"] == "speed"]
    assert speeds[0] == "at rest" and speeds[-1] == "0.6 to 0.7 m/s" and len(speeds) == 7
    assert sum(r["n"] for r in rows if r["by"] == "target") == 810


def test_a_camera_is_split_by_image_region(report_files):
    rows = tabulate_residual_splits(read(report_files), "left")
    assert {r["by"] for r in rows} >= {"image region", "speed", "incidence"}
    assert all(r["unit"] == "px" and r["mean"].startswith("(") for r in rows)


def test_views_in_motion_count_nowhere_but_by_speed(report_files):
    run = read(report_files)
    assert not run.residuals["is_moving"].any() and run.moving_residuals["is_moving"].all()
    kept = run.residuals["view"].size
    report_files.residuals = select_rows(
        report_files.residuals, ~report_files.residuals["is_moving"]
    )
    assert read(report_files).residuals["view"].size == kept
    assert {
        r["group"]
        for r in tabulate_residual_splits(read(report_files), "top")
        if r["by"] == "speed"
    } == {"at rest"}


def test_points_of_the_3d_view_lie_on_the_targets_by_the_result_and_beside_by_the_guess(
    report_files,
):
    """The board faces the robot 2 to 2.5 m ahead; the guess is off by 5 cm and 2°."""
    run = read(report_files)
    for seen in collect_scene_sensors(run):
        on, beside = (transform_points(T, seen.inlier_points) for T in (seen.result, seen.guess))
        for placement in (0, 1):
            T = invert_pose(run.T_robot_target("s1", placement))
            near = np.abs(transform_points(T, on))
            if seen.kind == "lidar":  # the camera's depths are not consistent here
                assert ((near < [0.41, 0.31, 1e-5]).all(1)).sum() > 200
        assert np.linalg.norm(on - beside, axis=1).min() > 0.02
    told = scene_3d_json(run)
    assert [s["name"] for s in told["sensors"]] == ["left", "top"]
    assert len(told["targets"][0]) == len(told["targets"][2])


def test_returns_are_drawn_on_the_image_of_the_same_placement_by_guess_and_result(report_files):
    (pair,) = draw_lidar_on_images(read(report_files))
    assert pair["name"] == "top on left"
    assert [title for title, _ in pair["views"]] == ["by the initial guesses", "by the result"]
    assert "300 returns in the image" in pair["views"][1][1].caption


def test_without_a_common_placement_it_is_said_that_the_motion_capture_alone_links(
    report_files, skip_figures
):
    rows = (report_files.residuals["sensor"] != "left") | (report_files.residuals["placement"] == 9)
    report_files.residuals = select_rows(report_files.residuals, rows)
    assert "depends on the motion capture alone" in extract_page_text(
        extract_section(report_files.render_report(), "overlays")
    )


def finding(check, level, value, limit, text="much"):
    told = {"check": check, "level": level, "value": value, "limit": limit, "text": text}
    told["ratio"] = value and (limit / value if check == "placements" else value / limit)
    return told | {"sensor": "left", "sensors": ["left"], "remedy": f"mend {check}", "change": None}


def test_diagnostics_are_ranked_by_level_then_by_what_they_cost(tmp_path):
    files = ReportInputs(tmp_path)
    files.findings = [
        finding("sigma_m", "warn", 0.006, 0.005),
        finding("tail_share", "warn", 0.09, 0.03),
        finding("status", "fail", None, None),
        finding("placements", "warn", 2, 5),
    ]
    rows = tabulate_diagnostics(read(files), {})
    assert [r["remedy"] for r in rows] == [
        "mend status", "mend tail_share", "mend placements", "mend sigma_m",
    ]  # fmt: skip
    assert [r["cost"] for r in rows] == [
        "the pose of left", "3 × the limit", "40 % of the limit", "1.2 × the limit",
    ]  # fmt: skip


def test_views_that_told_nothing_are_diagnosed_with_their_share(report_files, skip_figures):
    rows = report_files.residuals["sensor"] == "left"
    report_files.residuals["weight"] = np.where(rows, 0.0, report_files.residuals["weight"])
    said = extract_page_text(extract_section(report_files.render_report(), "diagnostics"))
    assert "no measurement is an inlier 2 of 2 kept views" in said


def test_only_what_differs_from_the_defaults_is_told_of_the_settings(report_files, skip_figures):
    report_files.options["settings"] = copy.deepcopy(report_files.options["settings"])
    report_files.options["settings"]["crop"]["max_frames"] = 4
    said = extract_page_text(extract_section(report_files.render_report(), "provenance"))
    assert "crop.max_frames 4 10" in said and "gate.window_s" not in said


def test_a_turn_that_nobody_can_see_is_not_asked_for(report_files, skip_figures):
    """A cylinder about its own axis: its σ is that of the prior, and nothing is to be tilted."""
    report_files.calibration["targets"]["pipe"] = {
        "T_body_target": pose_json(np.eye(4)),
        "covariance": np.diag(POSE_SIGMA**2).tolist(),
        "shift": [0.0] * 6,
        "prior_sigma": (POSE_SIGMA * [4, 4, 4, 1.0, 4, 4]).tolist(),
        "undetermined": [],
    }
    said = extract_page_text(report_files.render_report())
    assert "σ is 0.25 to 0.25 of its prior; its rotation about x does not matter" in said
    assert "tilt it to more sides" not in said
