"""What σ means for a task, which directions are told, where residuals depend on something."""

import copy

import numpy as np
import pytest

import report
from calib.geometry import se3
from calib.io import parquet_tables, pose_block
from calib.report.data import load_run
from calib.report.figures import scene_3d_data
from calib.report.overlays import lidar_on_image
from calib.report.sections import (
    diagnostics,
    extrinsics,
    principal_directions,
    residual_splits,
    task_accuracy,
)
from calib.sensors import sensor_models
from reporting import CAMERA, POSES, SIGMA, Files, section, words


def read(files):
    """The Run of the files as they stand."""
    return load_run.read_run(report.arguments(files.write()))


def test_a_shift_alone_is_as_many_mm_at_every_distance():
    covariance = np.diag([0.002, 0.001, 0.001, 0, 0, 0]) ** 2
    found = [task_accuracy.metres(POSES["left"], covariance, r) for r in task_accuracy.RANGES]
    np.testing.assert_allclose(found, 0.002)


def test_a_turn_alone_moves_a_point_by_angle_times_distance():
    covariance = np.diag([0, 0, 0, 1e-3, 0, 0]) ** 2
    found = np.array(
        [task_accuracy.metres(POSES["top"], covariance, r) for r in task_accuracy.RANGES]
    )
    np.testing.assert_allclose(found, 1e-3 * np.array(task_accuracy.RANGES), rtol=2e-2)


def test_pixels_are_those_of_points_moved_by_draws_of_the_pose():
    """Monte Carlo of 4000 relative poses, at 5 m, along the worst direction in each pixel."""
    model, T_s_c = sensor_models.camera(CAMERA), se3.inverse(POSES["top"]) @ POSES["left"]
    rng = np.random.default_rng(4)
    uv, sigma = task_accuracy.pixels(model, T_s_c, np.diag(SIGMA**2), 5.0)
    for k in (0, 70, 191):
        ray, _ = model.unproject(uv[k : k + 1])
        p_s = se3.transform(T_s_c, 5.0 * ray)
        drawn = T_s_c @ se3.se3_exp(SIGMA * rng.standard_normal((4000, 6)))
        seen = model.project([se3.transform(se3.inverse(T), p_s)[0] for T in drawn])[0]
        worst = np.sqrt(np.linalg.eigvalsh(np.cov(seen.T))[-1])
        assert sigma[k] == pytest.approx(worst, rel=0.06)


def test_every_pair_is_told_in_mm_and_with_a_camera_in_px(files, undrawn):
    run = read(files)
    (row,) = task_accuracy.rows(run, extrinsics.between(run))
    mm = [float(v) for v in row["mm"]]
    # Across each other: positions unsure by 3 and 2 mm, turns by 0.3 and 0.2 mrad.
    assert mm == sorted(mm) and 3.6 < mm[0] < 4.0 and 7.2 < mm[3] < 8.2
    assert [c for c, _ in row["px"]] == ["left"]
    assert f"left – top {' '.join(row['mm'])}" in words(section(files.render(), "between"))
    assert all(float(worst) >= float(middle) > 0 for middle, worst in row["px"][0][1])


def test_the_least_certain_direction_comes_first_with_what_to_record_next(files):
    run = read(files)
    row = next(r for r in principal_directions.rows(run) if r["name"] == "top")
    assert row["six"][0] == ("translation along z of the robot body", "3 mm")
    assert row["six"][-1][1].endswith("°")
    assert row["advice"] == "Tilt the board."


def test_residuals_are_split_by_what_they_may_depend_on(files):
    worse = (files.residuals["sensor"] == "top") & (files.residuals["index"] == 3)
    files.residuals["value"][worse & ~files.residuals["moving"], 0] += 0.04
    rows = residual_splits.of_sensor(read(files), "top")
    by = {r["by"] for r in rows}
    assert by == {"target", "session", "range", "incidence", "ring", "speed"}
    rings = {r["group"]: r for r in rows if r["by"] == "ring"}
    assert float(rings["3"]["mean_sigma"]) == pytest.approx(4, abs=0.5)
    assert float(rings["4"]["mean_sigma"].replace("−", "-")) == pytest.approx(0, abs=0.5)
    speeds = [r["group"] for r in rows if r["by"] == "speed"]
    assert speeds[0] == "at rest" and speeds[-1] == "0.6 to 0.7 m/s" and len(speeds) == 7
    assert sum(r["n"] for r in rows if r["by"] == "target") == 810


def test_a_camera_is_split_by_image_region(files):
    rows = residual_splits.of_sensor(read(files), "left")
    assert {r["by"] for r in rows} >= {"image region", "speed", "incidence"}
    assert all(r["unit"] == "px" and r["mean"].startswith("(") for r in rows)


def test_views_in_motion_count_nowhere_but_by_speed(files):
    run = read(files)
    assert not run.residuals["moving"].any() and run.in_motion["moving"].all()
    kept = run.residuals["view"].size
    files.residuals = parquet_tables.select(files.residuals, ~files.residuals["moving"])
    assert read(files).residuals["view"].size == kept
    assert {
        r["group"] for r in residual_splits.of_sensor(read(files), "top") if r["by"] == "speed"
    } == {"at rest"}


def test_points_of_the_3d_view_lie_on_the_targets_by_the_result_and_beside_by_the_guess(files):
    """The board faces the robot 2 to 2.5 m ahead; the guess is off by 5 cm and 2°."""
    run = read(files)
    for seen in scene_3d_data.sensors(run):
        on, beside = (se3.transform(T, seen.points) for T in (seen.result, seen.guess))
        for placement in (0, 1):
            T = se3.inverse(run.T_robot_target("s1", placement))
            near = np.abs(se3.transform(T, on))
            if seen.kind == "lidar":  # the camera's depths are not consistent here
                assert ((near < [0.41, 0.31, 1e-5]).all(1)).sum() > 200
        assert np.linalg.norm(on - beside, axis=1).min() > 0.02
    told = scene_3d_data.content(run)
    assert [s["name"] for s in told["sensors"]] == ["left", "top"]
    assert len(told["targets"][0]) == len(told["targets"][2])


def test_returns_are_drawn_on_the_image_of_the_same_placement_by_guess_and_result(files):
    (pair,) = lidar_on_image.draw(read(files))
    assert pair["name"] == "top on left"
    assert [title for title, _ in pair["views"]] == ["by the first guesses", "by the result"]
    assert "300 returns in the image" in pair["views"][1][1].caption


def test_without_a_common_placement_it_is_said_that_the_motion_capture_alone_links(files, undrawn):
    rows = (files.residuals["sensor"] != "left") | (files.residuals["placement"] == 9)
    files.residuals = parquet_tables.select(files.residuals, rows)
    assert "rests on the motion capture alone" in words(section(files.render(), "overlays"))


def finding(check, level, value, limit, text="much"):
    told = {"check": check, "level": level, "value": value, "limit": limit, "text": text}
    return told | {"sensor": "left", "sensors": ["left"], "remedy": f"mend {check}"}


def test_diagnostics_are_ranked_by_level_then_by_what_they_cost(tmp_path):
    files = Files(tmp_path)
    files.findings = [
        finding("sigma_m", "warn", 0.006, 0.005),
        finding("beyond", "warn", 0.09, 0.03),
        finding("status", "fail", None, None),
        finding("placements", "warn", 2, 5),
    ]
    rows = diagnostics.rows(read(files), {})
    assert [r["remedy"] for r in rows] == [
        "mend status", "mend beyond", "mend placements", "mend sigma_m",
    ]  # fmt: skip
    assert [r["cost"] for r in rows] == [
        "the pose of left", "3 × the limit", "40 % of the limit", "1.2 × the limit",
    ]  # fmt: skip


def test_views_that_told_nothing_are_diagnosed_with_their_share(files, undrawn):
    rows = files.residuals["sensor"] == "left"
    files.residuals["weight"] = np.where(rows, 0.0, files.residuals["weight"])
    said = words(section(files.render(), "diagnostics"))
    assert "no measurement was a member of the solution 2 of 2 kept views" in said


def test_only_what_differs_from_the_defaults_is_told_of_the_settings(files, undrawn):
    files.options["settings"] = copy.deepcopy(files.options["settings"])
    files.options["settings"]["crop"]["max_frames"] = 4
    said = words(section(files.render(), "provenance"))
    assert "crop.max_frames 4 10" in said and "gate.window_s" not in said


def test_a_turn_that_nobody_can_see_is_not_asked_for(files, undrawn):
    """A cylinder about its own axis: its σ is that of the prior, and nothing is to be tilted."""
    files.calibration["targets"]["pipe"] = {
        "T_body_target": pose_block.pose_json(np.eye(4)),
        "covariance": np.diag(SIGMA**2).tolist(),
        "shift": [0.0] * 6,
        "prior": (SIGMA * [4, 4, 4, 1.0, 4, 4]).tolist(),
        "open": [],
    }
    said = words(files.render())
    assert "σ is 0.25 to 0.25 of its prior; the turn about x of the target does not matter" in said
    assert "tilt it to more sides" not in said
