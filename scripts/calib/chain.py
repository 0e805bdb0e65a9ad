"""What is estimated, and the chain of poses between sensors and targets; paper equation 1."""

from dataclasses import dataclass, field, replace

import numpy as np

from calib import geometry, noise
from calib.mocap import NS
from calib.problem import Poses

MARKERS = "markers"  # name of the correction that is where a session's MCS body of the robot sits
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
    keys = sorted({noise.of(g) for g in setup.groups})
    scales = {key: noise.initial(key[1], factor) for key in keys}
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


def model(setup, state, group):
    """The model of a group's sensor with the corrections that touch the group."""
    out = setup.models[group.sensor]
    for h, at in setup.spans:
        if h.touches(setup, group):
            out = h.mended(out, state.theta[at], group.placement)
    return out


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


def T_robot_body(setup, state, k):
    """T_robot_body (4, 4) of placement k, as measured."""
    place = setup.placements[k]
    T = place.T_robot_body if place.moving is None else fit_of(setup, state, k).T
    theta = number_of(setup, state, MARKERS, place.session)
    return T if theta is None else geometry.se3_exp(theta) @ T


def T_body_target(setup, state, k):
    """(4, 4) in placement k, estimated or as configured, with the error of a view in motion."""
    place = setup.placements[k]
    T = state.mounts.get(place.target, place.T_body_target)
    return T if k < setup.still else T @ geometry.se3_exp(state.wander[k - setup.still])


def T_robot_target(setup, state, k):
    """T_robot_target (4, 4) in placement k with the current MCS errors; equation 1."""
    T = T_robot_body(setup, state, k)
    at = [setup.robots[k], setup.bodies[k]]
    robot, body = geometry.se3_exp(state.mocap * setup.sigma[at] * state.y[at])
    return geometry.inverse(robot) @ T @ body @ T_body_target(setup, state, k)


def T_sensor_target(setup, state, sensor, k):
    """T_sensor_target (4, 4) of placement k with the current MCS errors; equation 1."""
    return geometry.inverse(state.T_robot_sensor[sensor]) @ T_robot_target(setup, state, k)


def frozen(setup, state, group):
    """The group, with returns of a target in motion taken to where it was at the view's own t."""
    moving = setup.placements[group.placement].moving
    k = group.keypoints
    if moving is None or not (k["t"] != moving.t).any():
        return group
    there, T = fit_of(setup, state, group.placement), state.T_robot_sensor[group.sensor]
    xyz = there.frozen(k["xyz"], (k["t"] - moving.t) / NS, T)
    return replace(group, keypoints=k | {"xyz": xyz})


def spread(setup, state, group):
    """(6, 6) covariance of what the MCS errs by in one view in motion alone, about the right
    perturbation of T_sensor_target; None of a placement, all of whose errors are unknowns."""
    place = setup.placements[group.placement]
    if place.moving is None:
        return None
    S = np.diag((state.mocap * place.moving.sigma) ** 2)
    to_body = geometry.adjoint(geometry.inverse(T_robot_body(setup, state, group.placement)))
    to_target = geometry.adjoint(
        geometry.inverse(state.mounts.get(place.target, place.T_body_target))
    )
    return to_target @ (S + to_body @ S @ to_body.T) @ to_target.T


def columns(setup, group):
    """Unknowns (24,) of a group's chain: its sensor, the mount, the robot's and the body's MCS
    pose; the number of all of these stands for a mount that is not estimated."""
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    target = setup.placements[group.placement].target
    starts = [6 * sensors.index(group.sensor)]
    starts += [6 * (len(sensors) + mounts.index(target))] if target in mounts else [None]
    poses = setup.robots[group.placement], setup.bodies[group.placement]
    starts += [setup.poses + 6 * i for i in poses]
    six = np.arange(6)
    return np.concatenate([np.full(6, setup.chained) if s is None else s + six for s in starts])


def chains(setup, state):
    """Poses of every group's chain; MCS errors apart."""
    at = [g.placement for g in setup.groups]
    return Poses(
        np.stack([state.T_robot_sensor[g.sensor] for g in setup.groups]),
        np.stack([T_robot_body(setup, state, k) for k in at]),
        np.stack([T_body_target(setup, state, k) for k in at]),
    )


def priors(setup, state):
    """Means and weights (n,) of the unknowns, from where they stand now."""
    mean, weight = np.zeros(setup.n), np.ones(setup.n)
    weight[: setup.poses] = 0
    known = [
        (*setup.prior.get(n, (None, 0)), state.T_robot_sensor[n]) for n in sorted(setup.models)
    ]
    known += [
        (setup.mounts[n] if n in setup.alignment else None, setup.alignment.get(n), state.mounts[n])
        for n in sorted(setup.mounts)
    ]
    for i, (T, sigma, now) in enumerate(known):
        if T is not None:
            at = slice(6 * i, 6 * i + 6)
            mean[at] = geometry.se3_log(geometry.inverse(T) @ now)
            weight[at] = 1 / sigma
    return mean, weight


def unknowns(setup, state):
    """x (n,) where the State stands, twists from there, and the scale (n,) of each in SI."""
    x = np.zeros(setup.poses), state.y.reshape(-1), state.theta / setup.theta_sigma
    scale = np.ones(setup.poses), state.mocap * setup.sigma.reshape(-1), setup.theta_sigma
    return np.concatenate(x), np.concatenate(scale)


def moved(setup, state, x, wander):
    """The State at unknowns x (n,) and errors (m, 6) of views in motion."""
    twists = geometry.se3_exp(x[: setup.poses].reshape(-1, 6))
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
