"""Preflight refuses what a run refuses, for the same reason, and counts the same placements.

`make preflight-agreement` compares them on 200 configs.
"""

import pytest

import solve
from helpers.preflight_configs import (
    DEFAULT_CHOICES,
    compare_choices,
    draw_choices,
    require_agreement,
    simulate_both_logs,
)

N_CONFIGS = 40
FAST_CONFIGS = {
    "images of another size": {"size_px": [1280, 960]},
    "an unknown mount and rotations about one axis": {
        "upright": True, "mount": "unknown", "targets": ["board"], "camera_pose": True,
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """The logs of a robot and targets that turn about all axes, and about the vertical only."""
    return simulate_both_logs(tmp_path_factory.mktemp("agreement"))


@pytest.fixture
def compare(logs, tmp_path, monkeypatch):
    """A function that compares preflight and run on a config of these choices."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(solve, "find_best_views", lambda *arguments: {})  # slow, decides nothing
    return lambda **choices: compare_choices(tmp_path / "run", logs, DEFAULT_CHOICES | choices)


@pytest.mark.pipeline
@pytest.mark.parametrize("choices", FAST_CONFIGS.values(), ids=FAST_CONFIGS)
def test_preflight_and_run_refuse_the_same_sensor_for_the_same_reason(compare, choices):
    outcomes = compare(**choices)
    assert outcomes.preflight["camera"].is_refused
    require_agreement(outcomes)


@pytest.mark.slow
@pytest.mark.pipeline
@pytest.mark.parametrize("seed", range(N_CONFIGS))
def test_preflight_and_run_agree_on_random_configs(compare, seed):
    require_agreement(compare(**draw_choices(seed)))


def test_random_configs_are_of_every_kind():
    drawn = [draw_choices(seed) for seed in range(N_CONFIGS)]
    for key, default in DEFAULT_CHOICES.items():
        assert len({str(choices[key]) for choices in drawn}) >= 2, (key, default)
