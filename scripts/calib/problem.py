"""The joint problem: all sensors, targets and placements in one nonlinear programme.

    minimise over ξ_s, y_k:  Σ_i ρ(|r_i(T_sensor_target)|²) + ½ Σ_k |y_k|² + ½ Σ_s |(ξ_s+m_s)/p_s|²

with T_sensor_target from the sensor's ξ_s and the two MCS pose errors of its placement, in units
of their priors, y_k (expressions.chain; paper equations 1 to 4). One y_k per (placement, body) is
shared by all scans, images and sensors of the placement. IPOPT gets the gradient and the
Gauss-Newton Hessian assembled from sums per (sensor, placement, kind).
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calib import expressions, geometry

OPTIONS = {
    "print_time": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-11,
        "acceptable_tol": 1e-9,
        "acceptable_iter": 3,
        "max_iter": 100,
        "nlp_scaling_method": "none",
    },
}


@dataclass(frozen=True)
class Block:
    """The n measurements of one kind that one sensor made of one target in one placement.

    sensor: its index; robot, body: the indices of their MCS pose errors in this placement.
    """

    sensor: int
    robot: int
    body: int
    kind: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray
    n: int

    @property
    def size(self):
        return self.n * len(expressions.DATA[self.kind])


class Problem:
    """The programme of fixed blocks; data, poses and noise may change between solutions.

    models: per sensor its Camera, or None for a lidar; targets: name -> shape; gate in σ.
    """

    def __init__(self, models, targets, blocks, n_poses, gate):
        self.blocks = blocks
        self.n_sensors, self.n_poses = len(models), n_poses
        self.n = 6 * (self.n_sensors + n_poses)
        self._kernels = {}
        for b in blocks:
            key = (b.kind, b.sensor if b.kind == "corner" else b.target)
            if key not in self._kernels:
                residual = expressions.residual_of(b.kind, models[b.sensor], targets[b.target])
                columns = len(expressions.DATA[b.kind])
                self._kernels[key] = expressions.kernels(residual, columns, gate)
        self._build()

    def _parameters(self):
        """The symbol of all parameters, and its parts: cost scale, T_robot_sensor, priors, data."""
        sizes = [1, 16 * self.n_sensors, 6 * self.n_poses, 12 * self.n_sensors]
        sizes += [b.size for b in self.blocks]
        p = ca.MX.sym("p", sum(sizes))
        return p, ca.vertsplit(p, np.cumsum([0, *sizes]).tolist())

    def _build(self):
        x = ca.MX.sym("x", self.n)
        p, (scale, poses, sigmas, prior, *data) = self._parameters()
        chain, maps = expressions.chain(), {}
        sums = {name: [] for name in ("cost", "gradient", "hessian", "information")}
        for b, d in zip(self.blocks, data, strict=True):
            key = (b.kind, b.sensor if b.kind == "corner" else b.target)
            if (key, b.n) not in maps:
                maps[key, b.n] = {
                    name: f.map(f"{name}_{b.n}", "serial", b.n, [0], [0])
                    for name, f in self._kernels[key].items()
                }
            s = ca.vertcat(ca.DM.ones(6), *(sigmas[6 * k : 6 * k + 6] for k in (b.robot, b.body)))
            T_robot_sensor = ca.reshape(poses[16 * b.sensor : 16 * b.sensor + 16], 4, 4)
            fixed = ca.DM(b.T_robot_body), ca.DM(b.T_body_target)
            T, A = chain(x[self._columns(b)], s, T_robot_sensor, *fixed)
            total = {k: m(T, ca.reshape(d, b.size // b.n, b.n)) for k, m in maps[key, b.n].items()}
            sums["cost"].append(total["cost"])
            sums["gradient"].append(A.T @ total["gradient"])
            for name in ("hessian", "information"):
                sums[name].append(ca.vec(A.T @ total[name] @ A))
        self._assemble(x, p, scale, prior, sums)

    def _columns(self, b):
        starts = (6 * b.sensor, 6 * (self.n_sensors + b.robot), 6 * (self.n_sensors + b.body))
        return [s + i for s in starts for i in range(6)]

    def _assemble(self, x, p, scale, prior, sums):
        """Sum blocks and priors into the cost, its gradient, Hessian and information."""
        k = 6 * self.n_sensors
        mean, weight = prior[:k], prior[k:]
        offset = ca.vertcat(weight * (x[:k] + mean), x[k:])
        f = ca.sum1(ca.vertcat(0, *sums["cost"])) + ca.dot(offset, offset) / 2
        g = ca.vertcat(weight, ca.DM.ones(self.n - k)) * offset
        h = information = ca.diag(ca.vertcat(weight**2, ca.DM.ones(self.n - k)))
        if self.blocks:
            rows = np.array([self._columns(b) for b in self.blocks])
            g += scatter(self.n, rows.reshape(-1)) @ ca.vertcat(*sums["gradient"])
            at = self.n, np.repeat(rows, 18, 1).reshape(-1), np.tile(rows, (1, 18)).reshape(-1)
            h = h + gather(*at, ca.vertcat(*sums["hessian"]))
            information = information + gather(*at, ca.vertcat(*sums["information"]))
        f, g, h = scale * f, scale * g, scale * h
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
        names = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        own = {
            "grad_f": ca.Function("nlp_grad_f", [x, p], [f, g], ["x", "p"], ["f", "grad_f_x"]),
            "hess_lag": ca.Function(
                "nlp_hess_l", [x, p, lam_f, lam_g], [ca.triu(lam_f * h)], *names
            ),
        }
        self._information = ca.Function("information", [x, p], [information])
        self._solver = ca.nlpsol("solver", "ipopt", {"x": x, "p": p, "f": f}, OPTIONS | own)

    def _values(self, T_robot_sensor, sigmas, mean, sigma, data):
        poses = np.transpose(T_robot_sensor, (0, 2, 1)).reshape(-1)
        parts = [[1.0], poses, sigmas.reshape(-1), mean.reshape(-1), 1 / sigma.reshape(-1)]
        return np.concatenate([*parts, *(d.T.reshape(-1) for d in data)])

    def solve(self, data, T_robot_sensor, sigmas, y, prior):
        """The optimum for data (columns, n) per block.

        Starts from T_robot_sensor (s, 4, 4) and the MCS errors y (k, 6) in units of their priors
        sigmas (k, 6). prior: means m (s, 6) and sigmas (s, 6) of the sensors, infinite for none.
        Raises nothing: whether IPOPT converged stands in the Solution.
        """
        mean, sigma = prior
        x0 = np.concatenate([np.zeros(6 * self.n_sensors), y.reshape(-1)])
        p = self._values(T_robot_sensor, sigmas, mean, sigma, data)
        # Scaled so that the largest curvature is one: tolerances then mean steps, in m and rad.
        p[0] = 1 / max(float(ca.mmax(ca.diag(self._information(x0, p)))), 1e-300)
        found = self._solver(x0=x0, p=p)
        x = np.array(found["x"]).reshape(-1, 6)
        stats = self._solver.stats()
        xi = x[: self.n_sensors]
        T = T_robot_sensor @ geometry.se3_exp(xi)
        at = self._values(T, sigmas, mean + xi, sigma, data)
        x_new = np.concatenate([np.zeros_like(xi), x[self.n_sensors :]]).reshape(-1)
        return Solution(
            T_robot_sensor=T,
            y=x[self.n_sensors :],
            step=xi,
            cost=float(found["f"]) / p[0],
            information=np.array(self._information(x_new, at)),
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


def scatter(n, rows):
    """Sparse (n, m) that adds entry j of a vector to row rows[j]."""
    m = len(rows)
    pattern = ca.Sparsity.triplet(n, m, rows.tolist(), list(range(m)))
    return ca.DM(pattern, 1.0)


def gather(n, i, j, values):
    """Sparse (n, n) with values[k] added at (i[k], j[k])."""
    where = i * n + j
    places, index = np.unique(where, return_inverse=True)
    summed = scatter(len(places), index.reshape(-1)) @ values
    # Triplets in the order of CasADi's columns, so that the values fall where they belong.
    columns_first = np.lexsort((places // n, places % n))
    order = places[columns_first]
    pattern = ca.Sparsity.triplet(n, n, (order // n).tolist(), (order % n).tolist())
    return ca.MX(pattern, summed[columns_first.tolist()])
