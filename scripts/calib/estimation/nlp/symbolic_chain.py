"""CasADi expressions: SE(3), the chain of poses, and residuals with their derivatives."""

from collections.abc import Callable
from functools import cache

import casadi as ca

from calib.geometry.se3 import so3_exp_coefficients

ca.GlobalOptions.setNumpyMode(1)


def symbolic_se3_exp(xi: ca.SX) -> ca.SX:
    """Return T (4, 4) of a twist xi (6), smooth at zero."""
    v, K = xi[:3], ca.skew(xi[3:])
    a, b, c = so3_exp_coefficients(ca.dot(xi[3:], xi[3:]))
    K2 = K @ K
    R = ca.DM.eye(3) + a * K + b * K2
    t = (ca.DM.eye(3) + b * K + c * K2) @ v
    return ca.vertcat(ca.horzcat(R, t), ca.DM([[0, 0, 0, 1]]))


def symbolic_inverse(T: ca.SX) -> ca.SX:
    """Return T_b_a (4, 4) of T_a_b."""
    R = T[:3, :3].T
    return ca.vertcat(ca.horzcat(R, -R @ T[:3, 3]), ca.DM([[0, 0, 0, 1]]))


def make_residual_function(residual: Callable[..., ca.SX], n_data: int) -> ca.Function:
    """Return the function (T (3, 4), d (n_data)) -> r (k), J (k, 6) of one measurement, in σ.

    residual: of a kind of measurement; J: by the right perturbation of T_sensor_target.
    """
    T, d, eta = ca.SX.sym("T", 3, 4), ca.SX.sym("d", n_data), ca.SX.sym("eta", 6)
    R, t = T[:, :3], T[:, 3]
    perturbed = residual(R @ (ca.DM.eye(3) + ca.skew(eta[3:])), t + R @ eta[:3], d)
    outputs = [perturbed, ca.jacobian(perturbed, eta)]
    outputs = ca.cse([ca.densify(ca.substitute(o, eta, ca.DM.zeros(6))) for o in outputs])
    return ca.Function("kernel", [T, d], outputs)


def _chain_expression() -> tuple[list[ca.SX], ca.SX]:
    """Return the symbols x (24), s (24) and three poses (4, 4), and T_sensor_target (3, 4).

    x: twists, in units of s, of the sensor, of the target's mount, and of the errors of the motion
    capture poses of robot and body:
    T_sensor_target = (T_robot_sensor Exp(ξ₁))⁻¹ T_robot_target,
    T_robot_target = Exp(-ξ₃) T_robot_body Exp(ξ₄) T_body_target Exp(ξ₂),
    which is paper equation 1 with both measured poses corrected.
    """
    x, s = ca.SX.sym("x", 24), ca.SX.sym("s", 24)
    poses = [ca.SX.sym(n, 4, 4) for n in ("T_robot_sensor", "T_robot_body", "T_body_target")]
    sensor, mount, robot, body = ca.vertsplit(s * x, 6)
    T_sensor_robot = symbolic_se3_exp(-sensor) @ symbolic_inverse(poses[0])
    T_robot_target = (
        symbolic_se3_exp(-robot)
        @ poses[1]
        @ symbolic_se3_exp(body)
        @ poses[2]
        @ symbolic_se3_exp(mount)
    )
    return [x, s, *poses], (T_sensor_robot @ T_robot_target)[:3, :]


@cache
def make_chain_function() -> ca.Function:
    """Return (x, s, T_robot_sensor, T_robot_body, T_body_target) -> T_sensor_target (3, 4).

    Paper equation 1; see _chain_expression.
    """
    inputs, T = _chain_expression()
    return ca.Function("chain", inputs, ca.cse([T]))


@cache
def make_condensed_cost() -> tuple[ca.Function, ca.Function]:
    """Return the functions of the cost ½ ηᵀHη + gᵀη, and of its derivatives.

    η: perturbation of T_sensor_target from T0. Inputs: of the chain function, T0 (3, 4), g (6)
    and H (6, 6). Outputs: the cost; gradient (24), Hessian (24, 24), dη/dx (6, 24) and η (6).

    η = (R₀ᵀ(t - t₀), vee(R₀ᵀR)) is the right perturbation to first order; the Hessian
    omits its curvature (Gauss-Newton).
    """
    inputs, T = _chain_expression()
    T0, g, H = ca.SX.sym("T0", 3, 4), ca.SX.sym("g", 6), ca.SX.sym("H", 6, 6)
    R = T0[:, :3].T @ T[:, :3]
    eta = ca.vertcat(T0[:, :3].T @ (T[:, 3] - T0[:, 3]), ca.inv_skew((R - R.T) / 2))
    cost = ca.dot(g, eta) + ca.dot(eta, H @ eta) / 2
    B = ca.jacobian(eta, inputs[0])
    derivatives = [ca.densify(o) for o in (B.T @ (g + H @ eta), B.T @ H @ B, B, eta)]
    inputs = [*inputs, T0, g, H]
    return (
        ca.Function("cost", inputs, ca.cse([cost])),
        ca.Function("derivatives", inputs, ca.cse(derivatives)),
    )
