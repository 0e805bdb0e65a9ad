"""CasADi expressions: SE(3), the chain of poses, and residuals with their derivatives."""

from functools import cache

import casadi as ca

from calib.geometry.se3 import so3_exp_coefficients

ca.GlobalOptions.setNumpyMode(1)


def symbolic_se3_exp(xi):
    """T (4, 4) of a twist xi (6), smooth at zero."""
    v, K = xi[:3], ca.skew(xi[3:])
    a, b, c = so3_exp_coefficients(ca.dot(xi[3:], xi[3:]))
    K2 = K @ K
    R = ca.DM.eye(3) + a * K + b * K2
    t = (ca.DM.eye(3) + b * K + c * K2) @ v
    return ca.vertcat(ca.horzcat(R, t), ca.DM([[0, 0, 0, 1]]))


def symbolic_inverse(T):
    """T_b_a (4, 4) of T_a_b."""
    R = T[:3, :3].T
    return ca.vertcat(ca.horzcat(R, -R @ T[:3, 3]), ca.DM([[0, 0, 0, 1]]))


def make_residual_function(residual, columns):
    """Function (T (3, 4), d (columns)) -> r (k), J (k, 6) of one measurement, in σ.

    J is the derivative by the right perturbation of T_sensor_target.
    """
    T, d, eta = ca.SX.sym("T", 3, 4), ca.SX.sym("d", columns), ca.SX.sym("eta", 6)
    R, t = T[:, :3], T[:, 3]
    moved = residual(R @ (ca.DM.eye(3) + ca.skew(eta[3:])), t + R @ eta[:3], d)
    outputs = [moved, ca.jacobian(moved, eta)]
    outputs = ca.cse([ca.densify(ca.substitute(o, eta, ca.DM.zeros(6))) for o in outputs])
    return ca.Function("kernel", [T, d], outputs)


def _chain_expression():
    """Symbols x (24), s (24), three poses (4, 4), and T_sensor_target (3, 4) of them.

    x holds the twists of the sensor, of the target in its body, of the robot's MCS pose and of the
    body's, in units of s:
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
def make_chain_function():
    """Function (x, s, T_robot_sensor, T_robot_body, T_body_target) -> T_sensor_target (3, 4); paper
    equation 1 (_chain)."""
    inputs, T = _chain_expression()
    return ca.Function("chain", inputs, ca.cse([T]))


@cache
def make_condensed_cost():
    """Functions of chain's inputs and T0 (3, 4), g (6), H (6, 6), of a cost that is ½ ηᵀHη + gᵀη of
    the perturbation η of T_sensor_target from T0: to the cost, and to its gradient (24), Hessian
    (24, 24), dη/dx (6, 24) and η (6).

    η = (R₀ᵀ(t - t₀), vee(R₀ᵀR)) is the right perturbation to first order; the Hessian leaves out
    its curvature, as Gauss and Newton do.
    """
    inputs, T = _chain_expression()
    T0, g, H = ca.SX.sym("T0", 3, 4), ca.SX.sym("g", 6), ca.SX.sym("H", 6, 6)
    turned = T0[:, :3].T @ T[:, :3]
    eta = ca.vertcat(T0[:, :3].T @ (T[:, 3] - T0[:, 3]), ca.inv_skew((turned - turned.T) / 2))
    cost = ca.dot(g, eta) + ca.dot(eta, H @ eta) / 2
    B = ca.jacobian(eta, inputs[0])
    slopes = [ca.densify(o) for o in (B.T @ (g + H @ eta), B.T @ H @ B, B, eta)]
    inputs = [*inputs, T0, g, H]
    return ca.Function("cost", inputs, ca.cse([cost])), ca.Function(
        "slopes", inputs, ca.cse(slopes)
    )
