"""Split halves of finished runs, errors that a fit could know, and their section of the page."""

import numpy as np
import pytest

from benchmarking.page.markdown import PageSection
from benchmarking.split_halves import split_half_draws
from benchmarking.split_halves.known_errors import (
    KnownErrorOutcome,
    check_known_error_goals,
    compare_sigma,
)
from benchmarking.split_halves.split_half_draws import DrawFile, SplitHalfDraw
from benchmarking.split_halves.split_half_page import (
    build_split_half_section,
    check_split_half_goals,
    replace_section,
)

DRAWS = {
    "acfr_vlp16, car": [
        SplitHalfDraw("velodyne", model=6.0, clusters=3.0, reported=0.9, is_same_choice=False),
        SplitHalfDraw("velodyne", model=2.0, clusters=1.0, reported=0.7, is_same_choice=True),
        SplitHalfDraw("left", model=1.8, clusters=1.7, reported=1.7, is_same_choice=True),
    ]
}
OUTCOMES = [
    KnownErrorOutcome("board bowed", "lidar", ratio=1.0, worst=1.2, nees=0.8),
    KnownErrorOutcome("board bowed", "lidar", ratio=1.2, worst=1.6, nees=1.2),
    KnownErrorOutcome("beams", "lidar", ratio=1.5, worst=3.0, nees=1.0),
]


def test_the_table_has_means_median_how_often_halves_chose_alike_and_the_earlier_figure():
    text = build_split_half_section(DRAWS, OUTCOMES).text
    assert "| acfr vlp16, car | velodyne | 2 | 4 | 2 | 0.8 | 0.8 | 1 of 2 | 7.3 |" in text
    assert "goal 0.5 to 1.5" in text
    assert "| board bowed | lidar | 2 | 1.1 | 1.4 | 1 |" in text


def test_a_quick_section_says_nothing_of_errors_that_were_not_measured():
    assert "known" not in build_split_half_section(DRAWS, []).text


def test_what_misses_a_goal_is_told_by_name():
    (missed,) = check_split_half_goals(DRAWS)
    assert missed == "split halves of acfr_vlp16, car: left has 1.7, goal 0.5 to 1.5"
    (missed,) = check_known_error_goals(OUTCOMES)
    assert missed == "beams: σ of lidar is 1.5 of a known error's, goal 1.3"
    assert f"* {missed}." in build_split_half_section(DRAWS, OUTCOMES).text


def test_sigma_of_twice_the_size_in_one_direction_is_the_worst_and_raises_the_mean():
    known = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 1.0])
    found = known.copy()
    found[2, 2] = 16.0
    outcome = compare_sigma("bow", "lidar", known, found, np.array([2.0, 2, 4, 1, 1, 1]))
    assert outcome.worst == pytest.approx(2.0)
    assert outcome.ratio == pytest.approx(np.sqrt(9 / 6))
    assert outcome.nees == pytest.approx(1.0)


def test_the_section_replaces_its_earlier_form_and_nothing_else():
    section = PageSection("Split halves", "new", [])
    page = "# Page\n\n## A\n\na\n\n## Split halves\n\nold\n\n## Not reached\n\n* none\n"
    replaced = "# Page\n\n## A\n\na\n\n## Split halves\n\nnew\n\n## Not reached\n\n* none\n"
    assert replace_section(page, section) == replaced
    without = "# Page\n\n## A\n\na\n\n## Not reached\n\n* none\n"
    assert replace_section(without, section) == replaced


def test_draws_go_on_where_they_stopped(tmp_path, monkeypatch):
    drawn = []

    def halving(rig, seed):
        drawn.append(seed)
        return [SplitHalfDraw("lidar", 1.0, 1.0, float(seed), True)]

    monkeypatch.setattr(split_half_draws, "draw_halving", halving)
    DrawFile(tmp_path / "draws.json").draw("yard", None, 2)
    draws = DrawFile(tmp_path / "draws.json")
    draws.draw("yard", None, 4)
    assert drawn == [0, 1, 2, 3]
    assert [d.reported for d in draws.by_title()["yard"]] == [0.0, 1.0, 2.0, 3.0]
