"""The measurements of one sensor in one placement, condensed about where their pose stands."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Factor:
    """One group of measurements about where its T_sensor_target (4, 4) stands.

    r (k, n), J (k, 6, n), D (q, k, n): residuals, and their derivatives by its right perturbation
    and by those of θ that they depend on, in σ; weight (n,) of each. columns (m,) of the unknowns
    that move it, by A (6, m), and of those of θ, whose columns of A are zero, last.

    Of a view in motion, the error of the MCS is its own: spread (6, 6), its covariance about the
    right perturbation, and error (6,), where it stands. It is eliminated: all that
    follows is marginal.
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

    def _pose_cross_information(self, D):
        """(6, p) Σ w Jᵀ D of derivatives D (p, k, n)."""
        return np.einsum("kin,pkn->ip", self.J_pose * self.weight, D, optimize=True)

    @cached_property
    def _measurement_system(self):
        """Information (6, 6) and gradient (6,) by the pose, were it without an error of its own.

        Weights of a robust loss held fixed bound its cost from above: no step overshoots.
        """
        H = sum((self.weight * J) @ J.T for J in self.J_pose)
        return H, sum(
            J @ (self.weight * r) for r, J in zip(self.residuals, self.J_pose, strict=True)
        )

    @cached_property
    def _view_error_covariance(self):
        """(6, 6) covariance of a view's own error given the rest."""
        H = self._measurement_system[0]
        return self.view_covariance @ np.linalg.inv(np.eye(6) + H @ self.view_covariance)

    @cached_property
    def pose_gradient(self):
        """(6,), of the cost by the right perturbation of T_sensor_target."""
        H, g = self._measurement_system
        if self.view_covariance is None:
            return g
        g = g - H @ self.view_error
        return g - H @ (self._view_error_covariance @ g)

    @cached_property
    def pose_information(self):
        """(6, 6), likewise: what the measurements tell of it, and Gauss-Newton's Hessian."""
        H = self._measurement_system[0]
        return H if self.view_covariance is None else H - H @ self._view_error_covariance @ H

    @cached_property
    def pose_theta_information(self):
        """(6, q), likewise, between it and those of θ."""
        C = self._pose_cross_information(self.J_theta)
        return (
            C
            if self.view_covariance is None
            else C - self._measurement_system[0] @ self._view_error_covariance @ C
        )

    @cached_property
    def theta_system(self):
        """Hessian (q, q) and gradient (q,) of the cost by those of θ."""
        K = np.einsum("qkn,pkn->qp", self.J_theta * self.weight, self.J_theta, optimize=True)
        s = np.einsum("qkn,kn->q", self.J_theta * self.weight, self.residuals, optimize=True)
        if self.view_covariance is not None:
            C, (H, g) = self._pose_cross_information(self.J_theta), self._measurement_system
            s = s - C.T @ (
                self.view_error + self._view_error_covariance @ (g - H @ self.view_error)
            )
            K = K - C.T @ self._view_error_covariance @ C
        return K, s

    def update_view_error(self, step):
        """(6,): a view's own error at its best, its unknowns having moved by step (m,)."""
        (H, g), q = self._measurement_system, len(self.J_theta)
        eta = self.dpose_dx @ step - self.view_error
        delta = step[len(step) - q :]
        return -self._view_error_covariance @ (
            H @ eta + g + self._pose_cross_information(self.J_theta) @ delta
        )

    def cross_information(self, D):
        """(m, p) Σ w Dᵀ ∂r/∂x of derivatives D (p, k, n) by other numbers, x its own unknowns."""
        C = self._pose_cross_information(D)
        own = np.einsum("qkn,pkn->qp", self.J_theta * self.weight, D, optimize=True)
        if self.view_covariance is not None:
            own = (
                own - self._pose_cross_information(self.J_theta).T @ self._view_error_covariance @ C
            )
            C = C - self._measurement_system[0] @ self._view_error_covariance @ C
        out = self.dpose_dx.T @ C
        return np.concatenate([out[: len(out) - len(own)], own])

    @cached_property
    def hessian_x(self):
        """(m, m): information about its own unknowns."""
        out, q = self.dpose_dx.T @ self.pose_information @ self.dpose_dx, len(self.J_theta)
        if q:
            out[:, -q:] += self.dpose_dx.T @ self.pose_theta_information
            out[-q:] += self.pose_theta_information.T @ self.dpose_dx
            out[-q:, -q:] += self.theta_system[0]
        return out

    @cached_property
    def gradient_x(self):
        """(m,): gradient of the cost by its own unknowns."""
        out = self.dpose_dx.T @ self.pose_gradient
        if len(self.J_theta):
            out[-len(self.J_theta) :] += self.theta_system[1]
        return out


def joint_information(parts, weight):
    """(n, n): what all measurements tell of the unknowns, and their priors of weight (n,)."""
    total = np.diag(weight**2)
    for p in parts:
        total[np.ix_(p.columns, p.columns)] += p.hessian_x
    return total
