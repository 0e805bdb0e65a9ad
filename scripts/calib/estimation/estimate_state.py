"""The estimate: poses, mounts, errors of the motion capture, noise, corrections."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation import noise_model
from calib.geometry import se3

STREAM = "mocap_offset"  # likewise of how late the clock of a target's poses is against the robot's


@dataclass
class State:
    """Current estimate: poses by sensor, mounts by target, MCS errors (r, 6) in units of σ, Noise
    by (sensor, kind), factor on the σ of the MCS, numbers θ (p,) of the corrections, SI, and
    errors (m, 6) of the poses of views in motion, right perturbations of T_sensor_target, and their
    motion.Fit at the present offsets."""

    T_robot_sensor: dict
    mounts: dict
    y: np.ndarray
    noise: dict
    mocap: float = 1.0
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    wander: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    fits: list = field(default_factory=list)


def start(setup, T_robot_sensor, factor):
    """The State from poses by sensor: no MCS error, `factor` times the configured noise."""
    keys = sorted({noise_model.of(g) for g in setup.groups})
    scales = {key: noise_model.initial(key[1], factor) for key in keys}
    y, begun = np.zeros_like(setup.sigma), [h.start for h in setup.corrections]
    theta = [
        np.zeros(h.size) if v is None else v for h, v in zip(setup.corrections, begun, strict=True)
    ]
    theta = np.concatenate([np.zeros(0), *theta])
    wander = np.zeros((len(setup.placements) - setup.still, 6))
    fits = followed(setup, theta)
    return State(dict(T_robot_sensor), dict(setup.mounts), y, scales, 1.0, theta, wander, fits)


def carried(setup, before, factor):
    """The State from where another Setup of the same still placements, with less to estimate or
    without views in motion, has settled: before, (Setup, State). What is new is as at the start."""
    old, state = before
    new = start(setup, state.T_robot_sensor, factor)
    theta = new.theta.copy()
    for h, at in setup.spans:
        known = number_of(old, state, h.name, h.of)
        theta[at] = theta[at] if known is None else known
    return replace(
        new,
        mounts=new.mounts | {n: state.mounts[n] for n in setup.mounts if n in state.mounts},
        y=np.concatenate([state.y, new.y[len(state.y) :]]),
        noise=new.noise | {k: v for k, v in state.noise.items() if k in new.noise},
        mocap=state.mocap,
        theta=theta,
        wander=state.wander if len(state.wander) == len(new.wander) else new.wander,
        fits=followed(setup, theta),
    )


def followed(setup, theta):
    """The motion.Fit of every view in motion at its offset and lag, by θ (p,)."""
    return [p.moving.at(*late(setup, theta, p)) for p in setup.placements[setup.still :]]


def late(setup, theta, place):
    """(offset of the sensor's clock, lag of the target's poses), s, in a view in motion."""
    delays = [(h, at) for h, at in setup.spans if h.delay and h.of == place.moving.sensor]
    lag = setup.span(STREAM, place.target)
    offset = sum(h.delay(theta[at], place) for h, at in delays)
    return float(offset), 0.0 if lag is None else float(theta[lag][0])


def number_of(setup, state, name, of):
    """θ (size,) of the correction of that name, or None where there is none."""
    at = setup.span(name, of)
    return None if at is None else state.theta[at]


def fit_of(setup, state, k):
    """The motion.Fit of view k in motion."""
    return state.fits[k - setup.still]


def moved(setup, state, x, wander):
    """The State at unknowns x (n,) and errors (m, 6) of views in motion."""
    twists = se3.se3_exp(x[: setup.poses].reshape(-1, 6))
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    return State(
        {n: state.T_robot_sensor[n] @ T for n, T in zip(sensors, twists, strict=False)},
        {n: state.mounts[n] @ T for n, T in zip(mounts, twists[len(sensors) :], strict=True)},
        x[setup.poses : setup.chained].reshape(-1, 6),
        state.noise,
        state.mocap,
        x[setup.chained :] * setup.theta_sigma,
        wander,
        followed(setup, x[setup.chained :] * setup.theta_sigma),
    )
