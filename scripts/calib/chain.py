"""What is estimated from and what is estimated, and the chain of poses between them; equation 1."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calib import geometry, noise
from calib.problem import Poses


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
    targets whose place in their body is estimated too; alignment: name -> σ (6,) of where it is
    said to be, for those that have a say; corrections: Hypothesis objects whose numbers θ are
    estimated.

    The unknowns are twists of the sensors and of those mounts, by name, then the errors of the MCS
    poses of the robot at its rests and of the body in every placement, then θ, both in units of
    their σ.
    """

    models: dict
    targets: dict
    placements: list
    groups: list
    associate: dict
    prior: dict
    mounts: dict = field(default_factory=dict)
    alignment: dict = field(default_factory=dict)
    corrections: tuple = ()

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
    def chained(self):
        """How many unknowns the chains of poses have: all but θ."""
        return self.poses + self.sigma.size

    @property
    def n(self):
        """How many unknowns there are."""
        return self.chained + sum(h.size for h in self.corrections)

    @cached_property
    def theta_sigma(self):
        """(p,) σ of the priors of θ."""
        return np.concatenate([np.zeros(0), *(h.sigma for h in self.corrections)])

    def numbers(self, group):
        """Which of θ (q,) the residuals of a group may depend on."""
        ends = np.cumsum([0] + [h.size for h in self.corrections])
        spans = zip(self.corrections, ends[:-1], ends[1:], strict=True)
        own = [np.arange(a, b) for h, a, b in spans if h.touches(self, group)]
        return np.concatenate([np.zeros(0, int), *own])


@dataclass
class State:
    """Current estimate: poses by sensor, mounts by target, MCS errors (r + k, 6) in units of σ,
    Noise by (sensor, kind), factor on the σ of the MCS, numbers θ (p,) of the corrections, SI."""

    T_robot_sensor: dict
    mounts: dict
    y: np.ndarray
    noise: dict
    mocap: float = 1.0
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))


def start(setup, T_robot_sensor, factor):
    """The State from poses by sensor: no MCS error, `factor` times the configured noise."""
    keys = sorted({noise.of(g) for g in setup.groups})
    scales = {key: noise.initial(key[1], factor) for key in keys}
    y, theta = np.zeros_like(setup.sigma), np.zeros_like(setup.theta_sigma)
    return State(dict(T_robot_sensor), dict(setup.mounts), y, scales, theta=theta)


def model(setup, state, group):
    """The model of a group's sensor with the corrections that touch the group."""
    out, first = setup.models[group.sensor], 0
    for h in setup.corrections:
        if h.touches(setup, group):
            out = h.mended(out, state.theta[first : first + h.size], group.placement)
        first += h.size
    return out


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


def columns(setup, group):
    """Unknowns (24,) of a group's chain: its sensor, the mount, the robot's and the body's MCS
    pose; the number of all of these stands for a mount that is not estimated."""
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    target = setup.placements[group.placement].target
    starts = [6 * sensors.index(group.sensor)]
    starts += [6 * (len(sensors) + mounts.index(target))] if target in mounts else [None]
    poses = setup.robots[group.placement], setup.n_robots + group.placement
    starts += [setup.poses + 6 * i for i in poses]
    six = np.arange(6)
    return np.concatenate([np.full(6, setup.chained) if s is None else s + six for s in starts])


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
    known = [
        (*setup.prior.get(n, (None, 0)), state.T_robot_sensor[n]) for n in sorted(setup.models)
    ]
    known += [
        (setup.mounts[n] if n in setup.alignment else None, setup.alignment.get(n), state.mounts[n])
        for n in sorted(setup.mounts)
    ]
    for i, (T, sigma, now) in enumerate(known):
        if T is not None:
            at = slice(6 * i, 6 * i + 6)
            mean[at] = geometry.se3_log(geometry.inverse(T) @ now)
            weight[at] = 1 / sigma
    return mean, weight


def unknowns(setup, state):
    """x (n,) where the State stands, twists from there, and the scale (n,) of each in SI."""
    x = np.zeros(setup.poses), state.y.reshape(-1), state.theta / setup.theta_sigma
    scale = np.ones(setup.poses), state.mocap * setup.sigma.reshape(-1), setup.theta_sigma
    return np.concatenate(x), np.concatenate(scale)


def moved(setup, state, x):
    """The State at unknowns x (n,)."""
    twists = geometry.se3_exp(x[: setup.poses].reshape(-1, 6))
    sensors, mounts = sorted(setup.models), sorted(setup.mounts)
    return State(
        {n: state.T_robot_sensor[n] @ T for n, T in zip(sensors, twists, strict=False)},
        {n: state.mounts[n] @ T for n, T in zip(mounts, twists[len(sensors) :], strict=True)},
        x[setup.poses : setup.chained].reshape(-1, 6),
        state.noise,
        state.mocap,
        x[setup.chained :] * setup.theta_sigma,
    )
