"""The report where something is missing: said with its reason, and nothing healthy is lost."""

import numpy as np
import pytest

import report
from calib.io.parquet_tables import concatenate_columns, empty_columns, read_table, select_rows
from calib.io.status import OK, InputError, failure_status
from calib.io.table_schemas import (
    CAMERA_VIEWS_SCHEMA,
    ITERATIONS_SCHEMA,
    PLACEMENTS_SCHEMA,
    RESIDUALS_SCHEMA,
)
from calib.report.data.run_data import COLUMNS_WITHOUT_PAYLOAD
from calib.report.data.run_loader import read_report_run
from calib.report.number_format import format_decimals
from calib.report.overlays.overlay_selection import select_overlay_views
from calib.sensors.camera.images.image_messages import decode_png
from calib.views.view_payloads import read_view_payloads
from helpers.report_inputs import (
    MISSING_PATTERN,
    NO_VIEW,
    SENSOR_CONFIGS,
    extract_page_text,
    extract_section,
    remove_sensor_pose,
)
from report import parse_report_arguments

FINDING = {
    "check": "status",
    "sensor": "left",
    "sensors": ["left"],
    "level": "fail",
    "value": None,
    "limit": None,
    "ratio": None,
    "text": "left: no view <of> a target",
    "remedy": NO_VIEW.remedy,
    "change": None,
}


def test_sensor_without_a_pose_says_what_to_do_and_shows_no_guess(report_files, skip_figures):
    report_files.calibration = remove_sensor_pose(report_files.calibration, "left", NO_VIEW)
    report_files.calibration |= {"verdict": "fail", "reasons": ["left: no view <of> a target"]}
    report_files.findings = [FINDING]
    report_files.remove_sensor_views("left", NO_VIEW)
    page = report_files.render_report()
    said = extract_page_text(page)
    assert "1 of 2 sensors calibrated from 1 session; no pose for left." in said
    assert (
        "Reason left: no view &lt;of&gt; a target (found 40 not still; expected 1 or more)." in said
    )
    assert "To do Record its view." in said
    assert "No pose." in said
    for part in (NO_VIEW.reason, NO_VIEW.found, NO_VIEW.expected, NO_VIEW.remedy):
        assert part in said
    assert "left: no view &lt;of&gt; a target" in page
    guess = report_files.guesses["s1", "left"]["T_robot_sensor"]["xyz_m"]
    assert format_decimals(1e3 * guess[0], 1) not in said
    assert "No residual: no measurement of this sensor reached the solve." in said
    # The other sensor keeps its numbers.
    assert "x, mm 226.0 200.0" in said


def test_nothing_at_all(report_files):
    status = failure_status(
        "MCS body mcs/robot is not in the log", "bodies none", "mcs/robot", "Check `body`."
    )
    for name in SENSOR_CONFIGS:
        report_files.calibration = remove_sensor_pose(report_files.calibration, name, status)
        report_files.remove_sensor_views(name, status)
        report_files.guesses["s1", name] |= {
            "T_robot_sensor": None,
            "status": status.to_dict(),
            "frame": "",
        }
        report_files.calibration["sensors"][name]["guess"]["T_robot_sensor"] = None
    report_files.calibration |= {"verdict": "fail", "reasons": ["nothing"]}
    report_files.placements["s1"] = (
        empty_columns(PLACEMENTS_SCHEMA),
        status,
        {"board": status},
    )
    report_files.iterations = empty_columns(ITERATIONS_SCHEMA)
    nothing = {"status": status.to_dict(), "poses": 0}
    report_files.audits["s1"] |= {"bodies": {"mcs/robot": nothing}, "topics": {}}
    silent = {"status": status.to_dict(), "frame": "", "messages": 0, "rate_hz": 0.0}
    report_files.audits["s1"]["sensors"] = dict.fromkeys(SENSOR_CONFIGS, silent)
    said = extract_page_text(report_files.render_report())
    assert "FAIL Result 0 of 2 sensors calibrated" in said
    assert "Check `body`." in said
    assert "No round was run." in said
    assert "There are no measurements" in said


def test_no_session_and_no_sensor(report_files, skip_figures):
    report_files.options |= {"sessions": {}, "sensors": {}, "targets": {}}
    report_files.calibration |= {
        "sensors": {},
        "joint_covariance": None,
        "targets": {},
        "sessions": {},
    }
    report_files.calibration["noise"]["sensors"] = {}
    report_files.residuals = empty_columns(RESIDUALS_SCHEMA)
    assert "0 of 0 sensors" in extract_page_text(report_files.render_report())


def test_views_without_a_find_are_shown_and_explained(report_files, skip_figures):
    columns, _, outcomes = report_files.keypoints["s1", "left"]
    keep = np.asarray(columns["view"]) != 1
    outcomes = outcomes | {1: MISSING_PATTERN}
    report_files.keypoints["s1", "left"] = select_rows(columns, keep), OK, outcomes
    gone = (report_files.residuals["sensor"] == "left") & (report_files.residuals["view"] == 1)
    report_files.residuals = select_rows(report_files.residuals, ~gone)
    said = extract_page_text(report_files.render_report())
    assert "not found: 1 no checkerboard in the region" in said
    assert "s1, view 1: board, placement 1; nothing found" in said
    assert "4 × 3 inner corners" in said


def test_measurements_without_an_inlier_are_excluded_not_plotted(report_files, skip_figures):
    rows = report_files.residuals["sensor"] == "left"
    report_files.residuals["weight"] = np.where(rows, 0.0, report_files.residuals["weight"])
    said = extract_page_text(report_files.render_report())
    assert "No measurement is an inlier" in said
    assert "not used: 2 no measurement is an inlier" in said


def test_sessions_may_use_different_sensors(report_files, skip_figures):
    report_files.options["sessions"] = {"s1": ["left", "top"], "s0": ["top"]}
    for kept in (report_files.audits, report_files.frames, report_files.placements):
        kept["s0"] = kept["s1"]
    for kept in (report_files.guesses, report_files.views, report_files.keypoints):
        kept["s0", "top"] = kept["s1", "top"]
    rows = select_rows(report_files.residuals, report_files.residuals["sensor"] == "top")
    rows["session"] = np.full(len(rows["view"]), "s0")
    report_files.residuals = concatenate_columns([report_files.residuals, rows], RESIDUALS_SCHEMA)
    page = report_files.render_report()
    assert "Vertical lines separate the sessions" in page
    assert "Session s0" in page
    assert "s0, view" in page


@pytest.mark.parametrize("most", [0, 1, 2])
def test_overlays_are_limited(report_files, skip_figures, most):
    report_files.options["report"]["max_overlays"] = most
    shown = extract_section(report_files.render_report(), "extraction")
    assert shown.count('class="photo"') == most
    assert shown.count(" over the target but not used") == most


def test_a_typical_view_is_shown_beside_the_worst(report_files, skip_figures):
    report_files.options["report"]["max_overlays"] = 1
    page = report_files.render_report()
    worst, typical = (
        extract_page_text(extract_section(page, name)) for name in ("extraction", "overlays")
    )
    assert "s1, view 0: board, placement 0" in worst.split(" top ")[0]
    assert "A typical view of each sensor" in typical
    assert "left, s1, view 1: board, placement 1" in typical
    assert "left, s1, view 0" not in typical


def test_unknown_rings_are_not_plotted(report_files, skip_figures):
    report_files.residuals["feature_index"] = np.full(len(report_files.residuals["view"]), -1)
    page = report_files.render_report()
    assert "Residuals of top by range" in page
    assert "Residuals of top by ring" not in page


def test_table_of_another_sensor_kind_is_refused(report_files):
    arguments = report_files.write_inputs()
    at = arguments.index("--views")
    arguments[at + 1], arguments[at + 2] = arguments[at + 2], arguments[at + 1]
    with pytest.raises(InputError, match="views"):
        report.main(arguments)


def test_payloads_reads_only_what_is_wanted(report_files):
    report_files.write_inputs()
    path = report_files.folder / "s1-left-views.parquet"
    rows = read_view_payloads(path, [1])
    assert list(rows) == [1]
    assert decode_png(rows[1]["png"]).shape == (240, 320, 3)
    columns, status, _ = read_table(path, CAMERA_VIEWS_SCHEMA, COLUMNS_WITHOUT_PAYLOAD)
    assert status.ok
    assert set(columns) == set(COLUMNS_WITHOUT_PAYLOAD)


def test_worst_views_come_first_and_every_target_is_among_them(report_files):
    worse = (report_files.residuals["sensor"] == "top") & (report_files.residuals["placement"] == 1)
    report_files.residuals["value"][worse] *= 5
    least = (report_files.residuals["sensor"] == "top") & (report_files.residuals["placement"] == 2)
    report_files.residuals["value"][least] *= 0.1
    args = parse_report_arguments(report_files.write_inputs())
    views = select_overlay_views(read_report_run(args), "top", 2)
    assert [v.view for v in views] == [1, 2]
