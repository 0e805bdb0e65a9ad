"""Setups of two sessions, made by formula."""

from dataclasses import replace

import numpy as np
import pytest

from calib.estimation.estimation_problem import Setup
from calib.geometry.se3 import se3_exp
from helpers import synthetic_setup
from helpers.synthetic_setup import SyntheticWorld, make_synthetic_setup

SESSION_LAYOUT = [("board", None)] * 8
SESSION_LIMITS = {
    "max_rounds": 40,
    "tolerance_m": 1e-7,
    "tolerance_rad": 1e-7,
    "initial_noise_factor": 100.0,
}
SENSOR_BUMP = se3_exp(np.array([0.004, 0.0, 0.003, 0.0, 0.01, 0.0]))


def make_two_sessions(moved=(), seeds=(0, 1)):
    """A Setup of two sessions; in the second the sensors of `moved` sit elsewhere by BUMP."""
    parts = []
    for session, seed in zip(("evening", "morning"), seeds, strict=True):
        with pytest.MonkeyPatch.context() as patch:
            if session == "morning":
                true = {
                    n: T @ SENSOR_BUMP if n in moved else T
                    for n, T in synthetic_setup.TRUE_POSES.items()
                }
                patch.setattr(synthetic_setup, "TRUE_POSES", true)
            parts.append((session, make_synthetic_setup(seed, SESSION_LAYOUT, SyntheticWorld())))
    places, groups = [], []
    for session, made in parts:
        groups += [replace(g, placement=g.placement + len(places)) for g in made.groups]
        places += [replace(p, session=session) for p in made.placements]
    return Setup(made.models, made.targets, places, groups, made.associate_options, {})
