"""Factor: the measurements of one sensor in one placement, linearized about their pose."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Factor:
    """One group of measurements, linearized at T_sensor_target (4, 4).

    residuals: (k, n) in σ; J_pose: (k, 6, n) their derivatives by the right perturbation of
    T_sensor_target; J_theta: (q, k, n) by the θ they depend on; weight: (n,) of each measurement;
    cost: of the robust loss; columns: (m,) unknowns x that move the factor, those of θ last;
    dpose_dx: (6, m) derivative of the pose by them, zero for θ.

    A moving view has a motion capture error of its own: view_covariance (6, 6) about the right
    perturbation, and view_error (6,), its current value. It is eliminated: all properties below are
    marginal.
    """

    T_sensor_target: np.ndarray
    residuals: np.ndarray
    J_pose: np.ndarray
    J_theta: np.ndarray
    weight: np.ndarray
    cost: float
    columns: np.ndarray
    dpose_dx: np.ndarray
    view_covariance: np.ndarray | None = None
    view_error: np.ndarray | None = None

    def _pose_cross_information(self, D: np.ndarray) -> np.ndarray:
        """Return Σ w Jᵀ D (6, p) for derivatives D (p, k, n)."""
        return np.einsum("kin,pkn->ip", self.J_pose * self.weight, D, optimize=True)

    @cached_property
    def _measurement_system(self) -> tuple[np.ndarray, np.ndarray]:
        """Information (6, 6) and gradient (6,) by the pose, without the view's own error.

        The weights of the robust loss are held fixed: this bounds its cost from above, so no step
        overshoots.
        """
        pairs = list(zip(self.residuals, self.J_pose, strict=True))
        H = sum((self.weight * J) @ J.T for J in self.J_pose)
        return H, sum(J @ (self.weight * r) for r, J in pairs)

    @cached_property
    def _view_error_covariance(self) -> np.ndarray:
        """Covariance (6, 6) of the view's own error, given the unknowns."""
        H = self._measurement_system[0]
        return self.view_covariance @ np.linalg.inv(np.eye(6) + H @ self.view_covariance)

    @cached_property
    def pose_gradient(self) -> np.ndarray:
        """Gradient (6,) of the cost by the right perturbation of T_sensor_target."""
        H, g = self._measurement_system
        if self.view_covariance is None:
            return g
        g = g - H @ self.view_error
        return g - H @ (self._view_error_covariance @ g)

    @cached_property
    def pose_information(self) -> np.ndarray:
        """Information (6, 6) about the pose: the Gauss-Newton Hessian."""
        H = self._measurement_system[0]
        return H if self.view_covariance is None else H - H @ self._view_error_covariance @ H

    @cached_property
    def pose_theta_information(self) -> np.ndarray:
        """Block (6, q) of the Hessian between pose and θ."""
        C = self._pose_cross_information(self.J_theta)
        if self.view_covariance is None:
            return C
        return C - self._measurement_system[0] @ self._view_error_covariance @ C

    @cached_property
    def theta_system(self) -> tuple[np.ndarray, np.ndarray]:
        """Hessian (q, q) and gradient (q,) of the cost by θ."""
        K = np.einsum("qkn,pkn->qp", self.J_theta * self.weight, self.J_theta, optimize=True)
        s = np.einsum("qkn,kn->q", self.J_theta * self.weight, self.residuals, optimize=True)
        if self.view_covariance is not None:
            C, (H, g) = self._pose_cross_information(self.J_theta), self._measurement_system
            view_step = self._view_error_covariance @ (g - H @ self.view_error)
            s = s - C.T @ (self.view_error + view_step)
            K = K - C.T @ self._view_error_covariance @ C
        return K, s

    def update_view_error(self, step: np.ndarray) -> np.ndarray:
        """Return the view's own error (6,) at its optimum after a step (m,) of the unknowns."""
        (H, g), q = self._measurement_system, len(self.J_theta)
        eta = self.dpose_dx @ step - self.view_error
        theta_step = step[len(step) - q :]
        cross = self._pose_cross_information(self.J_theta)
        return -self._view_error_covariance @ (H @ eta + g + cross @ theta_step)

    def cross_information(self, D: np.ndarray) -> np.ndarray:
        """Return Σ w (∂r/∂x)ᵀ D (m, p) for derivatives D (p, k, n) by other values."""
        C = self._pose_cross_information(D)
        by_theta = np.einsum("qkn,pkn->qp", self.J_theta * self.weight, D, optimize=True)
        if self.view_covariance is not None:
            theta_cross = self._pose_cross_information(self.J_theta)
            by_theta = by_theta - theta_cross.T @ self._view_error_covariance @ C
            C = C - self._measurement_system[0] @ self._view_error_covariance @ C
        out = self.dpose_dx.T @ C
        return np.concatenate([out[: len(out) - len(by_theta)], by_theta])

    @cached_property
    def hessian_x(self) -> np.ndarray:
        """Information (m, m) about the unknowns."""
        out, q = self.dpose_dx.T @ self.pose_information @ self.dpose_dx, len(self.J_theta)
        if q:
            out[:, -q:] += self.dpose_dx.T @ self.pose_theta_information
            out[-q:] += self.pose_theta_information.T @ self.dpose_dx
            out[-q:, -q:] += self.theta_system[0]
        return out

    @cached_property
    def gradient_x(self) -> np.ndarray:
        """Gradient (m,) of the cost by the unknowns."""
        out = self.dpose_dx.T @ self.pose_gradient
        if len(self.J_theta):
            out[-len(self.J_theta) :] += self.theta_system[1]
        return out


def joint_information(factors: Iterable[Factor], prior_weight: np.ndarray) -> np.ndarray:
    """Return the information (n, n) of all factors and of priors with weights (n,)."""
    total = np.diag(prior_weight**2)
    for factor in factors:
        total[np.ix_(factor.columns, factor.columns)] += factor.hessian_x
    return total
