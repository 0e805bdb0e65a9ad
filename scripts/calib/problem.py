"""The joint problem: all sensors, targets and placements in one nonlinear programme.

    minimise over ξ, y:  Σ_i w_i ρ(|r_i(T_sensor_target)|²) + ½ Σ_k |y_k|² + ½ Σ_s |(ξ_s+m_s)/p_s|²

with T_sensor_target from the sensor's ξ_s, the target's ξ_t where its mount is estimated, and the
two MCS pose errors of its placement, in units of their priors, y (expressions.chain; paper
equations 1 to 4). One y per (placement, body) is shared by all scans, images and sensors of the
placement, and the robot's by all targets that rest at the same time.

The measurements of a group depend on one pose alone. They are condensed, about where it stands, to
the gradient and the Gauss-Newton Hessian (6, 6) by that pose, and IPOPT finds the poses of the
whole chain that minimise the sum; estimation.estimate condenses again there, until nothing moves.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from calib import arrays, expressions, kinds

OPTIONS = {
    "print_time": False,
    "no_nlp_grad": True,  # of parameters, whose slopes nobody needs
    "calc_lam_p": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-11,
        "acceptable_tol": 1e-9,
        "acceptable_iter": 3,
        "max_iter": 50,
        "nlp_scaling_method": "none",
    },
}


@dataclass(frozen=True)
class Block:
    """The measurements of one kind that one sensor made of one target in one placement.

    columns (24,): its unknowns in the order of expressions.chain, the number of unknowns for none.
    """

    sensor: str
    kind: str
    target: str
    columns: np.ndarray


@dataclass(frozen=True)
class Poses:
    """Of every block, (b, 4, 4): T_robot_sensor, measured T_robot_body, T_body_target."""

    T_robot_sensor: np.ndarray
    T_robot_body: np.ndarray
    T_body_target: np.ndarray


@dataclass(frozen=True)
class Part:
    """One group of measurements about where its T_sensor_target (4, 4) stands.

    r (k, n), J (k, 6, n): residuals and their derivatives by its right perturbation, in σ; weight
    (n,) of each. columns (m,) of the unknowns that move it, by A (6, m).
    """

    T_sensor_target: np.ndarray
    r: np.ndarray
    J: np.ndarray
    weight: np.ndarray
    cost: float
    columns: np.ndarray
    A: np.ndarray

    @cached_property
    def gradient(self):
        """(6,), of the cost by the right perturbation of T_sensor_target."""
        return sum(J @ (self.weight * r) for r, J in zip(self.r, self.J, strict=True))

    @cached_property
    def information(self):
        """(6, 6), likewise: what the measurements tell of it, and Gauss-Newton's Hessian.

        Weights of a robust loss held fixed bound its cost from above: no step overshoots.
        """
        return sum((self.weight * J) @ J.T for J in self.J)


@dataclass(frozen=True)
class Solution:
    """The unknowns x (n,) at the optimum: twists from where they stood, and MCS errors."""

    x: np.ndarray
    iterations: int
    status: str
    success: bool


def cost(size, share, gate):
    """Tukey's biweight of residuals of a size (n,), in σ. It ends at the gate, so that nothing
    jumps when a measurement crosses it; near zero it is half the square (weight: loss_weight)."""
    inside = np.maximum(1 - (size / gate) ** 2, 0)
    return gate**2 / 6 * float(np.sum(share * (1 - inside**3)))


class Problem:
    """The programme of fixed blocks; measurements, poses and noise change between solutions.

    models: name -> Camera or rig.Lidar; targets: name -> shape; n: number of unknowns.
    """

    def __init__(self, models, targets, blocks, n):
        self.blocks, self.n = blocks, n
        self.kernels = {}
        for key in sorted({(b.kind, b.sensor, b.target) for b in blocks}):
            kind = kinds.KINDS[key[0]]
            residual = kind.residual(models[key[1]], targets[key[2]])
            kernel = expressions.kernel(residual, len(kind.DATA))
            self.kernels[key] = arrays.over_arrays(kernel)
        self.columns = np.stack([b.columns for b in blocks])
        self.chain = expressions.chain().map(len(blocks))
        self.cost, self.slopes = (f.map(len(blocks)) for f in expressions.condensed())
        self.solver = self._solver()

    def parts(self, x, scale, poses, assigned):
        """A Part for the Assignment of every block, at unknowns x (n,) in units of scale (n,)."""
        inputs = self._inputs(x, scale, poses)
        T = np.array(self.chain(*inputs)).reshape(3, len(self.blocks), 4).swapaxes(0, 1)
        none = np.zeros((6, len(self.blocks))), np.zeros((6, 6 * len(self.blocks)))
        A = np.array(self.slopes(*inputs, np.hstack(T), *none)[2]).reshape(6, len(self.blocks), 24)
        return [
            self._part(b, a, T[k], A[:, k], self.columns[k])
            for k, (b, a) in enumerate(zip(self.blocks, assigned, strict=True))
        ]

    def _part(self, b, a, T, A, columns):
        data = a.data
        n = data.shape[1]
        r, J = self.kernels[b.kind, b.sensor, b.target](T.T.reshape(-1), data)
        r = np.stack([np.broadcast_to(v, n) for v in r])
        J = np.stack([np.broadcast_to(v, n) for v in J]).reshape(6, len(r), n).swapaxes(0, 1)
        out = a.feature < 0
        used = columns < self.n
        whole = np.vstack([T, [0, 0, 0, 1]])
        r[:, out], J[:, :, out] = 0, 0
        total = cost(a.size[~out], a.share[~out], a.gate)
        return Part(whole, r, J, a.weight, total, columns[used], A[:, used])

    def solve(self, parts, x, scale, poses, prior):
        """The Solution, from x (n,) in units of scale (n,), of measurements condensed to parts.

        prior: means (n,) and weights (n,) of the unknowns: ½ Σ (weight (x + mean))². Raises
        nothing: whether IPOPT converged stands in the Solution. The cost is scaled so that the
        largest curvature is one: tolerances then mean steps, in m, rad.
        """
        mean, weight = prior
        size = 1 / max(information(parts, weight).diagonal().max(), 1e-300)
        T0 = np.hstack([p.T_sensor_target[:3] for p in parts])
        g = np.column_stack([p.gradient for p in parts])
        H = np.hstack([p.information for p in parts])
        given = [size, mean, weight, *self._inputs(x, scale, poses)[1:], T0, g, H]
        packed = np.concatenate([np.ravel(v, order="F") for v in given])
        found = self.solver(x0=x, p=packed)
        stats = self.solver.stats()
        return Solution(
            x=np.array(found["x"]).reshape(-1),
            iterations=int(stats["iter_count"]),
            status=stats["return_status"],
            success=bool(stats["success"]),
        )

    def _inputs(self, x, scale, poses):
        """The arguments of chain for all blocks, side by side."""
        both = [np.append(v, fill)[self.columns].T for v, fill in ((x, 0.0), (scale, 1.0))]
        return *both, *(np.hstack(T) for T in vars(poses).values())

    def _solver(self):
        """The NLP in x, given all that changes between solutions as one vector of parameters."""
        b, (x, p, given) = len(self.blocks), _symbols(self.n, len(self.blocks))
        size, mean, weight, *rest = given
        own = ca.reshape(ca.vertcat(x, 0)[self.columns.reshape(-1).tolist()], 24, b)
        offset = weight * (x + mean)
        cost = size * (ca.sum2(self.cost(own, *rest)) + ca.dot(offset, offset) / 2)
        gradient, hessian, _ = self.slopes(own, *rest)
        triangle, scatter, place = _layout(self.columns, self.n)
        slope = size * (scatter @ ca.vec(gradient) + weight * offset)
        curved = size * (place @ ca.vertcat(ca.vec(hessian), weight**2))
        factor, none = ca.MX.sym("factor"), ca.MX.sym("none", ca.Sparsity(0, 0))
        derivatives = {
            "grad_f": ca.Function("nlp_grad_f", [x, p], [cost, slope]),
            "hess_lag": ca.Function(
                "nlp_hess_l", [x, p, factor, none], [ca.MX(triangle, factor * curved)]
            ),
        }
        return ca.nlpsol("nlp", "ipopt", {"x": x, "p": p, "f": cost}, OPTIONS | derivatives)


def _symbols(n, b):
    """Unknowns x (n,), all parameters of b blocks as one vector, and its parts: the scale of the
    cost, the priors' means and weights, and what expressions.condensed takes but x."""
    shapes = [(1, 1), (n, 1), (n, 1), (24, b), *[(4, 4 * b)] * 3, (3, 4 * b), (6, b), (6, 6 * b)]
    ends = np.cumsum([0] + [rows * columns for rows, columns in shapes]).tolist()
    x, p = ca.MX.sym("x", n), ca.MX.sym("p", ends[-1])
    flat = ca.vertsplit(p, ends)
    return x, p, [ca.reshape(v, *shape) for v, shape in zip(flat, shapes, strict=True)]


def information(parts, weight):
    """(n, n): what all measurements tell of the unknowns, and their priors of weight (n,)."""
    total = np.diag(weight**2)
    for p in parts:
        total[np.ix_(p.columns, p.columns)] += p.A.T @ p.information @ p.A
    return total


def _layout(columns, n):
    """Sparsity of the Hessian's upper triangle, and constant matrices that add up in it, and in the
    gradient, what the blocks say of their own unknowns, columns (b, 24)."""
    flat = columns.reshape(-1)
    used = np.flatnonzero(flat < n)
    scatter = _ones(flat[used], used, n, len(flat))
    # Column-major, as CasADi lays out the blocks' Hessians side by side.
    row = np.tile(columns, (1, 24)).reshape(-1)
    column = np.repeat(columns, 24, axis=1).reshape(-1)
    upper = np.flatnonzero((row <= column) & (column < n))
    keys, at = np.unique(
        np.concatenate([column[upper] * n + row[upper], np.arange(n) * (n + 1)]),
        return_inverse=True,
    )
    triangle = ca.Sparsity.triplet(n, n, (keys % n).tolist(), (keys // n).tolist())
    source = np.concatenate([upper, len(row) + np.arange(n)])
    return triangle, scatter, _ones(at, source, len(keys), len(row) + n)


def _ones(rows, columns, height, width):
    """Sparse matrix (height, width) that is 1 at those places."""
    pattern = ca.Sparsity.triplet(height, width, rows.tolist(), columns.tolist())
    return ca.DM(pattern, 1.0)
