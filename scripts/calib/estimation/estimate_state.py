"""The estimate: poses, mounts, motion capture errors, noise and corrections."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimation.corrections.base import ClockCorrection
from calib.estimation.estimation_problem import Placement, Setup
from calib.estimation.noise.noise_model import NoiseKey, initial_noise, noise_key
from calib.estimation.residuals.assignment import Noise
from calib.geometry.se3 import se3_exp
from calib.mocap.moving_pose_fit import LocalMotion

STREAM_LAG = "mocap_offset"  # name of the correction: lag of a target's poses behind the robot's


@dataclass(frozen=True)
class State:
    """The current estimate.

    T_robot_sensor, mounts: (4, 4) by sensor and by target; mocap_errors: (r, 6) in units of their
    σ; mocap_noise_factor: on that σ; correction_values: θ (p,), SI; moving_view_errors: (m, 6)
    right perturbations of T_sensor_target; local_motions: motion of the target in every moving
    view at the present time offsets.
    """

    T_robot_sensor: dict[str, np.ndarray]
    mounts: dict[str, np.ndarray]
    mocap_errors: np.ndarray
    noise: dict[NoiseKey, Noise]
    mocap_noise_factor: float = 1.0
    correction_values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    moving_view_errors: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    local_motions: list[LocalMotion] = field(default_factory=list)


def initial_state(
    setup: Setup, T_robot_sensor: dict[str, np.ndarray], noise_factor: float
) -> State:
    """Return the State at poses by sensor, without errors, at noise_factor times the set noise."""
    keys = sorted({noise_key(g) for g in setup.groups})
    theta = np.concatenate([np.zeros(0), *(c.initial_values for c in setup.corrections)])
    return State(
        T_robot_sensor=dict(T_robot_sensor),
        mounts=dict(setup.initial_mounts),
        mocap_errors=np.zeros_like(setup.mocap_sigma),
        noise={key: initial_noise(key[1], noise_factor) for key in keys},
        correction_values=theta,
        moving_view_errors=np.zeros((len(setup.placements) - setup.n_still, 6)),
        local_motions=fit_local_motions(setup, theta),
    )


def warm_start(
    setup: Setup, previous_setup: Setup, previous_state: State, noise_factor: float
) -> State:
    """Return the State that continues from the settled one of a smaller Setup.

    That has the same placements at rest, with fewer corrections or without moving views. What is
    new begins as in initial_state.
    """
    new = initial_state(setup, previous_state.T_robot_sensor, noise_factor)
    theta = new.correction_values.copy()
    for correction, part in setup.correction_slices:
        known = get_correction_values(
            previous_setup, previous_state, correction.name, correction.subject
        )
        theta[part] = theta[part] if known is None else known
    mounts, errors = previous_state.mounts, previous_state.mocap_errors
    views_are_known = len(previous_state.moving_view_errors) == len(new.moving_view_errors)
    return replace(
        new,
        mounts=new.mounts | {n: mounts[n] for n in setup.initial_mounts if n in mounts},
        mocap_errors=np.concatenate([errors, new.mocap_errors[len(errors) :]]),
        noise=new.noise | {k: v for k, v in previous_state.noise.items() if k in new.noise},
        mocap_noise_factor=previous_state.mocap_noise_factor,
        correction_values=theta,
        moving_view_errors=(
            previous_state.moving_view_errors if views_are_known else new.moving_view_errors
        ),
        local_motions=fit_local_motions(setup, theta),
    )


def fit_local_motions(setup: Setup, theta: np.ndarray) -> list[LocalMotion]:
    """Return the motion in every moving view, at its time offset and stream lag by θ (p,)."""
    return [
        p.moving_view.motion_at(*clock_delays(setup, theta, p))
        for p in setup.placements
        if p.moving_view is not None
    ]


def clock_delays(setup: Setup, theta: np.ndarray, placement: Placement) -> tuple[float, float]:
    """Return (time offset of the sensor, lag of the target's poses), s; 0 for a target at rest."""
    view = placement.moving_view
    if view is None:
        return 0.0, 0.0
    offset = 0.0
    for correction, part in setup.correction_slices:
        if isinstance(correction, ClockCorrection) and correction.subject == view.sensor:
            offset += correction.delay_s(theta[part], placement)
    lag = setup.correction_slice(STREAM_LAG, placement.target)
    return float(offset), 0.0 if lag is None else float(theta[lag][0])


def get_correction_values(setup: Setup, state: State, name: str, subject: str) -> np.ndarray | None:
    """Return the values (q,) of a correction, SI, or None if it is not estimated."""
    part = setup.correction_slice(name, subject)
    return None if part is None else state.correction_values[part]


def get_local_motion(setup: Setup, state: State, placement_index: int) -> LocalMotion:
    """Return the motion of the target in a moving view."""
    return state.local_motions[placement_index - setup.n_still]


def apply_step(setup: Setup, state: State, x: np.ndarray, moving_view_errors: np.ndarray) -> State:
    """Return the State at unknowns x (n,) and errors (m, 6) of moving views."""
    twists = se3_exp(x[: setup.n_pose_unknowns].reshape(-1, 6))
    sensors, mounts = sorted(setup.models), sorted(setup.initial_mounts)
    sensor_steps = zip(sensors, twists[: len(sensors)], strict=True)
    mount_steps = zip(mounts, twists[len(sensors) :], strict=True)
    theta = x[setup.n_chain_unknowns :] * setup.correction_sigma
    return replace(
        state,
        T_robot_sensor={n: state.T_robot_sensor[n] @ T for n, T in sensor_steps},
        mounts={n: state.mounts[n] @ T for n, T in mount_steps},
        mocap_errors=x[setup.n_pose_unknowns : setup.n_chain_unknowns].reshape(-1, 6),
        correction_values=theta,
        moving_view_errors=moving_view_errors,
        local_motions=fit_local_motions(setup, theta),
    )
