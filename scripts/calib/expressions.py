"""CasADi expressions: SE(3), the chain of poses, and residuals with their derivatives."""

import casadi as ca

from calib.geometry import exp_coefficients

ca.GlobalOptions.setNumpyMode(1)


def se3_exp(xi):
    """T (4, 4) of a twist xi (6), smooth at zero."""
    v, K = xi[:3], ca.skew(xi[3:])
    a, b, c = exp_coefficients(ca.dot(xi[3:], xi[3:]))
    K2 = K @ K
    R = ca.DM.eye(3) + a * K + b * K2
    t = (ca.DM.eye(3) + b * K + c * K2) @ v
    return ca.vertcat(ca.horzcat(R, t), ca.DM([[0, 0, 0, 1]]))


def inverse(T):
    """T_b_a (4, 4) of T_a_b."""
    R = T[:3, :3].T
    return ca.vertcat(ca.horzcat(R, -R @ T[:3, 3]), ca.DM([[0, 0, 0, 1]]))


def kernel(residual, columns):
    """Function (T (3, 4), d (columns)) -> r (k), J (k, 6) of one measurement, in σ.

    J is the derivative by the right perturbation of T_sensor_target.
    """
    T, d, eta = ca.SX.sym("T", 3, 4), ca.SX.sym("d", columns), ca.SX.sym("eta", 6)
    R, t = T[:, :3], T[:, 3]
    moved = residual(R @ (ca.DM.eye(3) + ca.skew(eta[3:])), t + R @ eta[:3], d)
    outputs = [moved, ca.jacobian(moved, eta)]
    r, J = (ca.densify(ca.substitute(o, eta, ca.DM.zeros(6))) for o in outputs)
    return ca.Function("kernel", [T, d], [r, J])


def chain():
    """Function (x (18), s (18), T_robot_sensor, T_robot_body, T_body_target) -> T (3, 4), A (6, 18)

    x holds the twists of the sensor, of the robot's MCS pose and of the target's MCS pose, the
    latter two in units of their priors s:
    T_sensor_target = (T_robot_sensor Exp(x₁))⁻¹ Exp(-s₂x₂) T_robot_body Exp(s₃x₃) T_body_target,
    which is paper equation 1 with both measured poses corrected. A = d(right perturbation)/dx.
    """
    x, s = ca.SX.sym("x", 18), ca.SX.sym("s", 18)
    T_robot_sensor, T_robot_body, T_body_target = (ca.SX.sym(n, 4, 4) for n in "abc")
    xi = s * x
    robot_target = se3_exp(-xi[6:12]) @ T_robot_body @ se3_exp(xi[12:]) @ T_body_target
    T = (se3_exp(-xi[:6]) @ inverse(T_robot_sensor) @ robot_target)[:3, :]
    R, t = T[:, :3], T[:, 3]
    rows = [R.T @ ca.jacobian(t, x)]
    rows += [R[:, i].T @ ca.jacobian(R[:, j], x) for i, j in ((2, 1), (0, 2), (1, 0))]
    inputs = [x, s, T_robot_sensor, T_robot_body, T_body_target]
    return ca.Function("chain", inputs, [T, ca.densify(ca.vertcat(*rows))])
