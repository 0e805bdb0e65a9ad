"""Solve, re-estimate the noise, re-associate, and again until nothing moves."""

from dataclasses import dataclass, field

import numpy as np

from calib import geometry, kinds
from calib.problem import Block, Problem

MAD_TO_SIGMA = 1.4826
UNIFORM_MEDIAN = np.sqrt(3) / 2  # of the absolute value over σ, of a uniform error
ROUNDING = 1e-13  # of the largest eigenvalue: below this an eigenvalue is rounding
SHRINK = 0.3  # a noise scale falls at most to this share in a round, so that members follow


@dataclass(frozen=True)
class Placement:
    """A still target: mean T_robot_body (4, 4) and the σ (6,) of the two poses it came from."""

    session: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class Group:
    """Keypoints (columns) of one kind by one sensor in one placement."""

    sensor: str
    placement: int
    kind: str
    keypoints: dict = field(repr=False)


@dataclass(frozen=True)
class Setup:
    """What is being estimated from: sensors and targets by name, placements, groups of keypoints.

    models: name -> Camera or rig.Lidar; prior: name -> (T (4, 4), sigma (6,)), for a sensor
    whose pose is known beforehand.
    """

    models: dict
    targets: dict
    placements: list
    groups: list
    associate: dict
    prior: dict


@dataclass
class State:
    """Current estimate: poses by sensor, MCS errors (2k, 6) in units of σ, noise scales."""

    T_robot_sensor: dict
    y: np.ndarray
    noise: dict
    mocap: float = 1.0


@dataclass(frozen=True)
class Result:
    """The settled estimate, its solution, its last assignments, and one row per round.

    The solution is None when there was nothing to solve.
    """

    state: State
    solution: object
    assigned: list
    rounds: list
    settled: bool


def start(setup, T_robot_sensor, noise):
    """The State from poses by sensor: no MCS error, `noise` times the configured noise."""
    keys = sorted({(g.sensor, g.kind) for g in setup.groups})
    scales = {k: 1.0 if kinds.KINDS[k[1]].ROUNDING is None else noise for k in keys}
    return State(dict(T_robot_sensor), np.zeros((2 * len(setup.placements), 6)), scales)


def T_sensor_target(setup, state, sensor, k):
    """T_sensor_target (4, 4) of placement k with the current MCS errors; equation 1."""
    place = setup.placements[k]
    error = state.mocap * place.sigma * state.y[2 * k : 2 * k + 2]
    robot, body = geometry.se3_exp(error)
    T_robot_target = geometry.inverse(robot) @ place.T_robot_body @ body @ place.T_body_target
    return geometry.inverse(state.T_robot_sensor[sensor]) @ T_robot_target


def assign_all(setup, state):
    """The Assignment of every group at the current estimate."""
    return [_assigned(kinds.KINDS[g.kind].assign, setup, state, g) for g in setup.groups]


def assign_first(setup, state):
    """The Assignment of every group at a pose that nothing was solved for yet."""
    return [_assigned(kinds.first(g.kind), setup, state, g) for g in setup.groups]


def _assigned(assign, setup, state, g):
    target = setup.targets[setup.placements[g.placement].target]
    T = T_sensor_target(setup, state, g.sensor, g.placement)
    scale = state.noise[g.sensor, g.kind]
    return assign(setup.models[g.sensor], target, T, g.keypoints, setup.associate, scale)


def build(setup):
    """The Problem of a setup; sensors in order of name."""
    names = sorted(setup.models)
    blocks = []
    for g in setup.groups:
        place = setup.placements[g.placement]
        poses = place.T_robot_body, place.T_body_target
        at = 2 * g.placement
        blocks.append(Block(names.index(g.sensor), at, at + 1, g.kind, place.target, *poses))
    models = [setup.models[n] for n in names]
    return Problem(
        models, setup.targets, blocks, 2 * len(setup.placements), setup.associate["gate_sigma"]
    )


def priors(setup, state):
    """Means and sigmas (s, 6) of the sensors' twists from where they stand now."""
    mean, sigma = np.zeros((len(setup.models), 6)), np.full((len(setup.models), 6), np.inf)
    for i, name in enumerate(sorted(setup.models)):
        if name in setup.prior:
            T, sigma[i] = setup.prior[name]
            mean[i] = geometry.se3_log(geometry.inverse(T) @ state.T_robot_sensor[name])
    return mean, sigma


def step(setup, problem, state, assigned):
    """Solve with the members fixed; returns the new State and the Solution."""
    names = sorted(setup.models)
    data = [a.data for a in assigned]
    sigmas = state.mocap * np.repeat([p.sigma for p in setup.placements], 2, 0)
    T = np.stack([state.T_robot_sensor[n] for n in names])
    solution = problem.solve(data, T, sigmas, state.y, priors(setup, state))
    poses = dict(zip(names, solution.T_robot_sensor, strict=True))
    return State(poses, solution.y, state.noise, state.mocap), solution


def noise_scales(setup, assigned, before):
    """Noise of each (sensor, kind) over its keypoints' own σ, from the residuals of the members."""
    scales = dict(before)
    for key in before:
        both = [
            (g, a)
            for g, a in zip(setup.groups, assigned, strict=True)
            if (g.sensor, g.kind) == key and (a.feature >= 0).any()
        ]
        if both:
            own = np.median(np.concatenate([g.keypoints["sigma"] for g, _ in both]))
            sizes = [np.abs(a.value / a.sigma[:, None])[a.feature >= 0] for _, a in both]
            scales[key] = _scale(key[1], np.concatenate(sizes), own, before[key])
    return scales


def _scale(kind, sizes, own, before):
    """Noise over the keypoints' own σ from sizes (n, k), residuals in units of `before` times it.

    The median absolute residual, falling by at most SHRINK a round. Where σ is the step of a scan
    pattern: likewise of a uniform error, but at least the step; a wide beam or a wrong outline adds
    to it. To the nearest template point: the rms, for the few far ones are what still moves it.
    """
    rounding = kinds.KINDS[kind].ROUNDING
    if rounding is None:
        return max(1.0, before * float(np.median(sizes)) / UNIFORM_MEDIAN)
    if kinds.by_nearest_point(kind):
        found = before * float(np.sqrt(np.mean(sizes**2)))
    else:
        found = before * MAD_TO_SIGMA * float(np.median(sizes))
    return max(found, SHRINK * before, rounding / own)


def to_unit(information):
    """Factors (n,) of the unknowns that give each unit information, and the matrix (n, n) then."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return scale, scale[:, None] * information * scale


def eigen(information):
    """Eigenvalues (n,), eigenvectors (n, n) in the units of the unknowns, and which are rounding.

    Taken after scaling every unknown to unit information, for measurements of a micrometre beside
    pose priors of a tenth of a millimetre leave no other way through double precision.
    """
    scale, scaled = to_unit(information)
    values, vectors = np.linalg.eigh(scaled)
    return values, scale[:, None] * vectors, values <= ROUNDING * values[-1]


def covariance(information):
    """Covariance (n, n) of all unknowns, positive semidefinite by construction.

    Directions that nothing determines are held; observability.undetermined names them.
    """
    values, vectors, rounding = eigen(information)
    root = vectors[:, ~rounding] / np.sqrt(values[~rounding])
    return root @ root.T


def mocap_scale(setup, state, information):
    """Factor on the priors of the MCS poses, at least 1: the priors are floors.

    Fixed point of the evidence (MacKay 1992): Σy² over the number of well-determined errors.
    Targets compared by points do not count: what a template's spacing does to a whole placement
    would pass for an error of the MCS.
    """
    exact = np.repeat([setup.targets[p.target].points is None for p in setup.placements], 2)
    scale, scaled = to_unit(information)
    scaled += ROUNDING * np.eye(len(scale))
    errors = slice(6 * len(setup.models), None)
    known = 1 - (scale[errors] ** 2 * np.diag(np.linalg.inv(scaled))[errors]).reshape(-1, 6)
    determined = np.sum(known[exact])
    if determined < 1:
        return state.mocap
    return max(1.0, state.mocap * float(np.sqrt(np.sum(state.y[exact] ** 2) / determined)))


def changes(setup, before, after):
    """How many measurements came, went or were numbered anew; of those with a nearest template
    point, which changes as long as anything moves, how many came or went."""
    total = 0
    for g, b, a in zip(setup.groups, before, after, strict=True):
        numbered = (a.feature != b.feature) & (not kinds.by_nearest_point(g.kind))
        total += np.sum(numbered | ((a.feature >= 0) != (b.feature >= 0)))
    return int(total)


def estimate(setup, T_robot_sensor, max_rounds, tolerance_m, tolerance_rad, noise):
    """The Result of rounds of solving and re-association from poses by sensor name.

    noise: how many times the configured noise to begin with, so that no member is lost to a start
    that is off; it falls to what the residuals show.

    Settled when no measurement changes sides, no sensor moves by more than the tolerances and no
    noise scale changes by more than 0.1 %.
    """
    state = start(setup, T_robot_sensor, noise)
    if not setup.groups:
        return Result(state, None, [], [], False)
    problem = build(setup)
    assigned, rounds, settled = assign_first(setup, state), [], False
    for number in range(max_rounds):
        state, solution = step(setup, problem, state, assigned)
        residual = assign_all(setup, state)
        noise = noise_scales(setup, residual, state.noise)
        mocap = mocap_scale(setup, state, solution.information)
        ratios = [noise[k] / state.noise[k] for k in noise] + [mocap / state.mocap]
        state = State(state.T_robot_sensor, state.y * state.mocap / mocap, noise, mocap)
        after = assign_all(setup, state)
        moved = np.abs(solution.step).reshape(-1, 2, 3).max((0, 2))
        rounds.append(
            {
                "round": number,
                "cost": solution.cost,
                "ipopt_iterations": solution.iterations,
                "members": int(sum((a.feature >= 0).sum() for a in after)),
                "step_m": moved[0],
                "step_rad": moved[1],
                "changed": changes(setup, assigned, after),
            }
        )
        settled = (
            solution.success
            and rounds[-1]["changed"] == 0
            and moved[0] < tolerance_m
            and moved[1] < tolerance_rad
            and np.all(np.abs(np.log(ratios)) < 1e-3)
        )
        assigned = after
        if settled:
            break
    return Result(state, solution, assigned, rounds, bool(settled))
