"""The chain of poses between sensors and targets; paper equation 1."""

from dataclasses import replace
from typing import Any

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, TargetModelCorrection
from calib.estimation.estimate_state import State, get_correction_values, get_local_motion
from calib.estimation.estimation_problem import MeasurementGroup, SensorModel, Setup
from calib.estimation.nlp.joint_nlp import LinearizationPoses
from calib.geometry.se3 import adjoint, invert_pose, make_pose, se3_exp, se3_log
from calib.geometry.units import NS_PER_S

ROBOT_MARKERS = "markers"  # name of the correction: pose of a session's robot markers
MOCAP_SCALE = "mocap_scale"  # name of the correction: error of a session's distances


def model_with_corrections(setup: Setup, state: State, group: MeasurementGroup) -> SensorModel:
    """Return the model of a group's sensor with the corrections that affect the group."""
    model = setup.models[group.sensor]
    for correction, part in setup.correction_slices:
        if isinstance(correction, ModelCorrection) and correction.affects(setup, group):
            values = state.correction_values[part]
            model = correction.apply_to_model(model, values, group.placement)
    return model


def target_with_corrections(setup: Setup, state: State, target: str) -> Any:
    """Return the shape of a target, by its name, with its corrections."""
    shape = setup.targets[target]
    for correction, part in setup.correction_slices:
        if isinstance(correction, TargetModelCorrection) and correction.subject == target:
            shape = correction.apply_to_target(shape, state.correction_values[part])
    return shape


def T_robot_body(setup: Setup, state: State, placement_index: int) -> np.ndarray:
    """Return T_robot_body (4, 4) of a placement as measured, corrected for scale and markers."""
    place = setup.placements[placement_index]
    if place.moving_view is None:
        T = place.T_robot_body
    else:
        T = get_local_motion(setup, state, placement_index).T_robot_body
    scale = get_correction_values(setup, state, MOCAP_SCALE, place.session)
    if scale is not None:
        T = make_pose(T[:3, :3], T[:3, 3] / (1 + scale[0]))
    theta = get_correction_values(setup, state, ROBOT_MARKERS, place.session)
    return T if theta is None else se3_exp(theta) @ T


def robot_to_body_offset(setup: Setup, state: State, placement_index: int) -> np.ndarray:
    """Return from the robot's MCS body to the target's (3,), m, along the robot's axes."""
    T = T_robot_body(setup, state, placement_index)
    session = setup.placements[placement_index].session
    theta = get_correction_values(setup, state, ROBOT_MARKERS, session)
    return T[:3, 3] if theta is None else T[:3, 3] - se3_exp(theta)[:3, 3]


def T_body_target(setup: Setup, state: State, placement_index: int) -> np.ndarray:
    """Return T_body_target (4, 4), estimated or configured, with the error of a moving view."""
    place = setup.placements[placement_index]
    T = state.mounts.get(place.target, place.T_body_target)
    if placement_index < setup.n_still:
        return T
    return T @ se3_exp(state.moving_view_errors[placement_index - setup.n_still])


def T_robot_target(setup: Setup, state: State, placement_index: int) -> np.ndarray:
    """Return T_robot_target (4, 4) with the current motion capture errors; equation 1."""
    T = T_robot_body(setup, state, placement_index)
    rows = [setup.robot_error_index[placement_index], setup.body_error_index[placement_index]]
    sigma = state.mocap_noise_factor * setup.mocap_sigma[rows]
    robot_error, body_error = se3_exp(sigma * state.mocap_errors[rows])
    mount = T_body_target(setup, state, placement_index)
    return invert_pose(robot_error) @ T @ body_error @ mount


def T_sensor_target(setup: Setup, state: State, sensor: str, placement_index: int) -> np.ndarray:
    """Return T_sensor_target (4, 4) with the current motion capture errors; equation 1."""
    return invert_pose(state.T_robot_sensor[sensor]) @ T_robot_target(setup, state, placement_index)


def deskew_group(setup: Setup, state: State, group: MeasurementGroup) -> MeasurementGroup:
    """Return the group with the points of a moving target shifted to the time of the view."""
    moving = setup.placements[group.placement].moving_view
    k = group.keypoints
    if moving is None or not (k["stamp_ns"] != moving.stamp_ns).any():
        return group
    motion = get_local_motion(setup, state, group.placement)
    delays_s = (k["stamp_ns"] - moving.stamp_ns) / NS_PER_S
    xyz = motion.deskew(k["xyz"], delays_s, state.T_robot_sensor[group.sensor])
    return replace(group, keypoints=k | {"xyz": xyz})


def moving_view_covariance(
    setup: Setup, state: State, group: MeasurementGroup
) -> np.ndarray | None:
    """Return the covariance (6, 6) of the motion capture error of one moving view alone.

    About the right perturbation of T_sensor_target. None at rest: all errors are unknowns then.
    """
    place = setup.placements[group.placement]
    if place.moving_view is None:
        return None
    S = np.diag((state.mocap_noise_factor * place.moving_view.sigma) ** 2)
    to_body = adjoint(invert_pose(T_robot_body(setup, state, group.placement)))
    to_target = adjoint(invert_pose(state.mounts.get(place.target, place.T_body_target)))
    return to_target @ (S + to_body @ S @ to_body.T) @ to_target.T


def chain_unknown_columns(setup: Setup, group: MeasurementGroup) -> np.ndarray:
    """Return the indices (24,) of the unknowns of a group's chain.

    In order: sensor, mount, error of the robot's pose, error of the body's pose. A mount that is
    not estimated has the index n_chain_unknowns.
    """
    sensors, mounts = sorted(setup.models), sorted(setup.initial_mounts)
    target = setup.placements[group.placement].target
    sensor_start = 6 * sensors.index(group.sensor)
    mount_start = 6 * (len(sensors) + mounts.index(target)) if target in mounts else None
    errors = setup.robot_error_index[group.placement], setup.body_error_index[group.placement]
    error_starts = [setup.n_pose_unknowns + 6 * i for i in errors]
    return np.concatenate(
        [
            np.full(6, setup.n_chain_unknowns) if start is None else start + np.arange(6)
            for start in (sensor_start, mount_start, *error_starts)
        ]
    )


def linearization_poses(setup: Setup, state: State) -> LinearizationPoses:
    """Return the poses of every group's chain, without motion capture errors."""
    index = [g.placement for g in setup.groups]
    return LinearizationPoses(
        T_robot_sensor=np.stack([state.T_robot_sensor[g.sensor] for g in setup.groups]),
        T_robot_body=np.stack([T_robot_body(setup, state, k) for k in index]),
        T_body_target=np.stack([T_body_target(setup, state, k) for k in index]),
    )


def prior_means_and_weights(setup: Setup, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return means and weights (n,) of the priors of the unknowns, from the current estimate.

    Twists count from the current poses: their mean is the twist from the prior's pose to there.
    """
    mean, weight = np.zeros(setup.n_unknowns), np.ones(setup.n_unknowns)
    weight[: setup.n_pose_unknowns] = 0
    sensors, mounts = sorted(setup.models), sorted(setup.initial_mounts)
    for i, name in enumerate(sensors):
        if name in setup.sensor_priors:
            T, sigma = setup.sensor_priors[name]
            rows = slice(6 * i, 6 * i + 6)
            mean[rows] = se3_log(invert_pose(T) @ state.T_robot_sensor[name])
            weight[rows] = 1 / sigma
    for i, name in enumerate(mounts, len(sensors)):
        if name in setup.mount_sigma:
            rows = slice(6 * i, 6 * i + 6)
            mean[rows] = se3_log(invert_pose(setup.initial_mounts[name]) @ state.mounts[name])
            weight[rows] = 1 / setup.mount_sigma[name]
    return mean, weight


def pack_unknowns(setup: Setup, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the unknowns x (n,) of the State, and the scale (n,) of each in SI.

    Twists count from the current poses: they are zero.
    """
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
