"""A sensor's clock against that of the MCS: t_mcs = stamp + offset."""

from functools import partial

import numpy as np

from calib import chain, geometry
from calib.hypothesis import Hypothesis

SECOND = 1e-6  # step of a finite difference


def clock(name, sigma):
    """The Hypothesis of a sensor's offset, s, with the σ of its prior, s."""
    remedy = f"nothing: the offset of {name} is estimated; its driver may be told of it"
    return Hypothesis(
        chain.CLOCK, name, True, (), 1, _by_offset, partial(_told, name), remedy,
        np.array([sigma]), lambda model, theta, placement: model, moving=True,
    )  # fmt: skip


def _by_offset(view):
    """(1, k, n): what a later look at the MCS does to the residuals of a view in motion."""
    g, state = view.group, view.state
    T_body_target = chain.T_body_target(view.setup, state, g.placement)
    there = chain.fit_of(view.setup, state, g.placement)
    eta = geometry.adjoint(geometry.inverse(T_body_target)) @ there.velocity
    ahead = view.changed(T_sensor_target=view.T_sensor_target @ geometry.se3_exp(SECOND * eta))
    return (ahead - view.assigned.standard.T)[None] / SECOND


def _told(name, theta, sigma):
    return f"the stamps of {name} are {1e3 * theta[0]:.2f} ± {1e3 * sigma[0]:.2f} ms early"
