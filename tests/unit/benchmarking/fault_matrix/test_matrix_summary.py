"""Rows of the fault matrix: errors in σ, goals, advice that is followed, and the page."""

import json

import numpy as np
import pytest
import yaml

from benchmarking.fault_matrix.draw_outcome import DrawOutcome, read_draw_outcome
from benchmarking.fault_matrix.matrix_goals import check_goals, is_hidden, least_share
from benchmarking.fault_matrix.matrix_page import (
    MATRIX_HEADING,
    render_matrix,
    split_page,
    write_matrix_section,
)
from benchmarking.fault_matrix.row_measurement import RowResult, apply_change
from calib.geometry.se3 import se3_exp

CHANGE = {"file": "config/targets/board.yaml", "key": "pattern.square_m", "value": 0.08}
SMALL, WRONG = {"camera": (0.2, 0.01, 1.4)}, {"camera": (9.0, 0.1, 8.0)}


def outcome(level, errors, first="", change=None):
    return DrawOutcome(level, first, change, errors)


def make_row(before, after=(), *, name="squares", causes=("squares of board",)):
    after = [*after] or [None] * len(before)
    return RowResult(name, "2 %", causes, 1, "", before, after)


GOOD = make_row([outcome("warn", WRONG, "the squares of board are small", CHANGE)])
CLEAN = make_row([outcome("pass", SMALL)], name="clean", causes=())


def write_results(folder, text, twist):
    pose = {"matrix": se3_exp(twist).tolist()}
    covariance = np.diag([1e-6] * 3 + [1e-8] * 3).tolist()
    sensor = {"T_robot_sensor": pose, "covariance": covariance}
    finding = {"text": text, "remedy": "do a; if that is right: do b", "change": CHANGE}
    (folder / "verdict.json").write_text(json.dumps({"verdict": "warn", "findings": [finding]}))
    (folder / "calibration.json").write_text(json.dumps({"sensors": {"camera": sensor}}))
    truth = {"sensors": {"camera": {"T_robot_sensor": {"matrix": np.eye(4).tolist()}}}}
    (folder / "truth.json").write_text(json.dumps(truth))
    return read_draw_outcome(folder, folder / "truth.json")


def test_an_error_is_in_mm_and_degrees_and_in_sigma_of_its_worst_direction(tmp_path):
    found = write_results(tmp_path, "x", [0.003, 0.0, 0.004, 0.0, 1e-5, 0.0])
    mm, deg, sigmas = found.errors["camera"]
    assert mm == pytest.approx(5.0, abs=1e-3)
    assert deg == pytest.approx(np.degrees(1e-5), abs=1e-6)
    assert sigmas == pytest.approx(4.0, abs=1e-2)


def test_a_rival_of_the_first_cause_is_not_named_first(tmp_path):
    found = write_results(tmp_path, "the lens is long; or else the squares are small", np.zeros(6))
    assert found.names(("lens",))
    assert not found.names(("squares",))
    assert not found.names(("do b",))


def test_all_goals_are_met_by_clean_passes_and_a_fault_that_is_named_and_cured():
    cured = make_row(GOOD.before, [outcome("pass", SMALL)])
    assert [line.is_met for line in check_goals([CLEAN], [cured])] == [True] * 5


def test_a_wrong_pass_fails_three_goals_and_is_shown_by_name():
    lines = check_goals([CLEAN], [make_row([outcome("pass", WRONG)])])
    assert [line.is_met for line in lines[:4]] == [True, False, False, False]
    assert lines[3].measured == "1 of 2 draws, 50.0%, at least 2.5%; short: squares, 2 % 1 of 1"


@pytest.mark.parametrize(("n_good", "n", "share"), [(299, 299, 0.99), (6, 6, 0.607), (0, 5, 0.0)])
def test_draws_that_are_all_good_show_a_share_of_5_percent_to_the_power_of_1_over_n(
    n_good, n, share
):
    assert least_share(n_good, n) == pytest.approx(share, abs=5e-4)


def test_a_fault_that_moves_nothing_need_not_be_named():
    lines = check_goals([CLEAN], [GOOD, make_row([outcome("pass", SMALL)])])
    assert all(line.is_met for line in lines[:4])


def test_what_was_not_measured_is_not_met():
    assert not any(line.is_met for line in check_goals([], []))


@pytest.mark.parametrize(
    ("level", "errors", "hidden"),
    [
        ("pass", SMALL, False),
        ("warn", WRONG, False),
        ("pass", WRONG, True),
        ("pass", {"camera": (9.0, 0.1, 1.0)}, True),  # σ was only widened
        ("pass", {"camera": (4.0, 0.1, 6.0)}, True),  # half the error, still 6 σ
    ],
)
def test_advice_hides_an_error_if_it_passes_without_a_cure(level, errors, hidden):
    assert is_hidden(outcome("warn", WRONG), outcome(level, errors)) is hidden


def test_a_change_is_written_to_its_key_alone(tmp_path):
    path = tmp_path / "config" / "targets" / "board.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("shape: board\npattern: {square_m: 0.082, kind: checkerboard}\n")
    apply_change(tmp_path, CHANGE)
    pattern = {"square_m": 0.08, "kind": "checkerboard"}
    assert yaml.safe_load(path.read_text()) == {"shape": "board", "pattern": pattern}
    apply_change(tmp_path, CHANGE | {"key": "a.b", "value": True})
    assert yaml.safe_load(path.read_text())["a"] == {"b": True}


def test_a_row_comes_back_from_its_file_as_it_was():
    row = make_row(GOOD.before, [outcome("pass", SMALL)])
    again = RowResult.from_json(row.to_json())
    assert again.to_json() == row.to_json()
    assert again.before[0].names(row.causes)


def test_the_page_keeps_its_table_and_gets_a_new_matrix(tmp_path):
    page = tmp_path / "faults.md"
    page.write_text("# Faults\n\ntable\n")
    write_matrix_section(page, [CLEAN], [GOOD], 3)
    section = write_matrix_section(page, [CLEAN], [GOOD], 3)
    assert page.read_text() == "# Faults\n\ntable\n" + section
    assert split_page(page.read_text()) == ("# Faults\n\ntable\n", section)
    assert section.count(MATRIX_HEADING) == 1
    assert "3 rows of the matrix were not measured" in section


def test_a_row_shows_verdicts_cause_error_and_advice():
    cured = make_row(GOOD.before, [outcome("pass", SMALL)])
    assert (
        "| squares | 2 % | 1 | 0 / 1 / 0 | 1 of 1 | 9 mm 0.1°, 8 σ | the squares of board are "
        "small | `pattern.square_m` | 1 / 0 / 0 | 0.2 mm 0.01°, 1.4 σ |"
    ) in render_matrix([CLEAN], [cured], 0)
