"""The joint problem: all sensors, targets and placements in one nonlinear programme.

    minimise over ξ, y, θ:
    Σ_i w_i ρ(|r_i(T_sensor_target, θ)|²) + ½ Σ_k |y_k|² + ½ Σ_s |(ξ_s+m_s)/p_s|² + ½ |θ|²

with T_sensor_target from the sensor's ξ_s, the target's ξ_t where its mount is estimated, and the
two MCS pose errors of its placement, in units of their priors, y (expressions.chain; paper
equations 1 to 4). One y per (placement, body) is shared by all scans, images and sensors of the
placement, and the robot's by all targets that rest at the same time. θ are further numbers of
sensors, in units of their priors (hypothesis.Hypothesis).

The measurements of a group depend on one pose and on θ. They are condensed, about where these
stand, to the gradient and the Gauss-Newton Hessian by them, and IPOPT finds the poses of the whole
chain, and θ, that minimise the sum; estimation.estimate condenses again there, until nothing moves.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calib.estimation.nlp.casadi_vectorized import vectorize_casadi_function
from calib.estimation.nlp.measurement_factor import Factor, joint_information
from calib.estimation.nlp.symbolic_chain import (
    make_chain_function,
    make_condensed_cost,
    make_residual_function,
)
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.estimation.residuals.robust_loss import tukey_cost

NLP_OPTIONS = {
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
class FactorLayout:
    """The measurements of one kind that one sensor made of one target in one placement.

    columns (24,): its unknowns in the order of expressions.chain, the number of all unknowns of
    chains for none; numbers (q,): which of θ its residuals depend on.
    """

    sensor: str
    kind: str
    target: str
    columns: np.ndarray
    correction_index: np.ndarray


@dataclass(frozen=True)
class LinearizationPoses:
    """Of every block, (b, 4, 4): T_robot_sensor, measured T_robot_body, T_body_target."""

    T_robot_sensor: np.ndarray
    T_robot_body: np.ndarray
    T_body_target: np.ndarray


@dataclass(frozen=True)
class NlpSolution:
    """The unknowns x (n,) at the optimum: twists from where they stood, and MCS errors."""

    x: np.ndarray
    n_iterations: int
    status: str
    has_converged: bool


class JointNlp:
    """The programme of fixed blocks; measurements, poses and noise change between solutions.

    models: name -> Camera or rig.Lidar; targets: name -> shape; chained, p: number of unknowns of
    the chains and of θ.
    """

    def __init__(self, models, targets, layouts, n_chain_unknowns, n_correction_values):
        self.layouts, self.n_chain_unknowns, self.n_correction_values = (
            layouts,
            n_chain_unknowns,
            n_correction_values,
        )
        self.residual_functions, self.targets = {}, targets
        self.set_models(models)
        self.columns = np.stack([b.columns for b in layouts])
        self.chain_function = make_chain_function().map(len(layouts))
        self.cost_function, self.derivative_function = (
            f.map(len(layouts)) for f in make_condensed_cost()
        )
        self.solver = self._build_solver()

    def set_models(self, models):
        """Residuals by those models from now on; name -> Camera or rig.Lidar."""
        for key in sorted({(b.kind, b.sensor, b.target) for b in self.layouts}):
            if key[1] in models:
                kind = RESIDUAL_KINDS[key[0]]
                residual = kind.residual(models[key[1]], self.targets[key[2]])
                kernel = make_residual_function(residual, len(kind.DATA_COLUMNS))
                self.residual_functions[key] = vectorize_casadi_function(kernel)

    def linearize(self, x, scale, poses, assignments, correction_derivatives, view_error_priors):
        """A Part for the Assignment of every block, at unknowns x (n,) in units of scale (n,).

        correction_derivatives: of every block, derivatives (q, k, n) by its numbers of θ, in units of their scale;
        view_error_priors: of every block, (spread, error) of a Part.
        """
        inputs = self._chain_inputs(x, scale, poses)
        T = np.array(self.chain_function(*inputs)).reshape(3, len(self.layouts), 4).swapaxes(0, 1)
        none = np.zeros((6, len(self.layouts))), np.zeros((6, 6 * len(self.layouts)))
        A = np.array(self.derivative_function(*inputs, np.hstack(T), *none)[2]).reshape(
            6, len(self.layouts), 24
        )
        return [
            self._linearize_block(b, a, T[k], A[:, k], D, own)
            for k, (b, a, D, own) in enumerate(
                zip(
                    self.layouts,
                    assignments,
                    correction_derivatives,
                    view_error_priors,
                    strict=True,
                )
            )
        ]

    def _linearize_block(self, layout, assignment, T, A, J_theta, view_error_prior):
        data = assignment.weighted_data
        n = data.shape[1]
        r, J = self.residual_functions[layout.kind, layout.sensor, layout.target](
            T.T.reshape(-1), data
        )
        r = np.stack([np.broadcast_to(v, n) for v in r])
        J = np.stack([np.broadcast_to(v, n) for v in J]).reshape(6, len(r), n).swapaxes(0, 1)
        out = assignment.feature < 0
        used = layout.columns < self.n_chain_unknowns
        A = np.column_stack([A[:, used], np.zeros((6, len(layout.correction_index)))])
        columns = np.concatenate(
            [layout.columns[used], self.n_chain_unknowns + layout.correction_index]
        )
        whole = np.vstack([T, [0, 0, 0, 1]])
        r[:, out], J[:, :, out] = 0, 0
        total = tukey_cost(
            assignment.standardized_norm[~out],
            assignment.effective_weight[~out],
            assignment.gate_sigma,
        )
        return Factor(
            whole,
            r,
            J,
            np.where(out, 0.0, J_theta),
            assignment.weight,
            total,
            columns,
            A,
            *view_error_prior,
        )

    def solve(self, factors, x, scale, poses, prior):
        """The Solution, from x (n,) in units of scale (n,), of measurements condensed to parts.

        prior: means (n,) and weights (n,) of the unknowns: ½ Σ (weight (x + mean))². Raises
        nothing: whether IPOPT converged stands in the Solution. The cost is scaled so that the
        largest curvature is one: tolerances then mean steps, in m, rad.
        """
        mean, weight = prior
        size = 1 / max(joint_information(factors, weight).diagonal().max(), 1e-300)
        T0 = np.hstack([p.T_sensor_target[:3] for p in factors])
        g = np.column_stack([p.pose_gradient for p in factors])
        H = np.hstack([p.pose_information for p in factors])
        of_theta = x[self.n_chain_unknowns :], *self._theta_system(factors)
        given = [size, mean, weight, *self._chain_inputs(x, scale, poses)[1:], T0, g, H, *of_theta]
        packed = np.concatenate([np.ravel(v, order="F") for v in given])
        found = self.solver(x0=x, p=packed)
        stats = self.solver.stats()
        return NlpSolution(
            x=np.array(found["x"]).reshape(-1),
            n_iterations=int(stats["iter_count"]),
            status=stats["return_status"],
            has_converged=bool(stats["success"]),
        )

    def _chain_inputs(self, x, scale, poses):
        """The arguments of chain for all blocks, side by side."""
        both = (x[: self.n_chain_unknowns], 0.0), (scale[: self.n_chain_unknowns], 1.0)
        both = [np.append(v, fill)[self.columns].T for v, fill in both]
        return *both, *(np.hstack(T) for T in vars(poses).values())

    def _theta_system(self, parts):
        """Coupling (6 b, p) between the blocks' poses and θ, gradient (p,) and Hessian (p, p)."""
        across = np.zeros((len(parts), 6, self.n_correction_values))
        slope, curved = (
            np.zeros(self.n_correction_values),
            np.zeros((self.n_correction_values, self.n_correction_values)),
        )
        for k, (b, part) in enumerate(zip(self.layouts, parts, strict=True)):
            q = len(b.correction_index)
            if q:
                across[k][:, b.correction_index] = part.pose_theta_information
                slope[b.correction_index] += part.theta_system[1]
                curved[np.ix_(b.correction_index, b.correction_index)] += part.theta_system[0]
        return across.reshape(6 * len(parts), self.n_correction_values), slope, curved

    def _build_solver(self):
        """The NLP in x, given all that changes between solutions as one vector of parameters."""
        n, p, b = (
            self.n_chain_unknowns + self.n_correction_values,
            self.n_correction_values,
            len(self.layouts),
        )
        x, given, parts = _make_nlp_symbols(n, p, b)
        size, mean, weight, *poses, g, H, theta, across, score, curved = parts
        own = ca.reshape(
            ca.vertcat(x[: self.n_chain_unknowns], 0)[self.columns.reshape(-1).tolist()], 24, b
        )
        step, offset = x[self.n_chain_unknowns :] - theta, weight * (x + mean)
        # What θ moves acts on a pose as a force more.
        rest = *poses, g + ca.reshape(across @ step, 6, b), H
        gradient, hessian, B, eta = self.derivative_function(own, *rest)
        cost = ca.sum2(self.cost_function(own, *rest)) + ca.dot(offset, offset) / 2
        cost = size * (cost + ca.dot(step, curved @ step) / 2 + ca.dot(score, step))
        by_theta = across.T @ ca.vec(eta) + curved @ step + score
        triangle, scatter, place = _layout_hessian(self.columns, self.n_chain_unknowns, p)
        slope = size * (ca.vertcat(scatter @ ca.vec(gradient), by_theta) + weight * offset)
        mixed = [
            B[:, 24 * k : 24 * k + 24].T @ across[6 * k : 6 * k + 6, :] for k in range(b * (p > 0))
        ]
        entries = [ca.vec(hessian), weight**2, *(ca.vec(m) for m in mixed), ca.vec(curved)]
        factor, none = ca.MX.sym("factor"), ca.MX.sym("none", ca.Sparsity(0, 0))
        second = ca.MX(triangle, factor * size * (place @ ca.vertcat(*entries)))
        derivatives = {
            "grad_f": ca.Function("nlp_grad_f", [x, given], [cost, slope]),
            "hess_lag": ca.Function("nlp_hess_l", [x, given, factor, none], [second]),
        }
        return ca.nlpsol("nlp", "ipopt", {"x": x, "p": given, "f": cost}, NLP_OPTIONS | derivatives)


def _make_nlp_symbols(n, p, b):
    """Unknowns x (n,), the last p of them θ, all parameters of b blocks as one vector, and its
    parts: the scale of the cost, the priors' means and weights, what expressions.condensed takes
    but x, where θ stands, and its coupling, gradient and Hessian (Problem._by_theta)."""
    shapes = [(1, 1), (n, 1), (n, 1), (24, b), *[(4, 4 * b)] * 3, (3, 4 * b), (6, b), (6, 6 * b)]
    shapes += [(p, 1), (6 * b, p), (p, 1), (p, p)]
    ends = np.cumsum([0] + [rows * columns for rows, columns in shapes]).tolist()
    x, given = ca.MX.sym("x", n), ca.MX.sym("p", ends[-1])
    flat = ca.vertsplit(given, ends)
    return x, given, [ca.reshape(v, *shape) for v, shape in zip(flat, shapes, strict=True)]


def _layout_hessian(columns, chained, p):
    """Sparsity of the Hessian's upper triangle, and constant matrices that add up in it, and in the
    gradient, what the blocks say of their own unknowns, columns (b, 24), and of p numbers θ.

    What is added up, column by column as CasADi lays it out: the blocks' Hessians (24, 24), the
    diagonal, and, where there are θ, the blocks' (24, p) and θ's own (p, p).
    """
    n, theta = chained + p, chained + np.arange(p)
    flat = columns.reshape(-1)
    used = np.flatnonzero(flat < chained)
    scatter = _selection_matrix(flat[used], used, chained, len(flat))
    known = np.where(columns < chained, columns, n)
    rows = [np.tile(known, (1, 24)), np.arange(n), np.tile(known, (1, p)), np.tile(theta, p)]
    places = [np.repeat(known, 24, axis=1), np.arange(n)]
    places += [np.tile(np.repeat(theta, 24), len(columns)), np.repeat(theta, p)]
    row, column = (np.concatenate([np.ravel(v) for v in values]) for values in (rows, places))
    upper = np.flatnonzero((row <= column) & (column < n))
    keys, at = np.unique(column[upper] * n + row[upper], return_inverse=True)
    triangle = ca.Sparsity.triplet(n, n, (keys % n).tolist(), (keys // n).tolist())
    return triangle, scatter, _selection_matrix(at, upper, len(keys), len(row))


def _selection_matrix(rows, columns, height, width):
    """Sparse matrix (height, width) that is 1 at those places."""
    pattern = ca.Sparsity.triplet(height, width, rows.tolist(), columns.tolist())
    return ca.DM(pattern, 1.0)
