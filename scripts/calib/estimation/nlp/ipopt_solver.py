"""The nonlinear program in CasADi, and its solver IPOPT; joint_nlp states the problem."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from calib.estimation.nlp.nlp_hessian import layout_hessian
from calib.estimation.nlp.symbolic_chain import make_condensed_cost

NLP_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "no_nlp_grad": True,  # derivatives by the parameters are not needed
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


class NlpSymbols(NamedTuple):
    """The parameters of the NLP, in the order in which JointNlp.solve packs them.

    size: scale of the cost; chain_inputs: of the condensed cost, without its x; theta, coupling,
    theta_gradient, theta_hessian: where θ was linearized, and JointNlp._theta_system.
    """

    size: ca.MX
    prior_mean: ca.MX
    prior_weight: ca.MX
    chain_inputs: list[ca.MX]
    pose_gradient: ca.MX
    pose_hessian: ca.MX
    theta: ca.MX
    coupling: ca.MX
    theta_gradient: ca.MX
    theta_hessian: ca.MX


def _make_nlp_symbols(n: int, p: int, b: int) -> tuple[ca.MX, ca.MX, NlpSymbols]:
    """Return unknowns x (n,), the last p of them θ, the packed parameters of b layouts, and these
    one by one."""
    shapes = [(1, 1), (n, 1), (n, 1), (24, b), *[(4, 4 * b)] * 3, (3, 4 * b), (6, b), (6, 6 * b)]
    shapes += [(p, 1), (6 * b, p), (p, 1), (p, p)]
    ends = np.cumsum([0] + [rows * columns for rows, columns in shapes]).tolist()
    x, packed = ca.MX.sym("x", n), ca.MX.sym("p", ends[-1])
    flat = ca.vertsplit(packed, ends)
    parts = [ca.reshape(v, *shape) for v, shape in zip(flat, shapes, strict=True)]
    size, mean, weight, *chain_inputs, g, H, theta, coupling, theta_gradient, theta_hessian = parts
    return (
        x,
        packed,
        NlpSymbols(
            size=size,
            prior_mean=mean,
            prior_weight=weight,
            chain_inputs=chain_inputs,
            pose_gradient=g,
            pose_hessian=H,
            theta=theta,
            coupling=coupling,
            theta_gradient=theta_gradient,
            theta_hessian=theta_hessian,
        ),
    )


def build_ipopt_solver(
    columns: np.ndarray, n_chain_unknowns: int, n_correction_values: int
) -> ca.Function:
    """Return the solver in x; all that changes between solutions is one vector of parameters.

    columns: (b, 24) of the factors, see FactorLayout.
    """
    n_chain, p, b = n_chain_unknowns, n_correction_values, len(columns)
    cost_function, derivative_function = (f.map(b) for f in make_condensed_cost())
    x, packed, s = _make_nlp_symbols(n_chain + p, p, b)
    chain_x = ca.reshape(ca.vertcat(x[:n_chain], 0)[columns.reshape(-1).tolist()], 24, b)
    step, offset = x[n_chain:] - s.theta, s.prior_weight * (x + s.prior_mean)
    # A step of θ acts on a pose as an additional gradient.
    gradients = s.pose_gradient + ca.reshape(s.coupling @ step, 6, b)
    inputs = chain_x, *s.chain_inputs, gradients, s.pose_hessian
    gradient, hessian, dpose_dx, eta = derivative_function(*inputs)
    cost = ca.sum2(cost_function(*inputs)) + ca.dot(offset, offset) / 2
    cost = s.size * (
        cost + ca.dot(step, s.theta_hessian @ step) / 2 + ca.dot(s.theta_gradient, step)
    )
    by_theta = s.coupling.T @ ca.vec(eta) + s.theta_hessian @ step + s.theta_gradient
    layout = layout_hessian(columns, n_chain, p)
    chain_gradient = layout.sum_gradient @ ca.vec(gradient)
    cost_gradient = s.size * (ca.vertcat(chain_gradient, by_theta) + s.prior_weight * offset)
    entries = _hessian_entries(s, hessian, dpose_dx, b if p else 0)
    factor, none = ca.MX.sym("factor"), ca.MX.sym("none", ca.Sparsity(0, 0))
    cost_hessian = ca.MX(layout.upper_triangle, factor * s.size * (layout.sum_hessian @ entries))
    derivatives = {
        "grad_f": ca.Function("nlp_grad_f", [x, packed], [cost, cost_gradient]),
        "hess_lag": ca.Function("nlp_hess_l", [x, packed, factor, none], [cost_hessian]),
    }
    problem: dict[str, Any] = {"x": x, "p": packed, "f": cost}
    return ca.nlpsol("nlp", "ipopt", problem, NLP_OPTIONS | derivatives)


def _hessian_entries(s: NlpSymbols, hessian: ca.MX, dpose_dx: ca.MX, n_coupled: int) -> ca.MX:
    """Return the parts of the Hessian one below the other, in the order of layout_hessian.

    n_coupled: number of factors with blocks between pose and θ; 0 without θ.
    """
    mixed = [
        dpose_dx[:, 24 * k : 24 * k + 24].T @ s.coupling[6 * k : 6 * k + 6, :]
        for k in range(n_coupled)
    ]
    return ca.vertcat(
        ca.vec(hessian), s.prior_weight**2, *(ca.vec(m) for m in mixed), ca.vec(s.theta_hessian)
    )
