"""What the report tells beside the poses: levels, residuals, unknowns, suspicions."""

import numpy as np
import pytest

from calib.geometry.se3 import pose_from_rpy
from calib.io.config import validate_and_complete
from calib.io.pose_block import pose_json
from calib.report.number_format import format_kind
from calib.report.sections import verdict
from calib.report.sections.residuals import KIND_DESCRIPTIONS, printed_unit
from calib.report.sections.verdict import LimitCell, list_limit_cells
from calib.verdict.findings import level_by_limits
from calib.verdict.rig_verdict import sensor_findings, sigma_findings
from helpers.report_inputs import (
    LEAVE_ONE_OUT_JSON,
    POSE_SIGMA,
    VERDICT_LIMITS,
    extract_page_text,
    extract_section,
    make_sensor_result,
)


def test_estimated_unknowns_are_told(report_files, skip_figures):
    report_files.calibration["sensors"]["left"]["time_offset_s"] = {"value": 0.025, "sigma": 0.0002}
    report_files.calibration["sensors"]["left"]["time_offset_note"] = (
        "from 25 views of targets in motion"
    )
    report_files.calibration["sensors"]["top"]["time_offset_note"] = (
        "not observable: no relative motion"
    )
    drift = {"value": 200.0, "sigma": 20.0}
    wander = {"time_offset_s": {"value": 0.026, "sigma": 0.0003}, "drift_ppm": drift}
    report_files.calibration["sensors"]["left"]["clock_drift"] = {"s1": wander}
    report_files.calibration["targets"]["board"] = {
        "T_body_target": pose_json(pose_from_rpy([0.006, 0, 0], [0, 0, np.radians(1)])),
        "covariance": np.diag(POSE_SIGMA**2).tolist(),
        "shift": [0.006, 0, 0, 0, 0, np.radians(1)],
        "prior_sigma": (POSE_SIGMA * [2, 4, 4, 4, 4, 1.05]).tolist(),
        "undetermined": ["its turn about z"],
    }
    T = pose_json(pose_from_rpy([0.03, 0, 0], [0, 0, 0]))
    markers = {"T_robot_markers": T, "covariance": np.diag(POSE_SIGMA**2).tolist()}
    report_files.calibration["sessions"]["s1"] = markers
    report_files.calibration["mocap_scales"] = {"s1": {"value": -0.004, "sigma": 1e-4}}
    said = extract_page_text(report_files.render_report())
    assert "robot markers in s1, robot frame x 30.0 ± 1.0 mm" in said
    assert "time offset of left 25.000 ± 0.2 ms, from 25 views of targets in motion" in said
    assert "scale of the motion capture in s1 distances 0.400 ± 0.01 % too short" in said
    assert "clock of left in s1 26.000 ± 0.3 ms in the middle, drift 200 ± 20 ppm" in said
    assert "time offset of top not observable: no relative motion" in said
    assert "mount of board in its MCS body x 6.0 ± 1.0 mm" in said
    assert "yaw 1.0000 ± 0.0172 °; σ is 0.25 to 0.95 of its prior" in said
    assert "undetermined: its turn about z: tilt it to more sides" in said


def test_the_range_error_common_to_all_beams_is_shown_if_sigma_includes_it(
    report_files, skip_figures
):
    report_files.calibration["sensors"]["top"]["common_range_sigma_m"] = 0.004 / 17**0.5
    assert "ranges of top, all together 0 ± 0.97 mm, not estimated" in extract_page_text(
        report_files.render_report()
    )
    report_files.calibration["sensors"]["top"]["common_range_sigma_m"] = None
    assert "ranges of top, all together" not in extract_page_text(report_files.render_report())


def test_every_session_stands_beside_the_others(report_files, skip_figures):
    row = {"session": "s1", "sensor": "left", "n_other_sessions": 1, "p_value": 1e-9}
    row["markers"] = None
    shift, sigma = [0.003, 0, 0.004, 0, 0, 0.01], [0.0001] * 3 + [0.001] * 3
    report_files.calibration["repeatability"] = [row | {"shift": shift, "sigma": sigma}]
    assert "s1 left 5 0.17 0.57 0.099" in extract_page_text(report_files.render_report())


def test_halves_of_the_placements_stand_beside_each_other(report_files, skip_figures):
    said = extract_page_text(report_files.render_report())
    assert "top 5 + 4 5 1.7 0.57 0.5 5 beam offsets of top | none" in said
    report_files.calibration["split_halves"] = None
    assert "Half by half" not in extract_page_text(report_files.render_report())


def test_levels_agree_with_the_judge():
    limits = validate_and_complete("config", {"sessions": {"s": {"rig": "r", "log": "x"}}}, "x")[
        "judge"
    ]
    told = {
        "direction_spread_deg": {},
        "fit_by_kind": {},
        "recording_advice": "",
        "guess_deviation_in_sigma": None,
    }
    for sigma in (0.001, 0.006, 0.03):
        sensor = make_sensor_result("top") | {"covariance": (np.eye(6) * sigma**2).tolist()} | told
        sensor |= {
            "rejected_share": 0.3,
            "placements": 2,
            "leave_one_out": LEAVE_ONE_OUT_JSON | {"error_over_sigma": 3.0},
        }
        cells = {cell.key: verdict._check_level(cell, limits) for cell in list_limit_cells(sensor)}
        found = sensor_findings("top", sensor, limits)
        found += sigma_findings("top", sensor, limits, has_misfit=True)
        assert {k: v for k, v in cells.items() if v != "pass"} == {
            f["check"]: f["level"] for f in found
        }


@pytest.mark.parametrize("large_is_bad", [True, False])
def test_a_value_that_is_no_number_fails_for_judge_and_report_alike(large_is_bad):
    key = "sigma_m" if large_is_bad else "placements"
    assert level_by_limits(np.nan, VERDICT_LIMITS, key, large_is_bad) == "fail"
    cell = LimitCell("", "", key, 1.0, np.nan, large_is_bad)
    assert verdict._check_level(cell, VERDICT_LIMITS) == "fail"


@pytest.mark.parametrize(
    ("sensor", "kind", "signed", "unit"),
    [
        ("left", "cylinder_limb", True, "px"),
        ("left", "template_silhouette", True, "px"),
        ("top", "template_point", False, "mm"),
        ("top", "template_vertex", False, "mm"),
        ("top", "board_outline", True, "°"),
    ],
)
def test_every_kind_of_measurement_is_shown(report_files, skip_figures, sensor, kind, signed, unit):
    rows = report_files.residuals["sensor"] == sensor
    report_files.residuals["kind"] = np.where(rows, kind, report_files.residuals["kind"])
    if kind == "cylinder_limb":
        report_files.residuals["value"][rows, 1] = 0
    if not signed:
        report_files.residuals["value"][rows] = np.abs(report_files.residuals["value"][rows])
        report_files.residuals["cos_incidence"][rows] = 0.0
    report_files.calibration["noise"]["sensors"][sensor] = {kind: 0.01}
    page = report_files.render_report()
    assert f"Residuals of {sensor} {format_kind(kind)} over sigma" in page
    assert f">{format_kind(kind)}<small>{KIND_DESCRIPTIONS[kind]}" in page
    assert printed_unit(kind)[0] == unit
    assert (
        "which are never" in extract_page_text(page) or "never negative" in extract_page_text(page)
    ) != signed


def test_what_did_not_pass_comes_with_what_to_do(report_files, skip_figures):
    """Each remedy once, below the reasons for it."""
    one = {"check": "rejected", "level": "warn", "value": 0.3, "limit": 0.2, "text": "much"}
    one |= {"ratio": 1.5, "remedy": "look at the overlays", "change": None}
    report_files.findings = [one | {"sensor": n, "sensors": [n]} for n in ("left", "top")]
    page = report_files.render_report()
    said = extract_page_text(page)
    assert "To do Look at the overlays." in said
    assert "warn much warn much To do: look at the overlays" in said
    assert extract_section(page, "diagnostics").count("look at the overlays") == 2
    assert "1.5 × the limit" in extract_section(page, "diagnostics")


def test_suspicions_are_told_with_rivals_effect_and_remedy(report_files, skip_figures):
    rival = {
        "name": "mount",
        "subject": "board",
        "description": "it is off",
        "remedy": "so",
        "log_likelihood_gain": 9.0,
        "change": None,
    }
    rival |= {"estimate": [0.001], "sigma": [0.0001]}
    report_files.calibration["suspected_errors"] = [
        {
            "name": "square_size",
            "subject": "board",
            "description": "the squares are larger",
            "remedy": "measure them",
            "change": {"file": "config/targets/board.yaml", "key": "square_m", "value": 0.08},
            "estimate": [0.02],
            "sigma": [0.001],
            "log_likelihood_gain": 30.0,
            "p_value": 1e-14,
            "adopted_in_halves": None,
            "explained_share": {"left/corner": 0.4, "mocap_noise": 0.01},
            "pose_shift": {"left": {"m": 0.0123, "rad": 0.001, "sigmas": 9.0}},
            "alternatives": [rival],
        }
    ]
    said = extract_page_text(report_files.render_report())
    assert "the squares are larger or it is off To do: measure them." in said
    assert "left 12 mm, 0.057° (9 σ) 40 % of left/corner" in said


def test_placements_left_out_and_measurements_left_out_are_counted(report_files, skip_figures):
    said = extract_page_text(report_files.render_report())
    assert "left 2 2 0.57 1.1 3.7 0.021 1 (board) no pose without it; 0 (board) 1.4 σ" in said
    assert "board pattern corner 70 7 (10 %) before the surface" in said
    assert "σ against the number of placements" in said
