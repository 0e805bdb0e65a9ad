"""The report where something is missing: said with its reason, and nothing healthy is lost."""

import numpy as np
import pytest

import report
from calib.io import parquet_tables, table_schemas
from calib.io.status import OK, InputError, failed
from calib.report import number_format
from calib.report.data import load_run, run_data
from calib.report.overlays import overlay_selection
from calib.sensors.camera.images import image_messages
from calib.views import view_payloads
from reporting import NOT_FOUND, SENSORS, UNSEEN, section, without_pose, words

FINDING = {
    "check": "status",
    "sensor": "left",
    "sensors": ["left"],
    "level": "fail",
    "value": None,
    "limit": None,
    "text": "left: no view <of> a target",
    "remedy": UNSEEN.remedy,
}


def test_sensor_without_a_pose_says_what_to_do_and_shows_no_guess(files, undrawn):
    files.calibration = without_pose(files.calibration, "left", UNSEEN)
    files.calibration |= {"verdict": "fail", "reasons": ["left: no view <of> a target"]}
    files.findings = [FINDING]
    files.blind("left", UNSEEN)
    page = files.render()
    said = words(page)
    assert "1 of 2 sensors calibrated from 1 session; no pose for left." in said
    assert "Why left: no view &lt;of&gt; a target (found 40 not still; expected 1 or more)." in said
    assert "Do Record its view." in said
    assert "No pose." in said
    for part in (UNSEEN.reason, UNSEEN.found, UNSEEN.expected, UNSEEN.remedy):
        assert part in said
    assert "left: no view &lt;of&gt; a target" in page
    guess = files.guesses["s1", "left"]["T_robot_sensor"]["xyz_m"]
    assert number_format.fixed(1e3 * guess[0], 1) not in said
    assert "No residual: nothing of this sensor reached the solve." in said
    # The other sensor keeps its numbers.
    assert "x, mm 226.0 200.0" in said


def test_nothing_at_all(files):
    status = failed(
        "MCS body mcs/robot is not in the log", "bodies none", "mcs/robot", "Check `body`."
    )
    for name in SENSORS:
        files.calibration = without_pose(files.calibration, name, status)
        files.blind(name, status)
        files.guesses["s1", name] |= {
            "T_robot_sensor": None,
            "status": status.to_dict(),
            "frame": "",
        }
        files.calibration["sensors"][name]["guess"]["T_robot_sensor"] = None
    files.calibration |= {"verdict": "fail", "reasons": ["nothing"]}
    files.placements["s1"] = (
        parquet_tables.empty(table_schemas.PLACEMENTS),
        status,
        {"board": status},
    )
    files.iterations = parquet_tables.empty(table_schemas.ITERATIONS)
    nothing = {"status": status.to_dict(), "poses": 0}
    files.audits["s1"] |= {"bodies": {"mcs/robot": nothing}, "topics": {}}
    silent = {"status": status.to_dict(), "frame": "", "messages": 0, "rate_hz": 0.0}
    files.audits["s1"]["sensors"] = dict.fromkeys(SENSORS, silent)
    said = words(files.render())
    assert "FAIL Found 0 of 2 sensors calibrated" in said
    assert "Check `body`." in said
    assert "No round was run." in said
    assert "Nothing was measured" in said


def test_no_session_and_no_sensor(files, undrawn):
    files.options |= {"sessions": {}, "sensors": {}, "targets": {}}
    files.calibration |= {"sensors": {}, "joint_covariance": None, "targets": {}, "sessions": {}}
    files.calibration["noise"]["sensors"] = {}
    files.residuals = parquet_tables.empty(table_schemas.RESIDUALS)
    assert "0 of 0 sensors" in words(files.render())


def test_views_without_a_find_are_shown_and_explained(files, undrawn):
    columns, _, outcomes = files.keypoints["s1", "left"]
    keep = np.asarray(columns["view"]) != 1
    outcomes = outcomes | {1: NOT_FOUND}
    files.keypoints["s1", "left"] = parquet_tables.select(columns, keep), OK, outcomes
    gone = (files.residuals["sensor"] == "left") & (files.residuals["view"] == 1)
    files.residuals = parquet_tables.select(files.residuals, ~gone)
    said = words(files.render())
    assert "not found: 1 no checkerboard in the region" in said
    assert "s1, view 1: board, placement 1; nothing found" in said
    assert "4 × 3 inner corners" in said


def test_measurements_without_a_member_are_left_out_not_plotted(files, undrawn):
    rows = files.residuals["sensor"] == "left"
    files.residuals["weight"] = np.where(rows, 0.0, files.residuals["weight"])
    said = words(files.render())
    assert "No measurement is a member" in said
    assert "not used: 2 no measurement was a member of the solution" in said


def test_sessions_may_use_different_sensors(files, undrawn):
    files.options["sessions"] = {"s1": ["left", "top"], "s0": ["top"]}
    for kept in (files.audits, files.frames, files.placements):
        kept["s0"] = kept["s1"]
    for kept in (files.guesses, files.views, files.keypoints):
        kept["s0", "top"] = kept["s1", "top"]
    rows = parquet_tables.select(files.residuals, files.residuals["sensor"] == "top")
    rows["session"] = np.full(len(rows["view"]), "s0")
    files.residuals = parquet_tables.concatenate([files.residuals, rows], table_schemas.RESIDUALS)
    page = files.render()
    assert "A line parts the sessions" in page
    assert "Session s0" in page
    assert "s0, view" in page


@pytest.mark.parametrize("most", [0, 1, 2])
def test_overlays_are_limited(files, undrawn, most):
    files.options["report"]["max_overlays"] = most
    shown = section(files.render(), "gallery")
    assert shown.count('class="photo"') == most
    assert shown.count(" over the target but not used") == most


def test_a_typical_view_is_shown_beside_the_worst(files, undrawn):
    files.options["report"]["max_overlays"] = 1
    page = files.render()
    worst, typical = (words(section(page, name)) for name in ("gallery", "overlays"))
    assert "s1, view 0: board, placement 0" in worst.split(" top ")[0]
    assert "A typical view of each sensor" in typical
    assert "left, s1, view 1: board, placement 1" in typical
    assert "left, s1, view 0" not in typical


def test_unknown_rings_are_not_plotted(files, undrawn):
    files.residuals["index"] = np.full(len(files.residuals["view"]), -1)
    page = files.render()
    assert "Residuals of top by range" in page
    assert "Residuals of top by ring" not in page


def test_table_of_another_sensor_kind_is_refused(files):
    arguments = files.write()
    at = arguments.index("--views")
    arguments[at + 1], arguments[at + 2] = arguments[at + 2], arguments[at + 1]
    with pytest.raises(InputError, match="views"):
        report.main(arguments)


def test_payloads_reads_only_what_is_wanted(files):
    files.write()
    path = files.folder / "s1-left-views.parquet"
    rows = view_payloads.payloads(path, [1])
    assert list(rows) == [1]
    assert image_messages.from_png(rows[1]["png"]).shape == (240, 320, 3)
    columns, status, _ = parquet_tables.read(path, table_schemas.VIEWS_CAMERA, run_data.LIGHT)
    assert status.ok
    assert set(columns) == set(run_data.LIGHT)


def test_worst_views_come_first_and_every_target_is_among_them(files):
    worse = (files.residuals["sensor"] == "top") & (files.residuals["placement"] == 1)
    files.residuals["value"][worse] *= 5
    least = (files.residuals["sensor"] == "top") & (files.residuals["placement"] == 2)
    files.residuals["value"][least] *= 0.1
    args = report.arguments(files.write())
    chosen = overlay_selection.choose(load_run.read_run(args), "top", 2)
    assert [view for _, view, _ in chosen] == [1, 2]
