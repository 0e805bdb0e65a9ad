"""The joint problem: all sensors, targets and placements in one nonlinear program.

    minimise over ξ, y, θ:
    Σ_i w_i ρ(|r_i(T_sensor_target, θ)|²) + ½ Σ_k |y_k|² + ½ Σ_s |(ξ_s+m_s)/p_s|² + ½ |θ|²

T_sensor_target depends on the twist ξ_s of the sensor, on the twist ξ_t of the target's mount where
it is estimated, and on two motion capture errors y of the placement, in units of their σ
(make_chain_function; paper equations 1 to 4). The error of a body's pose is shared by all scans,
images and sensors of the placement, that of the robot's pose by all targets that rest at the same
time. θ are the values of corrections, in units of the σ of their priors.

The measurements of a group depend on one pose and on θ. They are linearized there into a gradient
and a Gauss-Newton Hessian (a Factor); IPOPT then finds the poses of all chains, and θ, that
minimise the sum. The solver linearizes again at the solution until nothing changes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calib.estimation.nlp.casadi_vectorized import VectorizedFunction, vectorize_casadi_function
from calib.estimation.nlp.ipopt_solver import build_ipopt_solver
from calib.estimation.nlp.measurement_factor import Factor, joint_information
from calib.estimation.nlp.symbolic_chain import (
    make_chain_function,
    make_condensed_cost,
    make_residual_function,
)
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.residuals.robust_loss import tukey_cost
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel


@dataclass(frozen=True)
class FactorLayout:
    """One group of measurements, and the unknowns that they depend on.

    columns: (24,) of the chain (make_chain_function), n_chain_unknowns for those that are not
    estimated; correction_index: (q,) into θ.
    """

    sensor: str
    kind: str
    target: str
    columns: np.ndarray
    correction_index: np.ndarray


@dataclass(frozen=True)
class LinearizationPoses:
    """Poses (b, 4, 4) of every factor's chain: estimated, measured, and estimated or configured."""

    T_robot_sensor: np.ndarray
    T_robot_body: np.ndarray
    T_body_target: np.ndarray


class Prior(NamedTuple):
    """Priors of the unknowns, mean (n,) and weight (n,): cost ½ Σ (weight (x + mean))²."""

    mean: np.ndarray
    weight: np.ndarray


class ViewErrorPrior(NamedTuple):
    """Error of one moving view alone: covariance (6, 6) and current value (6,); None at rest."""

    covariance: np.ndarray | None
    value: np.ndarray | None


@dataclass(frozen=True)
class NlpSolution:
    """The unknowns x (n,) at the optimum, twists from the poses of the linearization."""

    x: np.ndarray
    n_iterations: int
    status: str
    has_converged: bool


class JointNlp:
    """The program for fixed factor layouts; measurements, poses and noise change per solution."""

    def __init__(
        self,
        *,
        models: dict[str, CameraModel | LidarModel],
        targets: dict,
        layouts: list[FactorLayout],
        n_chain_unknowns: int,
        n_correction_values: int,
    ) -> None:
        self.layouts, self.models, self.targets = layouts, dict(models), dict(targets)
        self.n_chain_unknowns, self.n_correction_values = n_chain_unknowns, n_correction_values
        self.residual_functions: dict[tuple[str, str, str], VectorizedFunction] = {}
        self.set_models(models, targets)
        self.columns = np.stack([layout.columns for layout in layouts])
        self.chain_function = make_chain_function().map(len(layouts))
        self.derivative_function = make_condensed_cost()[1].map(len(layouts))
        self.solver = build_ipopt_solver(self.columns, n_chain_unknowns, n_correction_values)

    def set_models(
        self, models: Mapping[str, CameraModel | LidarModel], targets: Mapping[str, Any]
    ) -> None:
        """Compute residuals with these models, by sensor, and shapes, by target, from now on.

        Those of other sensors and targets stay as they are.
        """
        self.models |= models
        self.targets |= targets
        for key in sorted({(b.kind, b.sensor, b.target) for b in self.layouts}):
            if key[1] in models or key[2] in targets:
                kind = RESIDUAL_KINDS[key[0]]
                residual = kind.residual(self.models[key[1]], self.targets[key[2]])
                kernel = make_residual_function(residual, len(kind.DATA_COLUMNS))
                self.residual_functions[key] = vectorize_casadi_function(kernel)

    def linearize(
        self,
        *,
        x: np.ndarray,
        scale: np.ndarray,
        poses: LinearizationPoses,
        assignments: Sequence[Assignment],
        correction_derivatives: Sequence[np.ndarray],
        view_error_priors: Sequence[ViewErrorPrior],
    ) -> list[Factor]:
        """Return a Factor per layout, at unknowns x (n,) in units of scale (n,).

        correction_derivatives: (q, k, n) per layout, of residuals in σ by θ in units of its scale.
        """
        n = len(self.layouts)
        inputs = self._chain_inputs(x, scale, poses)
        T = np.array(self.chain_function(*inputs)).reshape(3, n, 4).swapaxes(0, 1)
        no_cost = np.zeros((6, n)), np.zeros((6, 6 * n))
        derivatives = self.derivative_function(*inputs, np.hstack(list(T)), *no_cost)
        dpose_dx = np.array(derivatives[2]).reshape(6, n, 24)
        return [
            self._linearize_group(
                layout=layout,
                assignment=assignments[k],
                T_sensor_target=np.vstack([T[k], [0, 0, 0, 1]]),
                dpose_dx=dpose_dx[:, k],
                J_theta=correction_derivatives[k],
                view_error_prior=view_error_priors[k],
            )
            for k, layout in enumerate(self.layouts)
        ]

    def _linearize_group(
        self,
        *,
        layout: FactorLayout,
        assignment: Assignment,
        T_sensor_target: np.ndarray,
        dpose_dx: np.ndarray,
        J_theta: np.ndarray,
        view_error_prior: ViewErrorPrior,
    ) -> Factor:
        residuals, J_pose = self._residuals_and_jacobian(layout, assignment, T_sensor_target)
        is_outlier = assignment.feature < 0
        residuals[:, is_outlier], J_pose[:, :, is_outlier] = 0, 0
        is_estimated = layout.columns < self.n_chain_unknowns
        theta_columns = self.n_chain_unknowns + layout.correction_index
        cost = tukey_cost(
            assignment.standardized_norm[~is_outlier],
            assignment.effective_weight[~is_outlier],
            assignment.gate_sigma,
        )
        return Factor(
            T_sensor_target=T_sensor_target,
            residuals=residuals,
            J_pose=J_pose,
            J_theta=np.where(is_outlier, 0.0, J_theta),
            weight=assignment.weight,
            cost=cost,
            columns=np.concatenate([layout.columns[is_estimated], theta_columns]),
            dpose_dx=np.column_stack(
                [dpose_dx[:, is_estimated], np.zeros((6, len(theta_columns)))]
            ),
            view_covariance=view_error_prior.covariance,
            view_error=view_error_prior.value,
        )

    def _residuals_and_jacobian(
        self, layout: FactorLayout, assignment: Assignment, T_sensor_target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (k, n) in σ and their derivatives (k, 6, n) by the pose."""
        data = assignment.weighted_data
        n = data.shape[1]
        function = self.residual_functions[layout.kind, layout.sensor, layout.target]
        r, J = function(T_sensor_target[:3].T.reshape(-1), data)
        residuals = np.stack([np.broadcast_to(v, n) for v in r])
        jacobian = np.stack([np.broadcast_to(v, n) for v in J])
        return residuals, jacobian.reshape(6, len(residuals), n).swapaxes(0, 1)

    def solve(
        self,
        *,
        factors: Sequence[Factor],
        x: np.ndarray,
        scale: np.ndarray,
        poses: LinearizationPoses,
        prior: Prior,
    ) -> NlpSolution:
        """Solve from x (n,) in units of scale (n,), for factors linearized there.

        Whether IPOPT converged is part of the solution. The cost is scaled so that the largest
        curvature is one: tolerances are then steps, in m or rad.
        """
        size = 1 / max(joint_information(factors, prior.weight).diagonal().max(), 1e-300)
        parameters = [
            size,
            prior.mean,
            prior.weight,
            *self._chain_inputs(x, scale, poses)[1:],
            np.hstack([f.T_sensor_target[:3] for f in factors]),
            np.column_stack([f.pose_gradient for f in factors]),
            np.hstack([f.pose_information for f in factors]),
            x[self.n_chain_unknowns :],
            *self._theta_system(factors),
        ]
        packed = np.concatenate([np.ravel(v, order="F") for v in parameters])
        solution = self.solver(x0=x, p=packed)
        stats = self.solver.stats()
        return NlpSolution(
            x=np.array(solution["x"]).reshape(-1),
            n_iterations=int(stats["iter_count"]),
            status=stats["return_status"],
            has_converged=bool(stats["success"]),
        )

    def _chain_inputs(
        self, x: np.ndarray, scale: np.ndarray, poses: LinearizationPoses
    ) -> list[np.ndarray]:
        """Return the inputs of the chain function for all layouts side by side."""
        n = self.n_chain_unknowns
        return [
            np.append(x[:n], 0.0)[self.columns].T,
            np.append(scale[:n], 1.0)[self.columns].T,
            np.hstack(list(poses.T_robot_sensor)),
            np.hstack(list(poses.T_robot_body)),
            np.hstack(list(poses.T_body_target)),
        ]

    def _theta_system(self, factors: Sequence[Factor]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return coupling (6 b, p) of poses and θ, gradient (p,) and Hessian (p, p) by θ."""
        n, p = len(factors), self.n_correction_values
        coupling, gradient, hessian = np.zeros((n, 6, p)), np.zeros(p), np.zeros((p, p))
        for k, (layout, factor) in enumerate(zip(self.layouts, factors, strict=True)):
            index = layout.correction_index
            if len(index):
                factor_hessian, factor_gradient = factor.theta_system
                coupling[k][:, index] = factor.pose_theta_information
                gradient[index] += factor_gradient
                hessian[np.ix_(index, index)] += factor_hessian
        return coupling.reshape(6 * n, p), gradient, hessian
