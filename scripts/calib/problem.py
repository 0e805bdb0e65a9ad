"""The joint problem: all sensors, targets and placements in one nonlinear programme.

    minimise over ξ_s, y_k:  Σ_i ρ(|r_i(T_sensor_target)|²) + ½ Σ_k |y_k|² + ½ Σ_s |(ξ_s+m_s)/p_s|²

with T_sensor_target from the sensor's ξ_s and the two MCS pose errors of its placement, in units
of their priors, y_k (expressions.chain; paper equations 1 to 4). One y_k per (placement, body) is
shared by all scans, images and sensors of the placement. CasADi writes residuals and derivatives,
NumPy sums them over the measurements, IPOPT gets cost, gradient and the Gauss-Newton Hessian.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calib import arrays, expressions, geometry, kinds

OPTIONS = {
    "print_time": False,
    "no_nlp_grad": True,  # of parameters, of which there are none
    "calc_lam_p": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-11,
        "acceptable_tol": 1e-9,
        "acceptable_iter": 3,
        "max_iter": 15,
        "nlp_scaling_method": "none",
    },
}


@dataclass(frozen=True)
class Block:
    """The measurements of one kind that one sensor made of one target in one placement.

    sensor: its index; robot, body: the indices of their MCS pose errors in this placement.
    """

    sensor: int
    robot: int
    body: int
    kind: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray


class Problem:
    """The programme of fixed blocks; data, poses and noise may change between solutions.

    models: per sensor its Camera or rig.Lidar; targets: name -> shape; gate in σ.
    """

    def __init__(self, models, targets, blocks, n_poses, gate):
        self.blocks, self.gate = blocks, gate
        self.n_sensors, self.n_poses = len(models), n_poses
        self.n = 6 * (self.n_sensors + n_poses)
        self.kernels = {}
        for key in sorted({(b.kind, b.sensor, b.target) for b in blocks}):
            kind = kinds.KINDS[key[0]]
            residual = kind.residual(models[key[1]], targets[key[2]])
            kernel = expressions.kernel(residual, len(kind.DATA))
            self.kernels[key] = arrays.over_arrays(kernel)
        self.chain = expressions.chain().map(len(blocks)) if blocks else None
        self.columns = np.array([self._columns(b) for b in blocks], int).reshape(-1, 18)
        self.fixed = [
            np.hstack([getattr(b, name) for b in blocks])
            for name in ("T_robot_body", "T_body_target")
            if blocks
        ]

    def _columns(self, b):
        starts = (6 * b.sensor, 6 * (self.n_sensors + b.robot), 6 * (self.n_sensors + b.body))
        return [s + i for s in starts for i in range(6)]

    def solve(self, data, T_robot_sensor, sigmas, y, prior):
        """The optimum for data (columns, n) per block.

        Starts from T_robot_sensor (s, 4, 4) and the MCS errors y (k, 6) in units of their priors
        sigmas (k, 6). prior: means m (s, 6) and sigmas (s, 6) of the sensors, infinite for none.
        Raises nothing: whether IPOPT converged stands in the Solution.
        """
        mean, sigma = prior
        terms = Terms(self, data, T_robot_sensor, sigmas, prior)
        x, stats = _minimum(terms, np.concatenate([np.zeros(mean.size), y.reshape(-1)]))
        xi, y = x.reshape(-1, 6)[: self.n_sensors], x.reshape(-1, 6)[self.n_sensors :]
        T = T_robot_sensor @ geometry.se3_exp(xi)
        there = Terms(self, data, T, sigmas, (mean + xi, sigma))
        sums = there.at(np.concatenate([np.zeros(mean.size), y.reshape(-1)]))
        return Solution(
            T_robot_sensor=T,
            y=y,
            step=xi,
            cost=sums.cost,
            information=sums.information,
            iterations=int(stats["iter_count"]),
            status=stats["return_status"],
            success=bool(stats["success"]),
        )


@dataclass(frozen=True)
class Solution:
    """Poses (s, 4, 4) and MCS errors y (k, 6) at the optimum, and the information matrix there.

    The information is in the order (ξ_1 … ξ_s, y_1 … y_k), right perturbations, nuisances included.
    """

    T_robot_sensor: np.ndarray
    y: np.ndarray
    step: np.ndarray
    cost: float
    information: np.ndarray
    iterations: int
    status: str
    success: bool


@dataclass(frozen=True)
class Sums:
    """Cost, gradient (n,), Hessian and information (n, n)."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray
    information: np.ndarray


def loss(r, J, gate):
    """Sums over measurements of residuals r (k, n) with derivatives J (k, 6, n), in σ.

    The loss is Tukey's biweight, with weight w: it ends at the gate, in σ, so that nothing jumps
    when a measurement crosses it. The information is JᵀwJ. The Hessian is Gauss-Newton's with the
    curvature of the loss along the residual, which w overstates, so that a few steps suffice; it is
    held above w/10, for the curvature turns negative towards the gate.
    """
    inside = np.maximum(1 - np.sum(r * r, 0) / gate**2, 0)
    weight = inside**2
    curvature = np.maximum(inside * (5 * inside - 4), 0.1 * weight)
    return Sums(
        cost=gate**2 / 6 * float(np.sum(1 - inside**3)),
        gradient=sum(J[k] @ (weight * r[k]) for k in range(len(r))),
        hessian=sum((curvature * Jk) @ Jk.T for Jk in J),
        information=sum((weight * Jk) @ Jk.T for Jk in J),
    )


class Terms:
    """All terms of the programme with their data, as functions of the unknowns x."""

    def __init__(self, problem, data, T_robot_sensor, sigmas, prior):
        self.problem, self.data = problem, data
        blocks = problem.blocks
        self.scales = np.array(
            [np.concatenate([np.ones(6), sigmas[b.robot], sigmas[b.body]]) for b in blocks]
        ).reshape(-1, 18)
        self.sensors = np.hstack([T_robot_sensor[b.sensor] for b in blocks]) if blocks else None
        mean, sigma = prior
        still = np.zeros(6 * problem.n_poses)
        self.mean = np.concatenate([mean.reshape(-1), still])
        self.weight = np.concatenate([1 / sigma.reshape(-1), still + 1])
        self._last = None, None

    def at(self, x):
        """The Sums at x (n,); asked again for the same x, the same."""
        if self._last[0] != x.tobytes():
            self._last = x.tobytes(), self._sums(x)
        return self._last[1]

    def _sums(self, x):
        offset = self.weight * (x + self.mean)
        cost, gradient = float(offset @ offset) / 2, self.weight * offset
        hessian, information = np.diag(self.weight**2), np.diag(self.weight**2)
        for columns, A, part in self._parts(x):
            square = np.ix_(columns, columns)
            cost += part.cost
            gradient[columns] += A.T @ part.gradient
            hessian[square] += A.T @ part.hessian @ A
            information[square] += A.T @ part.information @ A
        return Sums(cost, gradient, hessian, information)

    def _parts(self, x):
        """(columns, d T_sensor_target / dx (6, 18), Sums over the measurements) of every block."""
        p = self.problem
        if not p.blocks:
            return
        chained = p.chain(x[p.columns].T, self.scales.T, self.sensors, *p.fixed)
        T, A = (np.array(c).reshape(len(c.full()), len(p.blocks), -1) for c in chained)
        for k, (b, d) in enumerate(zip(p.blocks, self.data, strict=True)):
            r, J = p.kernels[b.kind, b.sensor, b.target](T[:, k].T.reshape(-1), d)
            n = d.shape[1]
            r = np.stack([np.broadcast_to(v, n) for v in r])
            J = np.stack([np.broadcast_to(v, n) for v in J]).reshape(6, len(r), n).swapaxes(0, 1)
            yield p.columns[k], A[:, k], loss(r, J, p.gate)


class _Evaluation(ca.Callback):
    """A NumPy function as a CasADi one, of inputs and outputs with given sparsities."""

    def __init__(self, name, inputs, outputs, function):
        super().__init__()
        self._inputs, self._outputs, self._function = inputs, outputs, function
        self.construct(name, {})

    def get_n_in(self):
        return len(self._inputs)

    def get_n_out(self):
        return len(self._outputs)

    def get_sparsity_in(self, i):
        return self._inputs[i]

    def get_sparsity_out(self, i):
        return self._outputs[i]

    def eval(self, arguments):
        return self._function(np.array(arguments[0]).reshape(-1), *arguments[1:])


def _minimum(terms, x0):
    """(optimum x (n,), IPOPT's account) from x0 (n,).

    The cost is scaled so that the largest curvature is one: tolerances then mean steps, in m, rad.
    """
    n, sums = len(x0), terms.at(x0)
    scale = 1 / max(sums.information.diagonal().max(), 1e-300)
    triangle = _pattern(terms.problem)
    column, none, one = ca.Sparsity.dense(n), ca.Sparsity(0, 0), ca.Sparsity.dense(1)
    at = np.array(triangle.row()), np.array(triangle.get_col())

    def cost(x):
        return [scale * terms.at(x).cost]

    def gradient(x, p):
        return [scale * terms.at(x).cost, scale * terms.at(x).gradient]

    def hessian(x, p, of_cost, of_constraints):
        return [ca.DM(triangle, scale * float(of_cost) * terms.at(x).hessian[at])]

    value = _Evaluation("value", [column], [one], cost)
    own = {
        "grad_f": _Evaluation("nlp_grad_f", [column, none], [one, column], gradient),
        "hess_lag": _Evaluation("nlp_hess_l", [column, none, one, none], [triangle], hessian),
    }
    x = ca.MX.sym("x", n)
    solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": value(x)}, OPTIONS | own)
    found = solver(x0=x0)
    return np.array(found["x"]).reshape(-1), solver.stats()


def _pattern(problem):
    """Sparsity of the Hessian's upper triangle: what shares a block, and the diagonal."""
    used = np.eye(problem.n, dtype=bool)
    for columns in problem.columns:
        used[np.ix_(columns, columns)] = True
    columns, rows = np.nonzero(np.triu(used).T)
    return ca.Sparsity.triplet(problem.n, problem.n, rows.tolist(), columns.tolist())
