"""The estimate: poses, mounts, errors of the motion capture, noise, corrections."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.corrections.base import ClockCorrection
from calib.estimation.noise_model import initial_noise, noise_key
from calib.geometry.se3 import se3_exp

STREAM_LAG = (
    "mocap_offset"  # likewise of how late the clock of a target's poses is against the robot's
)


@dataclass
class State:
    """Current estimate: poses by sensor, mounts by target, MCS errors (r, 6) in units of σ, Noise
    by (sensor, kind), factor on the σ of the MCS, numbers θ (p,) of the corrections, SI, and
    errors (m, 6) of the poses of views in motion, right perturbations of T_sensor_target, and their
    motion.Fit at the present offsets."""

    T_robot_sensor: dict
    mounts: dict
    mocap_errors: np.ndarray
    noise: dict
    mocap_noise_factor: float = 1.0
    correction_values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    moving_view_errors: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    local_motions: list = field(default_factory=list)


def initial_state(setup, T_robot_sensor, noise_factor):
    """The State from poses by sensor: no MCS error, `factor` times the configured noise."""
    keys = sorted({noise_key(g) for g in setup.groups})
    scales = {key: initial_noise(key[1], noise_factor) for key in keys}
    y = np.zeros_like(setup.mocap_sigma)
    theta = np.concatenate([np.zeros(0), *(h.initial_values for h in setup.corrections)])
    wander = np.zeros((len(setup.placements) - setup.n_still, 6))
    fits = fit_local_motions(setup, theta)
    return State(
        dict(T_robot_sensor), dict(setup.initial_mounts), y, scales, 1.0, theta, wander, fits
    )


def warm_start(setup, previous, factor):
    """The State from where another Setup of the same still placements, with less to estimate or
    without views in motion, has settled: before, (Setup, State). What is new is as at the start."""
    old, state = previous
    new = initial_state(setup, state.T_robot_sensor, factor)
    theta = new.correction_values.copy()
    for h, at in setup.correction_slices:
        known = get_correction_values(old, state, h.name, h.subject)
        theta[at] = theta[at] if known is None else known
    return replace(
        new,
        mounts=new.mounts | {n: state.mounts[n] for n in setup.initial_mounts if n in state.mounts},
        mocap_errors=np.concatenate(
            [state.mocap_errors, new.mocap_errors[len(state.mocap_errors) :]]
        ),
        noise=new.noise | {k: v for k, v in state.noise.items() if k in new.noise},
        mocap_noise_factor=state.mocap_noise_factor,
        correction_values=theta,
        moving_view_errors=state.moving_view_errors
        if len(state.moving_view_errors) == len(new.moving_view_errors)
        else new.moving_view_errors,
        local_motions=fit_local_motions(setup, theta),
    )


def fit_local_motions(setup, theta):
    """The motion.Fit of every view in motion at its offset and lag, by θ (p,)."""
    return [
        p.moving_view.motion_at(*clock_delays(setup, theta, p))
        for p in setup.placements[setup.n_still :]
    ]


def clock_delays(setup, theta, placement):
    """(offset of the sensor's clock, lag of the target's poses), s, in a view in motion."""
    offset = sum(
        h.delay_s(theta[at], placement)
        for h, at in setup.correction_slices
        if isinstance(h, ClockCorrection) and h.subject == placement.moving_view.sensor
    )
    lag = setup.correction_slice(STREAM_LAG, placement.target)
    return float(offset), 0.0 if lag is None else float(theta[lag][0])


def get_correction_values(setup, state, name, subject):
    """θ (size,) of the correction of that name, or None where there is none."""
    at = setup.correction_slice(name, subject)
    return None if at is None else state.correction_values[at]


def get_local_motion(setup, state, placement_index):
    """The motion.Fit of view k in motion."""
    return state.local_motions[placement_index - setup.n_still]


def apply_step(setup, state, x, moving_view_errors):
    """The State at unknowns x (n,) and errors (m, 6) of views in motion."""
    twists = se3_exp(x[: setup.n_pose_unknowns].reshape(-1, 6))
    sensors, mounts = sorted(setup.models), sorted(setup.initial_mounts)
    return State(
        {n: state.T_robot_sensor[n] @ T for n, T in zip(sensors, twists, strict=False)},
        {n: state.mounts[n] @ T for n, T in zip(mounts, twists[len(sensors) :], strict=True)},
        x[setup.n_pose_unknowns : setup.n_chain_unknowns].reshape(-1, 6),
        state.noise,
        state.mocap_noise_factor,
        x[setup.n_chain_unknowns :] * setup.correction_sigma,
        moving_view_errors,
        fit_local_motions(setup, x[setup.n_chain_unknowns :] * setup.correction_sigma),
    )
