"""Reference accuracy: how well the very data in use could tell a pose, were all noise known.

The information of every measurement is taken at the true poses with the true noise, the errors of
the MCS poses are marginalised, one per body and rest, and the inverse is the covariance of an
efficient estimator. All scans of a placement count, but where a scan line leaves a target counts
once, as uniform between two beams (step²/12), which an interval estimator may beat. That holds for
the outline of a board and for the sides of a cylinder. No robust loss.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import estimate_state, noise_model, pose_chain, solver
from calib.estimation.nlp import symbolic_chain
from calib.estimation.nlp.information_matrix import covariance
from calib.estimation.residuals import board_outline, cylinder_limb, residual_registry
from calib.estimation.residuals.assignment import Noise
from calib.geometry import se3
from calib.targets.cylinder import Cylinder

NO_NOISE = 1e-9  # m, rad: stands for none, so that a prior may be divided by it
ROUNDS = 5
TANGENT = 1.5  # steps of the scan pattern by which the ray of a side's crossing may miss it


@dataclass(frozen=True)
class Reference:
    """By sensor the covariance (6, 6), and the one without where scan lines leave the targets; by
    (sensor, kind) the σ of one measurement."""

    covariance: dict
    inside: dict
    sigma: dict


def evaluate(setup, T_robot_sensor, range_sigma):
    """The Reference of a Setup.

    T_robot_sensor by name is the true one, range_sigma, m, too, and so is the σ of the setup's
    placements. The noise of what a camera finds is taken from its own errors at the truth.
    """
    state = estimate_state.start(setup, T_robot_sensor, 1.0)
    state = replace(state, noise=true_noise(setup, state, range_sigma))
    inside, outlines = information(setup, state)
    return Reference(
        covariance=_of_sensors(setup, inside + outlines),
        inside=_of_sensors(setup, inside),
        sigma={key: n.total * _own(_groups(setup, key)) for key, n in state.noise.items()},
    )


def _of_sensors(setup, information):
    whole = covariance(information)
    names = sorted(setup.models)
    return {n: whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i, n in enumerate(names)}


def _groups(setup, key):
    return [g for g in setup.groups if (g.sensor, g.kind) == key]


def _own(groups):
    """The σ that keypoints came with: their median."""
    return float(np.median(np.concatenate([g.keypoints["sigma"] for g in groups])))


def true_noise(setup, state, range_sigma):
    """Noise over the keypoints' own σ, by (sensor, kind).

    Ranges: as given. What is found in images: of its errors at the truth, of all that belongs to a
    target there, with what all images of a placement have in common. Where scan lines leave a
    target: the step, the same in every scan.
    """
    known = dict(state.noise)
    for key in known:
        kind, groups = residual_registry.KINDS[key[1]], _groups(setup, key)
        if kind.UNIT == "m":
            known[key] = Noise(max(range_sigma, NO_NOISE) / _own(groups), 0.0)
        elif kind.ROUNDING is not None:
            known[key] = _found(replace(setup, groups=groups), state, key)
    return known


def _found(setup, state, key):
    """Noise of the errors at the truth: their rms per component, members by that very σ."""
    known = {key: Noise(10.0, 0.0)}
    for _ in range(ROUNDS):
        assigned = solver.assign_all(setup, replace(state, noise=state.noise | known))
        values = np.concatenate([a.plain[a.feature >= 0] for a in assigned])
        if not len(values):
            return known[key]
        known[key] = Noise(float(np.sqrt(np.mean(values**2))), 0.0)
    return noise_model.shared(setup, assigned, known, {key: 0.0})[key]


def information(setup, state):
    """(n, n), twice, of all unknowns of the estimate: of what lies on the targets, with the priors
    of the MCS, and of where scan lines leave the targets."""
    assigned = solver.assign_all(setup, state)
    given = *pose_chain.unknowns(setup, state), pose_chain.chains(setup, state), assigned
    slopes, errors = solver.slopes(setup, state, assigned), solver.errors(setup, state)
    parts = solver.build(setup).parts(*given, slopes, errors)
    inside, outlines = np.zeros((2, setup.n, setup.n))
    np.fill_diagonal(inside[setup.poses :, setup.poses :], 1.0)
    for g, a, p in zip(setup.groups, assigned, parts, strict=True):
        model, target = setup.models[g.sensor], setup.targets[setup.placements[g.placement].target]
        square = np.ix_(p.columns, p.columns)
        weight = np.where(a.feature >= 0, a.share, 0.0)
        own = sum((weight * J) @ J.T for J in p.J)
        (outlines if g.kind == "edge" else inside)[square] += p.A.T @ own @ p.A
        if g.kind == "surface" and isinstance(target, Cylinder):
            sides = of_sides(model, target, p.T_sensor_target, outermost(g, a, model))
            outlines[square] += p.A.T @ sides @ p.A
    return inside, outlines


def outermost(group, assigned, lidar):
    """Rays (2 n, 3), lidar frame, half a step beyond the first and last return of each of n rings,
    all scans of the placement together."""
    k, member = group.keypoints, assigned.feature >= 0
    middle = np.arctan2(*k["xyz"][member].mean(0)[1::-1]) if member.any() else 0.0
    azimuth = (np.arctan2(*k["xyz"].T[1::-1]) - middle + np.pi) % (2 * np.pi)
    rays = []
    for ring in np.unique(k["index"][assigned.candidate]):
        rows = np.flatnonzero(k["index"] == ring)
        for at, way in ((azimuth[rows].argmin(), -1), (azimuth[rows].argmax(), 1)):
            turn = se3.so3_exp([0.0, 0.0, way * lidar.azimuth_step / 2])
            rays.append(turn @ k["xyz"][rows[at]])
    rays = np.reshape(rays, (-1, 3))
    return rays / np.linalg.norm(rays, axis=1)[:, None]


def of_sides(lidar, target, T_sensor_target, ray):
    """(6, 6) of the rays (n, 3) among those given that touch a cylinder's side, about the right
    perturbation of T_sensor_target."""
    axis, centre = T_sensor_target[:3, 0], T_sensor_target[:3, 3]
    normal = np.cross(axis, ray)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    across = np.cross(normal, axis)
    depth = (across @ centre) / np.sum(across * ray, 1)
    along = np.abs(ray @ axis * depth - centre @ axis)
    miss = np.abs(np.abs(normal @ centre) - target.radius)
    turning = np.abs(np.sum(normal * np.cross([0.0, 0.0, 1.0], ray), 1))
    rows = (miss < TANGENT * lidar.azimuth_step * depth) & (turning > board_outline.ALONG_SCAN)
    rows &= along < target.length / 2 - board_outline.VERTEX_M
    sigma = lidar.azimuth_step / np.sqrt(12) * turning * depth
    side, one = np.sign(normal @ centre), np.ones(len(ray))
    data = np.column_stack([ray, side, one, 1 / sigma])[rows].T
    if not rows.any():
        return np.zeros((6, 6))
    kernel = symbolic_chain.kernel(cylinder_limb.residual(lidar, target), len(cylinder_limb.DATA))
    every = kernel.map("every", "serial", data.shape[1], [0], [])
    J = np.array(every(T_sensor_target[:3], data)[1]).reshape(-1, 6)
    return J.T @ J
