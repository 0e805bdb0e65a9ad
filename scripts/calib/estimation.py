"""Solve, re-estimate the noise, re-associate, and again until nothing moves."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calib import geometry, kinds, noise
from calib.information import inverse
from calib.noise import wide
from calib.problem import Block, Poses, Problem, information

STRIDE = 0.1  # m, rad


@dataclass(frozen=True)
class Placement:
    """A still target: mean T_robot_body (4, 4) and the σ (6,) of the two poses it came from.

    rest: number of the robot's rest in the session; targets that are still at the same time share
    it, and with it the error of the robot's pose. None: nobody shares it.
    """

    session: str
    target: str
    T_robot_body: np.ndarray
    T_body_target: np.ndarray
    sigma: np.ndarray
    rest: int | None = None


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
    whose pose is known beforehand; mounts: name -> T_body_target (4, 4) to start from, of the
    targets whose place in their body is estimated too.

    The unknowns are twists of the sensors and of those mounts, by name, then the errors of the MCS
    poses of the robot at its rests and of the body in every placement, in units of their σ.
    """

    models: dict
    targets: dict
    placements: list
    groups: list
    associate: dict
    prior: dict
    mounts: dict = field(default_factory=dict)

    @cached_property
    def robots(self):
        """(k,) index of the robot's rest of every placement."""
        own = [
            (p.session, -1 - i if p.rest is None else p.rest) for i, p in enumerate(self.placements)
        ]
        numbers = {rest: i for i, rest in enumerate(sorted(set(own)))}
        return np.array([numbers[rest] for rest in own], int)

    @cached_property
    def sigma(self):
        """(r + k, 6) σ of the MCS poses: of the robot's rests, then of the bodies."""
        body = np.reshape([p.sigma for p in self.placements], (-1, 6))
        robot = np.zeros((self.n_robots, 6))
        np.maximum.at(robot, self.robots, body)
        return np.concatenate([robot, body])

    @property
    def n_robots(self):
        return int(self.robots.max(initial=-1)) + 1

    @property
    def poses(self):
        """Index of the first unknown of the MCS poses."""
        return 6 * (len(self.models) + len(self.mounts))

    @property
    def n(self):
        """How many unknowns there are."""
        return self.poses + self.sigma.size


@dataclass
class State:
    """Current estimate: poses by sensor, mounts by target, MCS errors (r + k, 6) in units of σ,
    Noise by (sensor, kind), factor on the σ of the MCS."""

    T_robot_sensor: dict
    mounts: dict
    y: np.ndarray
    noise: dict
    mocap: float = 1.0


@dataclass(frozen=True)
class Fit:
    """One solution: the Parts that it was found from, one per group, the information matrix (n, n)
    of all unknowns, right perturbations, and what IPOPT said."""

    parts: list
    information: np.ndarray
    cost: float
    iterations: int
    status: str
    success: bool


@dataclass(frozen=True)
class Result:
    """The settled estimate, its Fit, its last assignments, and one row per round.

    The solution is None when there was nothing to solve.
    """

    state: State
    solution: Fit | None
    assigned: list
    rounds: list
    settled: bool


def start(setup, T_robot_sensor, factor):
    """The State from poses by sensor: no MCS error, `factor` times the configured noise."""
    keys = sorted({noise.of(g) for g in setup.groups})
    scales = {key: noise.initial(key[1], factor) for key in keys}
    return State(dict(T_robot_sensor), dict(setup.mounts), np.zeros_like(setup.sigma), scales)


def T_body_target(setup, state):
    """(k, 4, 4) of every placement, estimated or as configured."""
    return np.stack([state.mounts.get(p.target, p.T_body_target) for p in setup.placements])


def T_robot_target(setup, state):
    """(k, 4, 4) of every placement with the current MCS errors; equation 1."""
    errors = geometry.se3_exp(state.mocap * setup.sigma * state.y)
    robot, body = errors[setup.robots], errors[setup.n_robots :]
    measured = np.stack([p.T_robot_body for p in setup.placements])
    return geometry.inverse(robot) @ measured @ body @ T_body_target(setup, state)


def T_sensor_target(setup, state, sensor, k):
    """T_sensor_target (4, 4) of placement k with the current MCS errors; equation 1."""
    return geometry.inverse(state.T_robot_sensor[sensor]) @ T_robot_target(setup, state)[k]


def assign_all(setup, state):
    """The Assignment of every group at the current estimate."""
    return _assigned(lambda kind: kinds.KINDS[kind].assign, setup, state)


def assign_first(setup, state):
    """The Assignment of every group at a pose that nothing was solved for yet."""
    return _assigned(kinds.first, setup, state)


def _assigned(function_of, setup, state):
    T, out = T_robot_target(setup, state), []
    T_sensor_robot = {name: geometry.inverse(T) for name, T in state.T_robot_sensor.items()}
    for g in setup.groups:
        target = setup.targets[setup.placements[g.placement].target]
        where = T_sensor_robot[g.sensor] @ T[g.placement]
        given = setup.models[g.sensor], target, where, g.keypoints, setup.associate
        out.append(function_of(g.kind)(*given, state.noise[noise.of(g)]))
    return out


def build(setup):
    """The Problem of a setup."""
    blocks = [
        Block(g.sensor, g.kind, setup.placements[g.placement].target, columns(setup, g))
        for g in setup.groups
    ]
    return Problem(setup.models, setup.targets, blocks, setup.n)


def columns(setup, group):
    """Unknowns (24,) of a group: its sensor, the mount, the robot's and the body's MCS pose; the
    number of all unknowns stands for a mount that is not estimated."""
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    target = setup.placements[group.placement].target
    starts = [6 * sensors.index(group.sensor)]
    starts += [6 * (len(sensors) + mounts.index(target))] if target in mounts else [None]
    poses = setup.robots[group.placement], setup.n_robots + group.placement
    starts += [setup.poses + 6 * i for i in poses]
    six = np.arange(6)
    return np.concatenate([np.full(6, setup.n) if s is None else s + six for s in starts])


def chains(setup, state):
    """Poses of every group's chain; MCS errors apart."""
    at = [g.placement for g in setup.groups]
    return Poses(
        np.stack([state.T_robot_sensor[g.sensor] for g in setup.groups]),
        np.stack([setup.placements[k].T_robot_body for k in at]),
        T_body_target(setup, state)[at],
    )


def priors(setup, state):
    """Means and weights (n,) of the unknowns, from where they stand now."""
    mean, weight = np.zeros(setup.n), np.ones(setup.n)
    weight[: setup.poses] = 0
    for i, name in enumerate(sorted(setup.models)):
        if name in setup.prior:
            T, sigma = setup.prior[name]
            at = slice(6 * i, 6 * i + 6)
            mean[at] = geometry.se3_log(geometry.inverse(T) @ state.T_robot_sensor[name])
            weight[at] = 1 / sigma
    return mean, weight


def step(setup, problem, state, assigned):
    """Solve with the members fixed; returns the new State, the Fit and the twists (s, 6)."""
    x = np.concatenate([np.zeros(setup.poses), state.y.reshape(-1)])
    scale = np.concatenate([np.ones(setup.poses), state.mocap * setup.sigma.reshape(-1)])
    poses, (mean, weight) = chains(setup, state), priors(setup, state)
    parts = problem.parts(x, scale, poses, assigned)
    found = problem.solve(parts, x, scale, poses, _held(setup, mean, weight))
    offset = weight * (x + mean)
    fit = Fit(
        parts=parts,
        information=information(parts, weight),
        cost=sum(p.cost for p in parts) + float(offset @ offset) / 2,
        iterations=found.iterations,
        status=found.status,
        success=found.success,
    )
    return moved(setup, state, found.x), fit, found.x[: 6 * len(setup.models)].reshape(-1, 6)


def _held(setup, mean, weight):
    """The priors, and that no pose leaves its place by more than STRIDE for nothing: directions
    that the data do not tell would drift. Where they tell something, steps are a little shorter."""
    both = weight.copy()
    both[: setup.poses] = np.hypot(weight[: setup.poses], 1 / STRIDE)
    return mean * (weight / both) ** 2, both


def moved(setup, state, x):
    """The State at unknowns x (n,)."""
    twists = geometry.se3_exp(x[: setup.poses].reshape(-1, 6))
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    return State(
        {n: state.T_robot_sensor[n] @ T for n, T in zip(sensors, twists, strict=False)},
        {n: state.mounts[n] @ T for n, T in zip(mounts, twists[len(sensors) :], strict=True)},
        x[setup.poses :].reshape(-1, 6),
        state.noise,
        state.mocap,
    )


def renoised(setup, state, fit, twists, assigned):
    """The State with the noise that the residuals show, the sensors having moved by twists."""
    posterior = inverse(fit.information)
    scales = noise.of_measurements(setup, assigned, state.noise)
    if np.all(twists.reshape(-1) ** 2 < np.diag(posterior)[: twists.size]):
        scales = noise.shared(setup, assigned, scales, absorbed(setup, fit, posterior))
    mocap = mocap_factor(setup, state, posterior)
    return State(state.T_robot_sensor, state.mounts, state.y * state.mocap / mocap, scales, mocap)


def absorbed(setup, fit, posterior):
    """How many residuals of every (sensor, kind) the estimate has used up: their leverage."""
    used = {}
    for g, p in zip(setup.groups, fit.parts, strict=True):
        predicted = p.A @ posterior[np.ix_(p.columns, p.columns)] @ p.A.T
        used[noise.of(g)] = used.get(noise.of(g), 0.0) + float(np.sum(p.information * predicted))
    return used


def mocap_factor(setup, state, posterior):
    """Factor on the σ of the MCS poses (noise.of_mocap).

    Targets compared by points do not count: what a template's spacing does to a whole placement
    would pass for an error of the MCS.
    """
    exact = np.array([setup.targets[p.target].points is None for p in setup.placements], bool)
    counts = np.ones(len(setup.sigma), bool)
    counts[setup.robots[~exact]] = False
    counts[setup.n_robots :] = exact
    known = 1 - np.diag(posterior)[setup.poses :].reshape(-1, 6)
    return noise.of_mocap(state.y[counts], known[counts], state.mocap)


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

    noise: at least how many times the configured noise to begin with, so that no member is lost to
    a start that is off; it falls to what the residuals show.

    Settled when no measurement changes sides, no sensor moves by more than the tolerances and no
    noise changes by more than 0.1 %.
    """
    state = start(setup, T_robot_sensor, noise)
    if not setup.groups:
        return Result(state, None, [], [], False)
    problem, assigned = build(setup), assign_first(setup, state)
    state.noise = wide(setup, assigned, state.noise)
    assigned = _under(setup, assigned, state)
    rounds, settled = [], False
    for number in range(max_rounds):
        state, fit, twists = step(setup, problem, state, assigned)
        before, after = state, assign_all(setup, state)
        state = renoised(setup, state, fit, twists, after)
        after = _under(setup, after, state)
        moves = np.abs(twists).reshape(-1, 2, 3).max((0, 2))
        rounds.append(
            {
                "round": number,
                "cost": fit.cost,
                "ipopt_iterations": fit.iterations,
                "members": int(sum((a.feature >= 0).sum() for a in after)),
                "step_m": moves[0],
                "step_rad": moves[1],
                "changed": changes(setup, assigned, after),
            }
        )
        settled = (
            fit.success
            and rounds[-1]["changed"] == 0
            and moves[0] < tolerance_m
            and moves[1] < tolerance_rad
            and _alike(before, state)
        )
        assigned = after
        if settled:
            break
    return Result(state, fit, assigned, rounds, bool(settled))


def _under(setup, assigned, state):
    """The Assignments at the noise of the State."""
    return [a.under(state.noise[noise.of(g)]) for g, a in zip(setup.groups, assigned, strict=True)]


def _alike(before, after):
    """Whether the noise of two states is the same to 0.1 %."""
    ratios = [after.mocap / before.mocap]
    ratios += [after.noise[key].total / before.noise[key].total for key in before.noise]
    shifts = [
        np.subtract(after.noise[k], before.noise[k]) / before.noise[k].total for k in before.noise
    ]
    return np.all(np.abs(np.log(ratios)) < 1e-3) and np.all(np.abs(shifts) < 1e-3)
