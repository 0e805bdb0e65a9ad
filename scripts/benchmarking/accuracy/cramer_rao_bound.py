"""Reference accuracy: how well the very data in use could tell a pose, were all noise known.

The information of every measurement is taken at the true poses with the true noise, the errors of
the MCS poses are marginalised, one per body and rest, and the inverse is the covariance of an
efficient estimator. All scans of a placement count, but where a scan line leaves a target counts
once, as uniform between two beams (step²/12), which an interval estimator may beat. That holds for
the outline of a board and for the sides of a cylinder. No robust loss.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from calib.estimation.estimate_state import State, initial_state
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.estimation.measurement_assignment import assign_measurements
from calib.estimation.nlp.information_matrix import covariance_from_information
from calib.estimation.nlp.symbolic_chain import make_residual_function
from calib.estimation.noise_estimation import split_common_noise
from calib.estimation.residuals import cylinder_limb
from calib.estimation.residuals.assignment import Assignment, Noise
from calib.estimation.residuals.board_outline import MIN_SCAN_ANGLE_SINE, MIN_VERTEX_DISTANCE_M
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.round_solution import build_nlp, linearize_measurements
from calib.geometry.se3 import so3_exp
from calib.sensors.lidar.lidar_model import LidarModel
from calib.targets.cylinder import Cylinder

MIN_TRUE_SIGMA = 1e-9  # m, rad: stands for none, so that a prior may be divided by it
N_NOISE_ROUNDS = 5
MAX_TANGENT_MISS_STEPS = (
    1.5  # steps of the scan pattern by which the ray of a side's crossing may miss it
)


@dataclass(frozen=True)
class CramerRaoBound:
    """By sensor the covariance (6, 6), and the one without where scan lines leave the targets; by
    (sensor, kind) the σ of one measurement."""

    covariance: dict[str, np.ndarray]
    covariance_without_outlines: dict[str, np.ndarray]
    measurement_sigma: dict[tuple[str, str], float]


def compute_cramer_rao_bound(
    setup: Setup, T_robot_sensor: dict[str, ndarray], range_sigma_m: float
) -> CramerRaoBound:
    """The Reference of a Setup.

    T_robot_sensor by name is the true one, range_sigma, m, too, and so is the σ of the setup's
    placements. The noise of what a camera finds is taken from its own errors at the truth.
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
    """The σ that keypoints came with: their median."""
    return float(np.median(np.concatenate([g.keypoints["sigma"] for g in groups])))


def estimate_true_noise(
    setup: Setup, state: State, range_sigma_m: float
) -> dict[tuple[str, str], Noise]:
    """Noise over the keypoints' own σ, by (sensor, kind).

    Ranges: as given. What is found in images: of its errors at the truth, of all that belongs to a
    target there, with what all images of a placement have in common. Where scan lines leave a
    target: the step, the same in every scan.
    """
    known = dict(state.noise)
    for key in known:
        kind, groups = RESIDUAL_KINDS[key[1]], _select_groups(setup, key)
        if kind.UNIT == "m":
            known[key] = Noise(
                max(range_sigma_m, MIN_TRUE_SIGMA) / _median_keypoint_sigma(groups), 0.0
            )
        elif kind.MIN_SIGMA is not None:
            known[key] = _image_noise(replace(setup, groups=groups), state, key)
    return known


def _image_noise(setup: Setup, state: State, noise_key: tuple[str, str]) -> Noise:
    """Noise of the errors at the truth: their rms per component, members by that very σ."""
    known = {noise_key: Noise(10.0, 0.0)}
    for _ in range(N_NOISE_ROUNDS):
        assigned = assign_measurements(setup, replace(state, noise=state.noise | known))
        values = np.concatenate([a.residual_over_sigma0[a.feature >= 0] for a in assigned])
        if not len(values):
            return known[noise_key]
        known[noise_key] = Noise(float(np.sqrt(np.mean(values**2))), 0.0)
    return split_common_noise(setup, assigned, known, {noise_key: 0.0})[noise_key]


def compute_true_information(setup: Setup, state: State) -> tuple[ndarray, ndarray]:
    """(n, n), twice, of all unknowns of the estimate: of what lies on the targets, with the priors
    of the MCS, and of where scan lines leave the targets."""
    assigned = assign_measurements(setup, state)
    parts = linearize_measurements(setup, build_nlp(setup), state, assigned)
    inside, outlines = np.zeros((2, setup.n_unknowns, setup.n_unknowns))
    np.fill_diagonal(inside[setup.n_pose_unknowns :, setup.n_pose_unknowns :], 1.0)
    for g, a, p in zip(setup.groups, assigned, parts, strict=True):
        model, target = setup.models[g.sensor], setup.targets[setup.placements[g.placement].target]
        square = np.ix_(p.columns, p.columns)
        weight = np.where(a.feature >= 0, a.effective_weight, 0.0)
        own = sum((weight * J) @ J.T for J in p.J_pose)
        (outlines if g.kind == "board_outline" else inside)[square] += (
            p.dpose_dx.T @ own @ p.dpose_dx
        )
        if g.kind == "target_surface" and isinstance(target, Cylinder):
            sides = cylinder_side_information(
                model, target, p.T_sensor_target, outermost_rays(g, a, model)
            )
            outlines[square] += p.dpose_dx.T @ sides @ p.dpose_dx
    return inside, outlines


def outermost_rays(
    group: MeasurementGroup, assignment: Assignment, lidar: LidarModel
) -> np.ndarray:
    """Rays (2 n, 3), lidar frame, half a step beyond the first and last return of each of n rings,
    all scans of the placement together."""
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
    """(6, 6) of the rays (n, 3) among those given that touch a cylinder's side, about the right
    perturbation of T_sensor_target."""
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
    kernel = make_residual_function(
        cylinder_limb.residual(lidar, target), len(cylinder_limb.DATA_COLUMNS)
    )
    every = kernel.map("every", "serial", data.shape[1], [0], [])
    J = np.array(every(T_sensor_target[:3], data)[1]).reshape(-1, 6)
    return J.T @ J
