"""CasADi expressions: SE(3), and what each kind of measurement says about T_sensor_target.

A residual is a function of R (3, 3), t (3), of T_sensor_target and of one measurement's numbers,
whose last one is 1/σ (0 takes the measurement out); it is in units of σ. Its entry in DATA names
the numbers. To add a kind: write its residual, add it to `residual_of`.
"""

import casadi as ca

from calib import cameras
from calib.geometry import exp_coefficients

ca.GlobalOptions.setNumpyMode(1)

DATA = {
    "corner": ("u", "v", "x", "y", "z", "weight"),
    "surface": ("x", "y", "z", "weight"),
    "edge": ("dx", "dy", "dz", "ax", "ay", "az", "bx", "by", "bz", "weight"),
}


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


def corner_residual(camera):
    """Paper equation 3: the measured pixel minus the projected corner, over σ; (2)."""
    project = cameras.MODELS[camera.model].project

    def residual(R, t, d):
        p = R @ d[2:5] + t
        u, v = project(camera.params, p[0], p[1], p[2])
        return ca.vertcat(d[0] - u, d[1] - v) * d[5]

    return residual


def surface_residual(target):
    """Distance of a measured point from the target's surface, over σ; (1)."""

    def residual(R, t, d):
        q = R.T @ (d[:3] - t)
        return target.distance(q[0], q[1], q[2]) * d[3]

    return residual


def edge_residual(R, t, d):
    """Angle between a ray (lidar frame) and the plane through the lidar and an outline edge; (1).

    It is what a beam can tell of an edge: the crossing's direction, not its range.
    """
    ray, a, b = d[:3], R @ d[3:6] + t, R @ d[6:9] + t
    normal = ca.cross(a, b)
    return ca.dot(normal, ray) / ca.sqrt(ca.dot(normal, normal) + 1e-20) * d[9]


def residual_of(kind, sensor, target):
    """The residual of a kind of measurement by a sensor of a target."""
    if kind == "corner":
        return corner_residual(sensor)
    if kind == "surface":
        return surface_residual(target)
    return edge_residual


def kernels(residual, columns, gate):
    """Cost, gradient (6), Hessian and information (6, 6) of one measurement, functions of T and d.

    Derivatives are by the right perturbation of T_sensor_target. The loss is Tukey's biweight, with
    weight w: it ends at the gate, in σ, so that nothing jumps when a measurement crosses it. The
    information is JᵀwJ. The Hessian is Gauss-Newton's with the curvature of the loss along the
    residual, which w overstates, so that a few steps suffice; it is held above w/10, for the
    curvature turns negative towards the gate.
    """
    T, d, eta = ca.SX.sym("T", 3, 4), ca.SX.sym("d", columns), ca.SX.sym("eta", 6)
    R, t = T[:, :3], T[:, 3]
    moved = residual(R @ (ca.DM.eye(3) + ca.skew(eta[3:])), t + R @ eta[:3], d)
    zero = ca.DM.zeros(6)
    r = ca.substitute(moved, eta, zero)
    J = ca.substitute(ca.jacobian(moved, eta), eta, zero)
    inside = ca.fmax(1 - ca.dot(r, r) / gate**2, 0)
    weight = inside**2
    curvature = ca.fmax(inside * (5 * inside - 4), 0.1 * weight)
    outputs = {
        "cost": gate**2 / 6 * (1 - inside**3),
        "gradient": weight * (J.T @ r),
        "hessian": curvature * (J.T @ J),
        "information": weight * (J.T @ J),
    }
    return {name: ca.Function(name, [T, d], [ca.densify(o)]) for name, o in outputs.items()}


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
