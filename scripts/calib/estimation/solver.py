"""The solver: solve, assign measurements, estimate noise, and repeat until nothing changes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation.estimate_state import State, initial_state, warm_start
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult, RoundRow
from calib.estimation.measurement_assignment import (
    assign_at_initial_guess,
    assign_measurements,
    count_reassignments,
    with_noise_of,
)
from calib.estimation.noise.noise_estimation import update_noise
from calib.estimation.noise.noise_model import widen_initial_noise
from calib.estimation.residuals.assignment import Assignment
from calib.estimation.round_solution import RoundSolution, build_nlp, solve_round

MAX_NOISE_CHANGE = 1e-3  # relative; below it the noise has converged
MAX_CORRECTION_CHANGE = 1e-5  # of the σ of its prior


@dataclass(frozen=True)
class StoppingRule:
    """Most rounds, and the steps of sensors, m and rad, below which the estimate has converged."""

    max_rounds: int
    tolerance_m: float
    tolerance_rad: float


def estimate_poses(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    *,
    max_rounds: int,
    tolerance_m: float,
    tolerance_rad: float,
    initial_noise_factor: float,
) -> EstimationResult:
    """Estimate all unknowns of a Setup, starting at poses by sensor.

    initial_noise_factor: least factor on the configured noise to start with, so that a wrong start
    makes no inlier an outlier. The noise then falls to what the residuals show.

    Converged when no measurement is reassigned, no sensor moves by more than the tolerances, and no
    noise changes by more than 0.1 %.
    """
    state = initial_state(setup, T_robot_sensor, initial_noise_factor)
    if not setup.groups:
        return EstimationResult(state, None, [], [], False)
    state, assignments = start_from_initial_guess(setup, state)
    rule = StoppingRule(max_rounds, tolerance_m, tolerance_rad)
    return _iterate(setup, state, assignments, rule)


def start_from_initial_guess(setup: Setup, state: State) -> tuple[State, list[Assignment]]:
    """Assign measurements at the initial State; return it with noise wide enough for them."""
    assignments = assign_at_initial_guess(setup, state)
    state = replace(state, noise=widen_initial_noise(setup, assignments, state.noise))
    return state, with_noise_of(setup, state, assignments)


def continue_estimate(
    setup: Setup,
    previous: tuple[Setup, EstimationResult],
    *,
    max_rounds: int,
    tolerance_m: float,
    tolerance_rad: float,
    initial_noise_factor: float,
) -> EstimationResult:
    """Estimate as estimate_poses does, starting at the result of a smaller Setup.

    previous: that Setup, of the same placements at rest, and its result; initial_noise_factor: of
    the groups that it did not have.
    """
    previous_setup, result = previous
    if result.solve_result is None:
        return estimate_poses(
            setup,
            result.state.T_robot_sensor,
            max_rounds=max_rounds,
            tolerance_m=tolerance_m,
            tolerance_rad=tolerance_rad,
            initial_noise_factor=initial_noise_factor,
        )
    state = warm_start(setup, previous_setup, result.state, initial_noise_factor)
    assignments = assign_measurements(setup, state)
    new = {k: v for k, v in state.noise.items() if k not in result.state.noise}
    state = replace(state, noise=state.noise | widen_initial_noise(setup, assignments, new))
    rule = StoppingRule(max_rounds, tolerance_m, tolerance_rad)
    return _iterate(setup, state, with_noise_of(setup, state, assignments), rule)


def _iterate(
    setup: Setup, state: State, assignments: list[Assignment], rule: StoppingRule
) -> EstimationResult:
    """Repeat rounds from a State and the Assignments there until the estimate converges."""
    nlp = build_nlp(setup)
    rounds: list[RoundRow] = []
    has_converged = False
    while len(rounds) < rule.max_rounds and not has_converged:
        previous_state, previous_assignments = state, assignments

        # Solve for poses and corrections, with assignments and noise fixed
        solution = solve_round(setup, nlp, state, assignments)

        # Assign the measurements at the new poses
        assignments = assign_measurements(setup, solution.state)

        # Estimate the noise from the residuals there
        state = update_noise(setup, solution, assignments)
        assignments = with_noise_of(setup, state, assignments)

        # Record the round
        n_reassigned = count_reassignments(setup, before=previous_assignments, after=assignments)
        row = _round_row(len(rounds), solution, assignments, n_reassigned)
        rounds.append(row)

        # Stop when nothing changes any more
        has_converged = (
            solution.solve_result.has_converged
            and n_reassigned == 0
            and row["step_m"] < rule.tolerance_m
            and row["step_rad"] < rule.tolerance_rad
            and _noise_has_converged(previous_state, state)
            and _corrections_have_converged(setup, previous_state, state)
        )
    return EstimationResult(
        state=state,
        solve_result=solution.solve_result,
        assignments=assignments,
        rounds=rounds,
        has_converged=has_converged,
    )


def _round_row(
    number: int, solution: RoundSolution, assignments: Sequence[Assignment], n_reassigned: int
) -> RoundRow:
    """Return the row of iterations.parquet of one round."""
    steps = np.abs(solution.sensor_twists).reshape(-1, 2, 3).max((0, 2))
    return {
        "round": number,
        "cost": solution.solve_result.cost,
        "ipopt_iterations": solution.solve_result.n_iterations,
        "n_inliers": int(sum((a.feature >= 0).sum() for a in assignments)),
        "step_m": float(steps[0]),
        "step_rad": float(steps[1]),
        "n_reassigned": n_reassigned,
    }


def _noise_has_converged(before: State, after: State) -> bool:
    """Return whether no noise changed by more than MAX_NOISE_CHANGE."""
    ratios = [after.mocap_noise_factor / before.mocap_noise_factor]
    ratios += [after.noise[key].total / before.noise[key].total for key in before.noise]
    shifts = [
        np.subtract(after.noise[k], before.noise[k]) / before.noise[k].total for k in before.noise
    ]
    return bool(
        np.all(np.abs(np.log(ratios)) < MAX_NOISE_CHANGE)
        and np.all(np.abs(shifts) < MAX_NOISE_CHANGE)
    )


def _corrections_have_converged(setup: Setup, before: State, after: State) -> bool:
    """Return whether no correction changed by more than MAX_CORRECTION_CHANGE."""
    change = np.abs(after.correction_values - before.correction_values)
    return bool(np.all(change <= MAX_CORRECTION_CHANGE * setup.correction_sigma))
