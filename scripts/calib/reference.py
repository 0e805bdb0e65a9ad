"""Reference accuracy: how well the very data in use could tell a pose, were all noise known.

The information of every measurement is taken at the true poses with the true noise, the errors of
the MCS poses are marginalised, one per placement and body, and the inverse is the covariance of an
efficient estimator. All scans of a placement count; a crossing of the outline counts once, as
uniform between two beams (step²/12), which an interval estimator may beat. No robust loss.
"""

from dataclasses import replace

import numpy as np

from calib import estimation, expressions, geometry, kinds

NO_NOISE = 1e-9  # m, rad: stands for none, so that a prior may be divided by it
ROUNDS = 5


def evaluate(setup, T_robot_sensor, range_sigma):
    """({sensor: covariance (6, 6)}, {(sensor, kind): σ of one measurement}) of a Setup.

    T_robot_sensor by name is the true one, range_sigma, m, too, and so is the σ of the setup's
    placements. The noise of what a camera finds is taken from its own errors at the truth.
    """
    state = estimation.start(setup, T_robot_sensor, 1.0)
    scales = true_noise(setup, state, range_sigma)
    state = replace(state, noise=scales)
    whole = estimation.covariance(information(setup, state))
    names = sorted(setup.models)
    covariances = {n: whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i, n in enumerate(names)}
    return covariances, {k: f * _own(_groups(setup, k)) for k, f in scales.items()}


def _groups(setup, key):
    return [g for g in setup.groups if (g.sensor, g.kind) == key]


def _own(groups):
    """The σ that keypoints came with: their median."""
    return float(np.median(np.concatenate([g.keypoints["sigma"] for g in groups])))


def true_noise(setup, state, range_sigma):
    """Factor on the keypoints' own σ, by (sensor, kind), that makes it the true one.

    Ranges: as given. Where σ is the step of a scan pattern: that. What is found in images: the rms
    of its errors at the truth, of all that belongs to a target there.
    """
    scales = dict(state.noise)
    for key in scales:
        kind, groups = kinds.KINDS[key[1]], _groups(setup, key)
        if kind.UNIT == "m":
            scales[key] = max(range_sigma, NO_NOISE) / _own(groups)
        elif kind.ROUNDING is not None:
            scales[key] = _found(replace(setup, groups=groups), state, key)
    return scales


def _found(setup, state, key):
    """RMS per component of the errors at the truth over their own σ, members by that very σ."""
    scale = 10.0
    for _ in range(ROUNDS):
        at = replace(state, noise=state.noise | {key: scale})
        assigned = estimation.assign_all(setup, at)
        values = np.concatenate([(a.value / a.sigma[:, None])[a.feature >= 0] for a in assigned])
        if not len(values):
            return scale
        scale *= float(np.sqrt(np.mean(values**2)))
    return scale


def information(setup, state):
    """(n, n) in the order (ξ of the sensors by name, y of the MCS poses in units of their σ)."""
    names = sorted(setup.models)
    first = 6 * len(names)
    total = np.eye(first + 12 * len(setup.placements))
    total[:first, :first] = 0
    kernels = {}
    for g, assigned in zip(setup.groups, estimation.assign_all(setup, state), strict=True):
        place = setup.placements[g.placement]
        key = g.kind, g.sensor, place.target
        if key not in kernels:
            kernels[key] = _kernel(g.kind, setup.models[g.sensor], setup.targets[place.target])
        T = estimation.T_sensor_target(setup, state, g.sensor, g.placement)
        A = chain(place, T)
        start, width = (6 * names.index(g.sensor), first + 12 * g.placement), (6, 12)
        rows = np.concatenate([s + np.arange(w) for s, w in zip(start, width, strict=True)])
        total[np.ix_(rows, rows)] += A.T @ of_measurements(kernels[key], T, assigned.data) @ A
    return total


def _kernel(kind, model, target):
    """Function of T_sensor_target and a measurement's numbers: its residual and derivative, σ."""
    residual = kinds.KINDS[kind].residual(model, target)
    return expressions.kernel(residual, len(kinds.KINDS[kind].DATA))


def of_measurements(kernel, T_sensor_target, data):
    """(6, 6) of data (columns, n) about the right perturbation of T_sensor_target."""
    n = data.shape[1]
    J = np.array(kernel.map("all", "serial", n, [0], [])(T_sensor_target[:3], data)[1])
    J = J.reshape(len(J), n, 6)
    return np.einsum("kni,knj->ij", J, J)


def chain(place, T_sensor_target):
    """(6, 18): the right perturbation of T_sensor_target by those of T_robot_sensor, and of the
    robot's and the target body's MCS pose in units of their σ; paper equation 1."""
    T_robot_target = place.T_robot_body @ place.T_body_target
    by_sensor, by_robot, by_body = (
        geometry.adjoint(geometry.inverse(T))
        for T in (T_sensor_target, T_robot_target, place.T_body_target)
    )
    return np.hstack([-by_sensor, -by_robot * place.sigma, by_body * place.sigma])
