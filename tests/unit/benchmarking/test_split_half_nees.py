"""Split halves of finished runs: their table and the goals that they miss."""

from benchmarking.accuracy.split_half_nees import (
    SplitHalfDraw,
    build_split_half_section,
    check_split_half_goals,
)

DRAWS = {
    "yard, car": [
        SplitHalfDraw("lidar", model=6.0, clusters=3.0, reported=0.9, is_same_choice=False),
        SplitHalfDraw("lidar", model=2.0, clusters=1.0, reported=0.7, is_same_choice=True),
        SplitHalfDraw("left", model=1.8, clusters=1.7, reported=1.7, is_same_choice=True),
    ]
}


def test_the_table_has_the_means_the_median_and_how_often_the_halves_chose_alike():
    section = build_split_half_section(DRAWS)
    assert "| yard, car | lidar | 2 | 4 | 2 | 0.8 | 0.8 | 1 of 2 |" in section.text
    assert "goal 0.5 to 1.5" in section.text


def test_a_mean_beyond_the_goal_is_missed_by_name():
    (missed,) = check_split_half_goals(DRAWS)
    assert missed == "split halves of yard, car: left has 1.7, goal 0.5 to 1.5"
