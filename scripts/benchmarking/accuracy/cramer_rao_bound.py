"""Reference accuracy: the best accuracy that the same data allow if all noise is known.

The information of all measurements is computed at the true poses with the true noise. MCS errors,
one per body and placement, are marginalised. The inverse is the covariance of an efficient
estimator. Returns of all scans of a placement count. A point where a scan line leaves a target (the
outline of a board, the side of a cylinder) counts once per placement, with an error uniform between
two beams (variance step²/12); an interval estimator can be better than that. No robust loss.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from calib.estimation.estimate_state import State, initial_state
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.nlp.symbolic_chain import make_residual_function
from calib.estimation.noise.noise_estimation import split_common_noise
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.board_outline import MIN_SCAN_ANGLE_SINE, MIN_VERTEX_DISTANCE_M
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.round_solution import build_nlp, linearize_measurements
from calib.geometry.se3 import so3_exp
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.cylinder import Cylinder

MIN_TRUE_SIGMA = 1e-9  # m, rad: used instead of 0, because priors are divided by it
N_NOISE_ROUNDS = 5
# Distance, in steps of the scan pattern, at which a ray still counts as touching a cylinder's side.
MAX_TANGENT_MISS_STEPS = 1.5


@dataclass(frozen=True)
class CramerRaoBound:
    """The reference accuracy of a setup.

    covariance: (6, 6) by sensor; covariance_without_outlines: the same from returns, corners and
    contour points alone, without outline crossings; measurement_sigma: σ of one measurement by
    (sensor, kind).
    """

    covariance: dict[str, np.ndarray]
    covariance_without_outlines: dict[str, np.ndarray]
    measurement_sigma: dict[tuple[str, str], float]


def compute_cramer_rao_bound(
    setup: Setup, T_robot_sensor: dict[str, ndarray], range_sigma_m: float
) -> CramerRaoBound:
    """Compute the reference accuracy of a setup.

    T_robot_sensor: true poses (4, 4) by sensor; range_sigma_m: true noise of a range. The MCS
    noise of the setup's placements must be the true one. The noise of image measurements is
    estimated from their errors at the true poses.
    """
    state = initial_state(setup, T_robot_sensor, 1.0)
    state = replace(state, noise=estimate_true_noise(setup, state, range_sigma_m))
    inside, outlines = compute_true_information(setup, state)
    return CramerRaoBound(
        covariance=_sensor_covariances(setup, inside + outlines),
        covariance_without_outlines=_sensor_covariances(setup, inside),
        measurement_sigma={
            key: n.total * _median_keypoint_sigma(_select_groups(setup, key))
            for key, n in state.noise.items()
        },
    )


def _sensor_covariances(setup: Setup, information: ndarray) -> dict[str, ndarray]:
    whole = covariance_from_information(information)
    names = sorted(setup.models)
    return {n: whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i, n in enumerate(names)}


def _select_groups(setup: Setup, noise_key: tuple[str, str]) -> list[MeasurementGroup]:
    return [g for g in setup.groups if (g.sensor, g.kind) == noise_key]


def _median_keypoint_sigma(groups: list[MeasurementGroup]) -> float:
    """Return the median of the σ of the keypoints."""
    return float(np.median(np.concatenate([g.keypoints["sigma"] for g in groups])))


def estimate_true_noise(
    setup: Setup, state: State, range_sigma_m: float
) -> dict[tuple[str, str], Noise]:
    """Return the true noise, as a factor on the σ of the keypoints, by (sensor, kind).

    Ranges: range_sigma_m. Image measurements: their RMS error at the true poses, split into the
    part common to all images of a placement and the rest. Outline crossings: unchanged.
    """
    noise = dict(state.noise)
    for key in noise:
        kind, groups = RESIDUAL_KINDS[key[1]], _select_groups(setup, key)
        if kind.UNIT == "m":
            noise[key] = Noise(
                max(range_sigma_m, MIN_TRUE_SIGMA) / _median_keypoint_sigma(groups), 0.0
            )
        elif kind.MIN_SIGMA is not None:
            noise[key] = _image_noise(replace(setup, groups=groups), state, key)
    return noise


def _image_noise(setup: Setup, state: State, noise_key: tuple[str, str]) -> Noise:
    """Return the RMS error per component at the true poses.

    Inliers depend on the noise, so both are repeated N_NOISE_ROUNDS times.
    """
    noise = {noise_key: Noise(10.0, 0.0)}
    for _ in range(N_NOISE_ROUNDS):
        assigned = assign_measurements(setup, replace(state, noise=state.noise | noise))
        values = np.concatenate([a.residual_over_sigma0[a.feature >= 0] for a in assigned])
        if not len(values):
            return noise[noise_key]
        noise[noise_key] = Noise(float(np.sqrt(np.mean(values**2))), 0.0)
    return split_common_noise(setup, assigned, noise, {noise_key: 0.0})[noise_key]


def compute_true_information(setup: Setup, state: State) -> tuple[ndarray, ndarray]:
    """Return two information matrices (n, n) of all unknowns of the estimate.

    The first is of measurements on the targets, with the MCS priors; the second of the points
    where scan lines leave the targets.
    """
    assigned = assign_measurements(setup, state)
    parts = linearize_measurements(setup, build_nlp(setup), state, assigned)
    inside, outlines = np.zeros((2, setup.n_unknowns, setup.n_unknowns))
    np.fill_diagonal(inside[setup.n_pose_unknowns :, setup.n_pose_unknowns :], 1.0)
    for g, a, p in zip(setup.groups, assigned, parts, strict=True):
        model, target = setup.models[g.sensor], setup.targets[setup.placements[g.placement].target]
        square = np.ix_(p.columns, p.columns)
        weight = np.where(a.feature >= 0, a.effective_weight, 0.0)
        information = sum((weight * J) @ J.T for J in p.J_pose)
        (outlines if g.kind == "board_outline" else inside)[square] += (
            p.dpose_dx.T @ information @ p.dpose_dx
        )
        if (
            g.kind == "target_surface"
            and isinstance(target, Cylinder)
            and isinstance(model, LidarModel)
        ):
            sides = cylinder_side_information(
                model, target, p.T_sensor_target, outermost_rays(g, a, model)
            )
            outlines[square] += p.dpose_dx.T @ sides @ p.dpose_dx
    return inside, outlines


def outermost_rays(
    group: MeasurementGroup, assignment: Assignment, lidar: LidarModel
) -> np.ndarray:
    """Return the rays (2 n, 3), lidar frame, half a step outside the first and last return of each
    of n rings, over all scans of the placement."""
    k, member = group.keypoints, assignment.feature >= 0
    middle = np.arctan2(*k["xyz"][member].mean(0)[1::-1]) if member.any() else 0.0
    azimuth = (np.arctan2(*k["xyz"].T[1::-1]) - middle + np.pi) % (2 * np.pi)
    rays = []
    for ring in np.unique(k["feature_index"][assignment.is_candidate]):
        rows = np.flatnonzero(k["feature_index"] == ring)
        for at, way in ((azimuth[rows].argmin(), -1), (azimuth[rows].argmax(), 1)):
            turn = so3_exp([0.0, 0.0, way * lidar.azimuth_step / 2])
            rays.append(turn @ k["xyz"][rows[at]])
    stacked = np.reshape(rays, (-1, 3))
    return stacked / np.linalg.norm(stacked, axis=1)[:, None]


def cylinder_side_information(
    lidar: LidarModel, target: Cylinder, T_sensor_target: np.ndarray, rays: np.ndarray
) -> np.ndarray:
    """Return the information (6, 6) of those rays that touch the side of a cylinder.

    rays: (n, 3), lidar frame. The matrix is for the right perturbation of T_sensor_target.
    """
    axis, centre = T_sensor_target[:3, 0], T_sensor_target[:3, 3]
    normal = np.cross(axis, rays)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    across = np.cross(normal, axis)
    depth = (across @ centre) / np.sum(across * rays, 1)
    along = np.abs(rays @ axis * depth - centre @ axis)
    miss = np.abs(np.abs(normal @ centre) - target.radius)
    turning = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], rays), 1))
    rows = (miss < MAX_TANGENT_MISS_STEPS * lidar.azimuth_step * depth) & (
        turning > MIN_SCAN_ANGLE_SINE
    )
    rows &= along < target.length / 2 - MIN_VERTEX_DISTANCE_M
    sigma = lidar.azimuth_step / np.sqrt(12) * turning * depth
    side, one = np.sign(normal @ centre), np.ones(len(rays))
    data = np.column_stack([rays, side, one, 1 / sigma])[rows].T
    if not rows.any():
        return np.zeros((6, 6))
    limb = RESIDUAL_KINDS["cylinder_limb"]
    kernel = make_residual_function(limb.residual(lidar, target), len(limb.DATA_COLUMNS))
    every = kernel.map("every", "serial", data.shape[1], [0], [])
    J = np.array(every(T_sensor_target[:3], data)[1]).reshape(-1, 6)
    return J.T @ J
