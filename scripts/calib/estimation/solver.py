"""Solve, re-estimate the noise, re-associate, and again until nothing moves."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.estimation import estimate_state, noise_model, pose_chain
from calib.estimation.corrections import camera_intrinsics
from calib.estimation.corrections.correction import View
from calib.estimation.nlp.information_matrix import covariance, inverse
from calib.estimation.nlp.joint_nlp import Block, Problem
from calib.estimation.nlp.measurement_factor import information
from calib.estimation.noise_model import wide
from calib.estimation.residuals import residual_registry

STRIDE = 0.1  # m, rad


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

    @cached_property
    def covariance(self):
        """(n, n) of all unknowns (information.covariance)."""
        return covariance(self.information)


@dataclass(frozen=True)
class Result:
    """The settled estimate, its Fit, its last assignments, and one row per round.

    The solution is None when there was nothing to solve.
    """

    state: estimate_state.State
    solution: Fit | None
    assigned: list
    rounds: list
    settled: bool


def assign_all(setup, state):
    """The Assignment of every group at the current estimate."""
    return _assigned(lambda kind: residual_registry.KINDS[kind].assign, setup, state)


def assign_first(setup, state):
    """The Assignment of every group at a pose that nothing was solved for yet."""
    return _assigned(residual_registry.first, setup, state)


def _assigned(function_of, setup, state):
    out = []
    for g in (pose_chain.frozen(setup, state, g) for g in setup.groups):
        target = setup.targets[setup.placements[g.placement].target]
        where = pose_chain.T_sensor_target(setup, state, g.sensor, g.placement)
        model = pose_chain.model(setup, state, g)
        given = model, target, where, g.keypoints, setup.associate
        out.append(function_of(g.kind)(*given, state.noise[noise_model.of(g)]))
    return out


def build(setup):
    """The Problem of a setup."""
    blocks = [
        Block(
            g.sensor,
            g.kind,
            setup.placements[g.placement].target,
            pose_chain.columns(setup, g),
            setup.numbers(g),
        )
        for g in setup.groups
    ]
    return Problem(setup.models, setup.targets, blocks, setup.chained, setup.n - setup.chained)


def slopes(setup, state, assigned):
    """Of every group, derivatives (q, k, n) of its residuals by those of θ that they depend on, in
    units of their σ."""
    out = []
    for g, a in zip(setup.groups, assigned, strict=True):
        seen = pose_chain.frozen(setup, state, g)
        view = View(setup, state, pose_chain.model(setup, state, g), seen, a, None)
        own = [h.derivative(view) for h in setup.corrections if h.touches(setup, g)]
        none = np.zeros((0, *a.value.T.shape))
        scale = setup.theta_sigma[setup.numbers(g)][:, None, None]
        out.append(scale * np.concatenate([none, *own]))
    return out


def step(setup, problem, state, assigned):
    """Solve with the members fixed; returns the new State, the Fit and the twists (s, 6)."""
    x, scale = pose_chain.unknowns(setup, state)
    poses, (mean, weight) = pose_chain.chains(setup, state), pose_chain.priors(setup, state)
    problem.with_models(lenses(setup, state))
    given = assigned, slopes(setup, state, assigned), errors(setup, state)
    parts = problem.parts(x, scale, poses, *given)
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
    wander = wandered(setup, state, parts, found.x - x)
    twists = found.x[: 6 * len(setup.models)].reshape(-1, 6)
    return estimate_state.moved(setup, state, found.x, wander), fit, twists


def lenses(setup, state):
    """{sensor: Camera} of those whose parameters are estimated, as they stand."""
    free = {h.of for h in setup.corrections if h.name == camera_intrinsics.NAME}
    first = {g.sensor: g for g in reversed(setup.groups) if g.sensor in free}
    return {name: pose_chain.model(setup, state, g) for name, g in first.items()}


def errors(setup, state):
    """(spread, error) of every group's parts.Part: of views in motion, else None."""
    spreads = [pose_chain.spread(setup, state, g) for g in setup.groups]
    return [
        (None, None) if s is None else (s, state.wander[g.placement - setup.still])
        for g, s in zip(setup.groups, spreads, strict=True)
    ]


def wandered(setup, state, parts, step):
    """(m, 6) errors of the views in motion, the unknowns having moved by step (n,)."""
    wander = state.wander.copy()
    for g, part in zip(setup.groups, parts, strict=True):
        if part.spread is not None:
            wander[g.placement - setup.still] = part.wander(step[part.columns])
    return wander


def _held(setup, mean, weight):
    """The priors, and that no pose leaves its place by more than STRIDE for nothing: directions
    that the data do not tell would drift. Where they tell something, steps are a little shorter."""
    both = weight.copy()
    both[: setup.poses] = np.hypot(weight[: setup.poses], 1 / STRIDE)
    return mean * (weight / both) ** 2, both


def renoised(setup, state, fit, twists, assigned):
    """The State with the noise that the residuals show, the sensors having moved by twists."""
    posterior = inverse(fit.information)
    scales = noise_model.of_measurements(setup, assigned, state.noise)
    if np.all(twists.reshape(-1) ** 2 < np.diag(posterior)[: twists.size]):
        scales = noise_model.shared(setup, assigned, scales, absorbed(setup, fit, posterior))
    mocap = mocap_factor(setup, state, posterior)
    return replace(state, y=state.y * state.mocap / mocap, noise=scales, mocap=mocap)


def absorbed(setup, fit, posterior):
    """How many residuals of every (sensor, kind) the estimate has used up: their leverage."""
    used = {}
    for g, p in zip(setup.groups, fit.parts, strict=True):
        predicted = posterior[np.ix_(p.columns, p.columns)]
        used[noise_model.of(g)] = used.get(noise_model.of(g), 0.0) + float(
            np.sum(p.hessian * predicted)
        )
    return used


def mocap_factor(setup, state, posterior):
    """Factor on the σ of the MCS poses (noise.of_mocap).

    Targets compared by points do not count: what a template's spacing does to a whole placement
    would pass for an error of the MCS.
    """
    still = setup.placements[: setup.still]
    exact = np.array([setup.targets[p.target].points is None for p in still], bool)
    counts = np.zeros(len(setup.sigma), bool)
    counts[setup.robots[: setup.still]] = counts[setup.bodies[: setup.still]] = True
    counts[setup.robots[: setup.still][~exact]] = False
    counts[setup.bodies[: setup.still][~exact]] = False
    known = 1 - np.diag(posterior)[setup.poses : setup.chained].reshape(-1, 6)
    return noise_model.of_mocap(state.y[counts], known[counts], state.mocap)


def changes(setup, before, after):
    """How many measurements came, went or were numbered anew; of those with a nearest template
    point, which changes as long as anything moves, how many came or went."""
    total = 0
    for g, b, a in zip(setup.groups, before, after, strict=True):
        if g.moving:  # they weigh little, and points at a gate's rim come and go for long
            continue
        numbered = (a.feature != b.feature) & (not residual_registry.by_nearest_point(g.kind))
        total += np.sum(numbered | ((a.feature >= 0) != (b.feature >= 0)))
    return int(total)


def estimate(setup, T_robot_sensor, max_rounds, tolerance_m, tolerance_rad, noise):
    """The Result of rounds of solving and re-association from poses by sensor name.

    noise: at least how many times the configured noise to begin with, so that no member is lost to
    a start that is off; it falls to what the residuals show.

    Settled when no measurement changes sides, no sensor moves by more than the tolerances and no
    noise changes by more than 0.1 %.
    """
    state = estimate_state.start(setup, T_robot_sensor, noise)
    if not setup.groups:
        return Result(state, None, [], [], False)
    assigned = assign_first(setup, state)
    state.noise = wide(setup, assigned, state.noise)
    return _settled(setup, state, assigned, max_rounds, (tolerance_m, tolerance_rad))


def resume(setup, before, max_rounds, tolerance_m, tolerance_rad, noise):
    """As estimate, from where another Setup of the same still placements has settled: before, its
    (Setup, Result); noise: as there, of the groups that are new."""
    known, result = before
    if result.solution is None:
        return estimate(
            setup, result.state.T_robot_sensor, max_rounds, tolerance_m, tolerance_rad, noise
        )
    state = estimate_state.carried(setup, (known, result.state), noise)
    assigned = assign_all(setup, state)
    new = {k: v for k, v in state.noise.items() if k not in result.state.noise}
    state.noise |= wide(setup, assigned, new)
    return _settled(setup, state, assigned, max_rounds, (tolerance_m, tolerance_rad))


def _settled(setup, state, assigned, max_rounds, tolerances):
    """The Result of rounds from a State and the Assignments there."""
    problem, rounds, settled = build(setup), [], False
    assigned = _under(setup, assigned, state)
    while len(rounds) < max_rounds and not settled:
        last = state.theta
        state, fit, twists = step(setup, problem, state, assigned)
        before, after = replace(state, theta=last), assign_all(setup, state)
        state = renoised(setup, state, fit, twists, after)
        after = _under(setup, after, state)
        rounds.append(_round(len(rounds), fit, twists, after, changes(setup, assigned, after)))
        settled = (
            fit.success
            and rounds[-1]["changed"] == 0
            and rounds[-1]["step_m"] < tolerances[0]
            and rounds[-1]["step_rad"] < tolerances[1]
            and _alike(before, state, setup.theta_sigma)
        )
        assigned = after
    return Result(state, fit, assigned, rounds, bool(settled))


def _round(number, fit, twists, assigned, changed):
    """The row of one round."""
    moves = np.abs(twists).reshape(-1, 2, 3).max((0, 2))
    return {
        "round": number,
        "cost": fit.cost,
        "ipopt_iterations": fit.iterations,
        "members": int(sum((a.feature >= 0).sum() for a in assigned)),
        "step_m": moves[0],
        "step_rad": moves[1],
        "changed": changed,
    }


def _under(setup, assigned, state):
    """The Assignments at the noise of the State."""
    return [
        a.under(state.noise[noise_model.of(g)]) for g, a in zip(setup.groups, assigned, strict=True)
    ]


def _alike(before, after, sigma):
    """Whether the noise of two states is the same to 0.1 %, and θ to 1e-5 of its prior's sigma."""
    ratios = [after.mocap / before.mocap]
    ratios += [after.noise[key].total / before.noise[key].total for key in before.noise]
    shifts = [
        np.subtract(after.noise[k], before.noise[k]) / before.noise[k].total for k in before.noise
    ]
    same = np.all(np.abs(np.log(ratios)) < 1e-3) and np.all(np.abs(shifts) < 1e-3)
    return same and np.all(np.abs(after.theta - before.theta) <= 1e-5 * sigma)
