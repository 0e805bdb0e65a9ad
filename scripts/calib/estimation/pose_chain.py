"""The chain of poses between sensors and targets; paper equation 1."""

from dataclasses import replace

import numpy as np

from calib.estimation.corrections.base import ModelCorrection
from calib.estimation.estimate_state import get_correction_values, get_local_motion
from calib.estimation.nlp.joint_nlp import LinearizationPoses
from calib.geometry.se3 import adjoint, invert_pose, se3_exp, se3_log
from calib.geometry.units import NS_PER_S

ROBOT_MARKERS = (
    "markers"  # name of the correction that is where a session's MCS body of the robot sits
)


def model_with_corrections(setup, state, group):
    """The model of a group's sensor with the corrections that touch the group."""
    out = setup.models[group.sensor]
    for h, at in setup.correction_slices:
        if isinstance(h, ModelCorrection) and h.affects(setup, group):
            out = h.apply_to_model(out, state.correction_values[at], group.placement)
    return out


def T_robot_body(setup, state, placement_index):
    """T_robot_body (4, 4) of placement k, as measured."""
    place = setup.placements[placement_index]
    T = (
        place.T_robot_body
        if place.moving_view is None
        else get_local_motion(setup, state, placement_index).T_robot_body
    )
    theta = get_correction_values(setup, state, ROBOT_MARKERS, place.session)
    return T if theta is None else se3_exp(theta) @ T


def T_body_target(setup, state, placement_index):
    """(4, 4) in placement k, estimated or as configured, with the error of a view in motion."""
    place = setup.placements[placement_index]
    T = state.mounts.get(place.target, place.T_body_target)
    return (
        T
        if placement_index < setup.n_still
        else T @ se3_exp(state.moving_view_errors[placement_index - setup.n_still])
    )


def T_robot_target(setup, state, placement_index):
    """T_robot_target (4, 4) in placement k with the current MCS errors; equation 1."""
    T = T_robot_body(setup, state, placement_index)
    at = [setup.robot_error_index[placement_index], setup.body_error_index[placement_index]]
    robot, body = se3_exp(state.mocap_noise_factor * setup.mocap_sigma[at] * state.mocap_errors[at])
    return invert_pose(robot) @ T @ body @ T_body_target(setup, state, placement_index)


def T_sensor_target(setup, state, sensor, placement_index):
    """T_sensor_target (4, 4) of placement k with the current MCS errors; equation 1."""
    return invert_pose(state.T_robot_sensor[sensor]) @ T_robot_target(setup, state, placement_index)


def deskew_group(setup, state, group):
    """The group, with returns of a target in motion taken to where it was at the view's own t."""
    moving = setup.placements[group.placement].moving_view
    k = group.keypoints
    if moving is None or not (k["stamp_ns"] != moving.stamp_ns).any():
        return group
    there, T = (
        get_local_motion(setup, state, group.placement),
        state.T_robot_sensor[group.sensor],
    )
    xyz = there.deskew(k["xyz"], (k["stamp_ns"] - moving.stamp_ns) / NS_PER_S, T)
    return replace(group, keypoints=k | {"xyz": xyz})


def moving_view_covariance(setup, state, group):
    """(6, 6) covariance of what the MCS errs by in one view in motion alone, about the right
    perturbation of T_sensor_target; None of a placement, all of whose errors are unknowns."""
    place = setup.placements[group.placement]
    if place.moving_view is None:
        return None
    S = np.diag((state.mocap_noise_factor * place.moving_view.sigma) ** 2)
    to_body = adjoint(invert_pose(T_robot_body(setup, state, group.placement)))
    to_target = adjoint(invert_pose(state.mounts.get(place.target, place.T_body_target)))
    return to_target @ (S + to_body @ S @ to_body.T) @ to_target.T


def chain_unknown_columns(setup, group):
    """Unknowns (24,) of a group's chain: its sensor, the mount, the robot's and the body's MCS
    pose; the number of all of these stands for a mount that is not estimated."""
    sensors, mounts = sorted(setup.models), sorted(setup.initial_mounts)
    target = setup.placements[group.placement].target
    starts = [6 * sensors.index(group.sensor)]
    starts += [6 * (len(sensors) + mounts.index(target))] if target in mounts else [None]
    poses = setup.robot_error_index[group.placement], setup.body_error_index[group.placement]
    starts += [setup.n_pose_unknowns + 6 * i for i in poses]
    six = np.arange(6)
    return np.concatenate(
        [np.full(6, setup.n_chain_unknowns) if s is None else s + six for s in starts]
    )


def linearization_poses(setup, state):
    """Poses of every group's chain; MCS errors apart."""
    at = [g.placement for g in setup.groups]
    return LinearizationPoses(
        np.stack([state.T_robot_sensor[g.sensor] for g in setup.groups]),
        np.stack([T_robot_body(setup, state, k) for k in at]),
        np.stack([T_body_target(setup, state, k) for k in at]),
    )


def prior_means_and_weights(setup, state):
    """Means and weights (n,) of the unknowns, from where they stand now."""
    mean, weight = np.zeros(setup.n_unknowns), np.ones(setup.n_unknowns)
    weight[: setup.n_pose_unknowns] = 0
    known = [
        (*setup.sensor_priors.get(n, (None, 0)), state.T_robot_sensor[n])
        for n in sorted(setup.models)
    ]
    known += [
        (
            setup.initial_mounts[n] if n in setup.mount_sigma else None,
            setup.mount_sigma.get(n),
            state.mounts[n],
        )
        for n in sorted(setup.initial_mounts)
    ]
    for i, (T, sigma, now) in enumerate(known):
        if T is not None:
            at = slice(6 * i, 6 * i + 6)
            mean[at] = se3_log(invert_pose(T) @ now)
            weight[at] = 1 / sigma
    return mean, weight


def pack_unknowns(setup, state):
    """x (n,) where the State stands, twists from there, and the scale (n,) of each in SI."""
    x = (
        np.zeros(setup.n_pose_unknowns),
        state.mocap_errors.reshape(-1),
        state.correction_values / setup.correction_sigma,
    )
    scale = (
        np.ones(setup.n_pose_unknowns),
        state.mocap_noise_factor * setup.mocap_sigma.reshape(-1),
        setup.correction_sigma,
    )
    return np.concatenate(x), np.concatenate(scale)
