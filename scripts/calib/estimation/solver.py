"""Solve, re-estimate the noise, re-associate, and again until nothing moves."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.estimation.corrections.camera_intrinsics import INTRINSICS
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.estimate_state import State, apply_step, initial_state, warm_start
from calib.estimation.nlp.information_matrix import covariance_from_information, invert_information
from calib.estimation.nlp.joint_nlp import FactorLayout, JointNlp
from calib.estimation.nlp.measurement_factor import joint_information
from calib.estimation.noise_model import (
    estimate_measurement_noise,
    noise_key,
    split_common_noise,
    update_mocap_factor,
    widen_initial_noise,
)
from calib.estimation.pose_chain import (
    T_sensor_target,
    chain_unknown_columns,
    deskew_group,
    linearization_poses,
    model_with_corrections,
    moving_view_covariance,
    pack_unknowns,
    prior_means_and_weights,
)
from calib.estimation.residuals.residual_registry import (
    RESIDUAL_KINDS,
    first_assignment,
    uses_template_points,
)

DAMPING_SIGMA = 0.1  # m, rad


@dataclass(frozen=True)
class SolveResult:
    """One solution: the Parts that it was found from, one per group, the information matrix (n, n)
    of all unknowns, right perturbations, and what IPOPT said."""

    factors: list
    information: np.ndarray
    cost: float
    n_iterations: int
    status: str
    has_converged: bool

    @cached_property
    def covariance(self):
        """(n, n) of all unknowns (information.covariance)."""
        return covariance_from_information(self.information)


@dataclass(frozen=True)
class EstimationResult:
    """The settled estimate, its Fit, its last assignments, and one row per round.

    The solution is None when there was nothing to solve.
    """

    state: State
    solve_result: SolveResult | None
    assignments: list
    rounds: list
    has_converged: bool


def assign_measurements(setup, state):
    """The Assignment of every group at the current estimate."""
    return _assign_groups(lambda kind: RESIDUAL_KINDS[kind].assign, setup, state)


def assign_at_initial_guess(setup, state):
    """The Assignment of every group at a pose that nothing was solved for yet."""
    return _assign_groups(first_assignment, setup, state)


def _assign_groups(select_assign, setup, state):
    out = []
    for g in (deskew_group(setup, state, g) for g in setup.groups):
        target = setup.targets[setup.placements[g.placement].target]
        where = T_sensor_target(setup, state, g.sensor, g.placement)
        model = model_with_corrections(setup, state, g)
        given = model, target, where, g.keypoints, setup.associate_options
        out.append(select_assign(g.kind)(*given, state.noise[noise_key(g)]))
    return out


def build_nlp(setup):
    """The Problem of a setup."""
    blocks = [
        FactorLayout(
            g.sensor,
            g.kind,
            setup.placements[g.placement].target,
            chain_unknown_columns(setup, g),
            setup.correction_index(g),
        )
        for g in setup.groups
    ]
    return JointNlp(
        setup.models,
        setup.targets,
        blocks,
        setup.n_chain_unknowns,
        setup.n_unknowns - setup.n_chain_unknowns,
    )


def correction_derivatives(setup, state, assigned):
    """Of every group, derivatives (q, k, n) of its residuals by those of θ that they depend on, in
    units of their σ."""
    out = []
    for g, a in zip(setup.groups, assigned, strict=True):
        seen = deskew_group(setup, state, g)
        view = GroupLinearization(
            setup, state, model_with_corrections(setup, state, g), seen, a, None
        )
        own = [h.derivative(view) for h in setup.corrections if h.affects(setup, g)]
        none = np.zeros((0, *a.residual.T.shape))
        scale = setup.correction_sigma[setup.correction_index(g)][:, None, None]
        out.append(scale * np.concatenate([none, *own]))
    return out


def solve_round(setup, problem, state, assigned):
    """Solve with the members fixed; returns the new State, the Fit and the twists (s, 6)."""
    x, scale = pack_unknowns(setup, state)
    poses, (mean, weight) = linearization_poses(setup, state), prior_means_and_weights(setup, state)
    problem.set_models(cameras_at_estimate(setup, state))
    given = (
        assigned,
        correction_derivatives(setup, state, assigned),
        moving_view_error_priors(setup, state),
    )
    parts = problem.linearize(x, scale, poses, *given)
    found = problem.solve(parts, x, scale, poses, _damped_prior(setup, mean, weight))
    offset = weight * (x + mean)
    fit = SolveResult(
        factors=parts,
        information=joint_information(parts, weight),
        cost=sum(p.cost for p in parts) + float(offset @ offset) / 2,
        n_iterations=found.n_iterations,
        status=found.status,
        has_converged=found.has_converged,
    )
    wander = update_moving_view_errors(setup, state, parts, found.x - x)
    twists = found.x[: 6 * len(setup.models)].reshape(-1, 6)
    return apply_step(setup, state, found.x, wander), fit, twists


def cameras_at_estimate(setup, state):
    """{sensor: Camera} of those whose parameters are estimated, as they stand."""
    free = {h.subject for h in setup.corrections if h.name == INTRINSICS}
    first = {g.sensor: g for g in reversed(setup.groups) if g.sensor in free}
    return {name: model_with_corrections(setup, state, g) for name, g in first.items()}


def moving_view_error_priors(setup, state):
    """(spread, error) of every group's parts.Part: of views in motion, else None."""
    spreads = [moving_view_covariance(setup, state, g) for g in setup.groups]
    return [
        (None, None) if s is None else (s, state.moving_view_errors[g.placement - setup.n_still])
        for g, s in zip(setup.groups, spreads, strict=True)
    ]


def update_moving_view_errors(setup, state, factors, step):
    """(m, 6) errors of the views in motion, the unknowns having moved by step (n,)."""
    wander = state.moving_view_errors.copy()
    for g, part in zip(setup.groups, factors, strict=True):
        if part.view_covariance is not None:
            wander[g.placement - setup.n_still] = part.update_view_error(step[part.columns])
    return wander


def _damped_prior(setup, mean, weight):
    """The priors, and that no pose leaves its place by more than STRIDE for nothing: directions
    that the data do not tell would drift. Where they tell something, steps are a little shorter."""
    both = weight.copy()
    both[: setup.n_pose_unknowns] = np.hypot(weight[: setup.n_pose_unknowns], 1 / DAMPING_SIGMA)
    return mean * (weight / both) ** 2, both


def update_noise(setup, state, solve_result, twists, assigned):
    """The State with the noise that the residuals show, the sensors having moved by twists."""
    posterior = invert_information(solve_result.information)
    scales = estimate_measurement_noise(setup, assigned, state.noise)
    if np.all(twists.reshape(-1) ** 2 < np.diag(posterior)[: twists.size]):
        scales = split_common_noise(
            setup, assigned, scales, residual_leverage(setup, solve_result, posterior)
        )
    mocap = estimate_mocap_factor(setup, state, posterior)
    return replace(
        state,
        mocap_errors=state.mocap_errors * state.mocap_noise_factor / mocap,
        noise=scales,
        mocap_noise_factor=mocap,
    )


def residual_leverage(setup, solve_result, posterior_covariance):
    """How many residuals of every (sensor, kind) the estimate has used up: their leverage."""
    used = {}
    for g, p in zip(setup.groups, solve_result.factors, strict=True):
        predicted = posterior_covariance[np.ix_(p.columns, p.columns)]
        used[noise_key(g)] = used.get(noise_key(g), 0.0) + float(np.sum(p.hessian_x * predicted))
    return used


def estimate_mocap_factor(setup, state, posterior):
    """Factor on the σ of the MCS poses (noise.of_mocap).

    Targets compared by points do not count: what a template's spacing does to a whole placement
    would pass for an error of the MCS.
    """
    still = setup.placements[: setup.n_still]
    exact = np.array([setup.targets[p.target].uses_exact_surface for p in still], bool)
    counts = np.zeros(len(setup.mocap_sigma), bool)
    counts[setup.robot_error_index[: setup.n_still]] = counts[
        setup.body_error_index[: setup.n_still]
    ] = True
    counts[setup.robot_error_index[: setup.n_still][~exact]] = False
    counts[setup.body_error_index[: setup.n_still][~exact]] = False
    known = 1 - np.diag(posterior)[setup.n_pose_unknowns : setup.n_chain_unknowns].reshape(-1, 6)
    return update_mocap_factor(state.mocap_errors[counts], known[counts], state.mocap_noise_factor)


def count_reassignments(setup, before, after):
    """How many measurements came, went or were numbered anew; of those with a nearest template
    point, which changes as long as anything moves, how many came or went."""
    total = 0
    for g, b, a in zip(setup.groups, before, after, strict=True):
        if g.is_moving:  # they weigh little, and points at a gate's rim come and go for long
            continue
        numbered = (a.feature != b.feature) & (not uses_template_points(g.kind))
        total += np.sum(numbered | ((a.feature >= 0) != (b.feature >= 0)))
    return int(total)


def estimate_poses(
    setup, T_robot_sensor, max_rounds, tolerance_m, tolerance_rad, initial_noise_factor
):
    """The Result of rounds of solving and re-association from poses by sensor name.

    initial_noise_factor: at least how many times the configured noise to begin with, so that no member is lost to
    a start that is off; it falls to what the residuals show.

    Settled when no measurement changes sides, no sensor moves by more than the tolerances and no
    noise changes by more than 0.1 %.
    """
    state = initial_state(setup, T_robot_sensor, initial_noise_factor)
    if not setup.groups:
        return EstimationResult(state, None, [], [], False)
    assigned = assign_at_initial_guess(setup, state)
    state.noise = widen_initial_noise(setup, assigned, state.noise)
    return _iterate(setup, state, assigned, max_rounds, (tolerance_m, tolerance_rad))


def continue_estimate(
    setup, previous, max_rounds, tolerance_m, tolerance_rad, initial_noise_factor
):
    """As estimate, from where another Setup of the same still placements has settled: before, its
    (Setup, Result); initial_noise_factor: as there, of the groups that are new."""
    known, result = previous
    if result.solve_result is None:
        return estimate_poses(
            setup,
            result.state.T_robot_sensor,
            max_rounds,
            tolerance_m,
            tolerance_rad,
            initial_noise_factor,
        )
    state = warm_start(setup, (known, result.state), initial_noise_factor)
    assigned = assign_measurements(setup, state)
    new = {k: v for k, v in state.noise.items() if k not in result.state.noise}
    state.noise |= widen_initial_noise(setup, assigned, new)
    return _iterate(setup, state, assigned, max_rounds, (tolerance_m, tolerance_rad))


def _iterate(setup, state, assigned, max_rounds, tolerances):
    """The Result of rounds from a State and the Assignments there."""
    problem, rounds, settled = build_nlp(setup), [], False
    assigned = _with_noise(setup, assigned, state)
    while len(rounds) < max_rounds and not settled:
        last = state.correction_values
        state, fit, twists = solve_round(setup, problem, state, assigned)
        before, after = replace(state, correction_values=last), assign_measurements(setup, state)
        state = update_noise(setup, state, fit, twists, after)
        after = _with_noise(setup, after, state)
        rounds.append(
            _round_row(len(rounds), fit, twists, after, count_reassignments(setup, assigned, after))
        )
        settled = (
            fit.has_converged
            and rounds[-1]["n_reassigned"] == 0
            and rounds[-1]["step_m"] < tolerances[0]
            and rounds[-1]["step_rad"] < tolerances[1]
            and _has_converged(before, state, setup.correction_sigma)
        )
        assigned = after
    return EstimationResult(state, fit, assigned, rounds, bool(settled))


def _round_row(number, fit, twists, assigned, changed):
    """The row of one round."""
    moves = np.abs(twists).reshape(-1, 2, 3).max((0, 2))
    return {
        "round": number,
        "cost": fit.cost,
        "ipopt_iterations": fit.n_iterations,
        "n_inliers": int(sum((a.feature >= 0).sum() for a in assigned)),
        "step_m": moves[0],
        "step_rad": moves[1],
        "n_reassigned": changed,
    }


def _with_noise(setup, assigned, state):
    """The Assignments at the noise of the State."""
    return [
        a.with_noise(state.noise[noise_key(g)]) for g, a in zip(setup.groups, assigned, strict=True)
    ]


def _has_converged(before, after, sigma):
    """Whether the noise of two states is the same to 0.1 %, and θ to 1e-5 of its prior's sigma."""
    ratios = [after.mocap_noise_factor / before.mocap_noise_factor]
    ratios += [after.noise[key].total / before.noise[key].total for key in before.noise]
    shifts = [
        np.subtract(after.noise[k], before.noise[k]) / before.noise[k].total for k in before.noise
    ]
    same = np.all(np.abs(np.log(ratios)) < 1e-3) and np.all(np.abs(shifts) < 1e-3)
    return same and np.all(
        np.abs(after.correction_values - before.correction_values) <= 1e-5 * sigma
    )
