"""Sessions: poses repeat by their σ, and a sensor that moved between them is named."""

from dataclasses import replace

import numpy as np
import pytest

import synthetic
from calib.diagnosis.session_repeatability import repeatability_json
from calib.estimation.estimation_problem import Setup
from calib.estimation.solver import estimate_poses
from calib.geometry.se3 import se3_exp, se3_log
from synthetic import SyntheticWorld, make_synthetic_setup

LAYOUT = [("board", None)] * 8
LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 100.0,
}
BUMP = se3_exp(np.array([0.004, 0.0, 0.003, 0.0, 0.01, 0.0]))


def recorded(moved=(), seeds=(0, 1)):
    """A Setup of two sessions; in the second the sensors of `moved` sit elsewhere by BUMP."""
    parts = []
    for session, seed in zip(("evening", "morning"), seeds, strict=True):
        with pytest.MonkeyPatch.context() as patch:
            if session == "morning":
                true = {n: T @ BUMP if n in moved else T for n, T in synthetic.TRUE_POSES.items()}
                patch.setattr(synthetic, "TRUE_POSES", true)
            parts.append((session, make_synthetic_setup(seed, LAYOUT, SyntheticWorld())))
    places, groups = [], []
    for session, made in parts:
        groups += [replace(g, placement=g.placement + len(places)) for g in made.groups]
        places += [replace(p, session=session) for p in made.placements]
    return Setup(made.models, made.targets, places, groups, made.associate_options, {})


def told(made):
    start = {n: synthetic.TRUE_POSES[n] @ se3_exp(np.full(6, 0.003)) for n in made.models}
    result = estimate_poses(made, start, **LIMITS)
    return repeatability_json(made, result, **LIMITS)


def test_poses_of_sensors_that_stay_repeat_by_their_sigma():
    """Six pairs of sessions, two sensors each: chances spread as chances do."""
    chances = [
        row["chance"]
        for k in range(6)
        for row in told(recorded(seeds=(2 * k, 2 * k + 1)))
        if row["session"] == "evening"
    ]
    assert len(chances) == 12
    assert min(chances) > 1e-3 and 0.25 < np.mean(chances) < 0.75


def test_a_camera_that_was_bumped_between_sessions_is_told_from_a_lidar_that_was_not():
    rows = {(r["session"], r["sensor"]): r for r in told(recorded(moved=("camera",)))}
    assert rows["morning", "camera"]["chance"] < 1e-12
    assert rows["morning", "lidar"]["chance"] > 1e-3
    shift, sigma = (np.array(rows["morning", "camera"][k]) for k in ("shift", "sigma"))
    assert (np.abs(shift - se3_log(BUMP)) < 4 * sigma).all()
    np.testing.assert_allclose(shift, -np.array(rows["evening", "camera"]["shift"]), atol=1e-9)


def test_one_session_alone_says_nothing_of_repeating():
    made = recorded()
    alone = [replace(p, session="evening") for p in made.placements]
    assert told(replace(made, placements=alone)) == []


def test_a_session_without_a_sensor_is_no_matter():
    made = recorded()
    second = {i for i, p in enumerate(made.placements) if p.session == "morning"}
    groups = [g for g in made.groups if not (g.sensor == "camera" and g.placement in second)]
    rows = told(replace(made, groups=groups))
    assert {(r["session"], r["sensor"]) for r in rows} == {
        ("evening", "lidar"),
        ("morning", "lidar"),
    }
