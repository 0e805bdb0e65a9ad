"""The measurements of one sensor in one placement, condensed about where their pose stands."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Part:
    """One group of measurements about where its T_sensor_target (4, 4) stands.

    r (k, n), J (k, 6, n), D (q, k, n): residuals, and their derivatives by its right perturbation
    and by those of θ that they depend on, in σ; weight (n,) of each. columns (m,) of the unknowns
    that move it, by A (6, m), and of those of θ, whose columns of A are zero, last.

    Of a view in motion, the error of the MCS is its own: spread (6, 6), its covariance about the
    right perturbation, and error (6,), where it stands. It is eliminated: all that
    follows is marginal.
    """

    T_sensor_target: np.ndarray
    r: np.ndarray
    J: np.ndarray
    D: np.ndarray
    weight: np.ndarray
    cost: float
    columns: np.ndarray
    A: np.ndarray
    spread: np.ndarray | None = None
    error: np.ndarray | None = None

    def _by_pose(self, D):
        """(6, p) Σ w Jᵀ D of derivatives D (p, k, n)."""
        return np.einsum("kin,pkn->ip", self.J * self.weight, D, optimize=True)

    @cached_property
    def _plain(self):
        """Information (6, 6) and gradient (6,) by the pose, were it without an error of its own.

        Weights of a robust loss held fixed bound its cost from above: no step overshoots.
        """
        H = sum((self.weight * J) @ J.T for J in self.J)
        return H, sum(J @ (self.weight * r) for r, J in zip(self.r, self.J, strict=True))

    @cached_property
    def _free(self):
        """(6, 6) covariance of a view's own error given the rest."""
        H = self._plain[0]
        return self.spread @ np.linalg.inv(np.eye(6) + H @ self.spread)

    @cached_property
    def gradient(self):
        """(6,), of the cost by the right perturbation of T_sensor_target."""
        H, g = self._plain
        if self.spread is None:
            return g
        g = g - H @ self.error
        return g - H @ (self._free @ g)

    @cached_property
    def information(self):
        """(6, 6), likewise: what the measurements tell of it, and Gauss-Newton's Hessian."""
        H = self._plain[0]
        return H if self.spread is None else H - H @ self._free @ H

    @cached_property
    def coupling(self):
        """(6, q), likewise, between it and those of θ."""
        C = self._by_pose(self.D)
        return C if self.spread is None else C - self._plain[0] @ self._free @ C

    @cached_property
    def of_theta(self):
        """Hessian (q, q) and gradient (q,) of the cost by those of θ."""
        K = np.einsum("qkn,pkn->qp", self.D * self.weight, self.D, optimize=True)
        s = np.einsum("qkn,kn->q", self.D * self.weight, self.r, optimize=True)
        if self.spread is not None:
            C, (H, g) = self._by_pose(self.D), self._plain
            s = s - C.T @ (self.error + self._free @ (g - H @ self.error))
            K = K - C.T @ self._free @ C
        return K, s

    def wander(self, step):
        """(6,): a view's own error at its best, its unknowns having moved by step (m,)."""
        (H, g), q = self._plain, len(self.D)
        eta = self.A @ step - self.error
        delta = step[len(step) - q :]
        return -self._free @ (H @ eta + g + self._by_pose(self.D) @ delta)

    def by_unknowns(self, D):
        """(m, p) Σ w Dᵀ ∂r/∂x of derivatives D (p, k, n) by other numbers, x its own unknowns."""
        C = self._by_pose(D)
        own = np.einsum("qkn,pkn->qp", self.D * self.weight, D, optimize=True)
        if self.spread is not None:
            own = own - self._by_pose(self.D).T @ self._free @ C
            C = C - self._plain[0] @ self._free @ C
        out = self.A.T @ C
        return np.concatenate([out[: len(out) - len(own)], own])

    @cached_property
    def hessian(self):
        """(m, m): information about its own unknowns."""
        out, q = self.A.T @ self.information @ self.A, len(self.D)
        if q:
            out[:, -q:] += self.A.T @ self.coupling
            out[-q:] += self.coupling.T @ self.A
            out[-q:, -q:] += self.of_theta[0]
        return out

    @cached_property
    def slope(self):
        """(m,): gradient of the cost by its own unknowns."""
        out = self.A.T @ self.gradient
        if len(self.D):
            out[-len(self.D) :] += self.of_theta[1]
        return out


def information(parts, weight):
    """(n, n): what all measurements tell of the unknowns, and their priors of weight (n,)."""
    total = np.diag(weight**2)
    for p in parts:
        total[np.ix_(p.columns, p.columns)] += p.hessian
    return total
