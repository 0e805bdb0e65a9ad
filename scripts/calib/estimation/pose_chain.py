"""The chain of poses between sensors and targets; paper equation 1."""

from dataclasses import replace

import numpy as np

from calib.estimation import estimate_state
from calib.estimation.nlp.joint_nlp import Poses
from calib.geometry import se3
from calib.mocap.body_trajectory import NS

MARKERS = "markers"  # name of the correction that is where a session's MCS body of the robot sits


def model(setup, state, group):
    """The model of a group's sensor with the corrections that touch the group."""
    out = setup.models[group.sensor]
    for h, at in setup.spans:
        if h.touches(setup, group):
            out = h.mended(out, state.theta[at], group.placement)
    return out


def T_robot_body(setup, state, k):
    """T_robot_body (4, 4) of placement k, as measured."""
    place = setup.placements[k]
    T = place.T_robot_body if place.moving is None else estimate_state.fit_of(setup, state, k).T
    theta = estimate_state.number_of(setup, state, MARKERS, place.session)
    return T if theta is None else se3.se3_exp(theta) @ T


def T_body_target(setup, state, k):
    """(4, 4) in placement k, estimated or as configured, with the error of a view in motion."""
    place = setup.placements[k]
    T = state.mounts.get(place.target, place.T_body_target)
    return T if k < setup.still else T @ se3.se3_exp(state.wander[k - setup.still])


def T_robot_target(setup, state, k):
    """T_robot_target (4, 4) in placement k with the current MCS errors; equation 1."""
    T = T_robot_body(setup, state, k)
    at = [setup.robots[k], setup.bodies[k]]
    robot, body = se3.se3_exp(state.mocap * setup.sigma[at] * state.y[at])
    return se3.inverse(robot) @ T @ body @ T_body_target(setup, state, k)


def T_sensor_target(setup, state, sensor, k):
    """T_sensor_target (4, 4) of placement k with the current MCS errors; equation 1."""
    return se3.inverse(state.T_robot_sensor[sensor]) @ T_robot_target(setup, state, k)


def frozen(setup, state, group):
    """The group, with returns of a target in motion taken to where it was at the view's own t."""
    moving = setup.placements[group.placement].moving
    k = group.keypoints
    if moving is None or not (k["t"] != moving.t).any():
        return group
    there, T = (
        estimate_state.fit_of(setup, state, group.placement),
        state.T_robot_sensor[group.sensor],
    )
    xyz = there.frozen(k["xyz"], (k["t"] - moving.t) / NS, T)
    return replace(group, keypoints=k | {"xyz": xyz})


def spread(setup, state, group):
    """(6, 6) covariance of what the MCS errs by in one view in motion alone, about the right
    perturbation of T_sensor_target; None of a placement, all of whose errors are unknowns."""
    place = setup.placements[group.placement]
    if place.moving is None:
        return None
    S = np.diag((state.mocap * place.moving.sigma) ** 2)
    to_body = se3.adjoint(se3.inverse(T_robot_body(setup, state, group.placement)))
    to_target = se3.adjoint(se3.inverse(state.mounts.get(place.target, place.T_body_target)))
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
            mean[at] = se3.se3_log(se3.inverse(T) @ now)
            weight[at] = 1 / sigma
    return mean, weight


def unknowns(setup, state):
    """x (n,) where the State stands, twists from there, and the scale (n,) of each in SI."""
    x = np.zeros(setup.poses), state.y.reshape(-1), state.theta / setup.theta_sigma
    scale = np.ones(setup.poses), state.mocap * setup.sigma.reshape(-1), setup.theta_sigma
    return np.concatenate(x), np.concatenate(scale)
