"""One round: linearize the measurements, solve the joint problem, step to its solution."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.estimation.corrections.base import ModelCorrection, TargetModelCorrection
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.estimate_state import State, apply_step
from calib.estimation.estimation_problem import SensorModel, Setup
from calib.estimation.estimation_result import SolveResult
from calib.estimation.nlp.joint_nlp import FactorLayout, JointNlp, Prior, ViewErrorPrior
from calib.estimation.nlp.measurement_factor import Factor, joint_information
from calib.estimation.pose_chain import (
    chain_unknown_columns,
    deskew_group,
    linearization_poses,
    model_with_corrections,
    moving_view_covariance,
    pack_unknowns,
    prior_means_and_weights,
    target_with_corrections,
)
from calib.estimation.residuals.assignment import Assignment
from calib.sensors.camera.camera_model import CameraModel

DAMPING_SIGMA = 0.1  # m, rad


class RoundSolution(NamedTuple):
    """The estimate after a solution, and the twists (s, 6) by which it moved the sensors."""

    state: State
    solve_result: SolveResult
    sensor_twists: np.ndarray


def build_nlp(setup: Setup) -> JointNlp:
    """Return the nonlinear program of a Setup."""
    layouts = [
        FactorLayout(
            sensor=g.sensor,
            kind=g.kind,
            target=setup.placements[g.placement].target,
            columns=chain_unknown_columns(setup, g),
            correction_index=setup.correction_index(g),
        )
        for g in setup.groups
    ]
    return JointNlp(
        models=setup.models,
        targets=setup.targets,
        layouts=layouts,
        n_chain_unknowns=setup.n_chain_unknowns,
        n_correction_values=setup.n_unknowns - setup.n_chain_unknowns,
    )


def solve_round(
    setup: Setup, nlp: JointNlp, state: State, assignments: Sequence[Assignment]
) -> RoundSolution:
    """Solve the joint problem with assignments and noise fixed."""
    x, scale = pack_unknowns(setup, state)
    poses, prior = linearization_poses(setup, state), Prior(*prior_means_and_weights(setup, state))
    nlp.set_models(cameras_at_estimate(setup, state), targets_at_estimate(setup, state))
    factors = linearize_measurements(setup, nlp, state, assignments)
    solution = nlp.solve(
        factors=factors, x=x, scale=scale, poses=poses, prior=_damped_prior(setup, prior)
    )
    offset = prior.weight * (x + prior.mean)
    solve_result = SolveResult(
        factors=factors,
        information=joint_information(factors, prior.weight),
        cost=sum(f.cost for f in factors) + float(offset @ offset) / 2,
        n_iterations=solution.n_iterations,
        status=solution.status,
        has_converged=solution.has_converged,
    )
    view_errors = update_moving_view_errors(setup, state, factors, solution.x - x)
    return RoundSolution(
        state=apply_step(setup, state, solution.x, view_errors),
        solve_result=solve_result,
        sensor_twists=solution.x[: 6 * len(setup.models)].reshape(-1, 6),
    )


def linearize_measurements(
    setup: Setup, nlp: JointNlp, state: State, assignments: Sequence[Assignment]
) -> list[Factor]:
    """Return the Factor of every group at the current estimate.

    nlp: with the models of cameras_at_estimate and the shapes of targets_at_estimate.
    """
    x, scale = pack_unknowns(setup, state)
    return nlp.linearize(
        x=x,
        scale=scale,
        poses=linearization_poses(setup, state),
        assignments=assignments,
        correction_derivatives=correction_derivatives(setup, state, assignments),
        view_error_priors=moving_view_error_priors(setup, state),
    )


def correction_derivatives(
    setup: Setup, state: State, assignments: Sequence[Assignment]
) -> list[np.ndarray]:
    """Return, per group, derivatives (q, k, n) of its residuals by the θ they depend on.

    Residuals in σ, θ in units of the σ of their priors.
    """
    out = []
    for g, a in zip(setup.groups, assignments, strict=True):
        linearization = GroupLinearization(
            setup=setup,
            state=state,
            model=model_with_corrections(setup, state, g),
            group=deskew_group(setup, state, g),
            assignment=a,
            J_pose=None,
        )
        parts = [c.derivative(linearization) for c in setup.corrections if c.affects(setup, g)]
        none = np.zeros((0, *a.residual.T.shape))
        scale = setup.correction_sigma[setup.correction_index(g)][:, None, None]
        out.append(scale * np.concatenate([none, *parts]))
    return out


def cameras_at_estimate(setup: Setup, state: State) -> dict[str, SensorModel]:
    """Return the current models, by sensor, of the cameras whose lens is estimated."""
    corrected = {c.subject for c in setup.corrections if isinstance(c, ModelCorrection)}
    cameras = {n for n in corrected if isinstance(setup.models[n], CameraModel)}
    first = {g.sensor: g for g in reversed(setup.groups) if g.sensor in cameras}
    return {name: model_with_corrections(setup, state, g) for name, g in first.items()}


def targets_at_estimate(setup: Setup, state: State) -> dict[str, Any]:
    """Return the current shapes, by name, of the targets whose shape is estimated."""
    corrected = {c.subject for c in setup.corrections if isinstance(c, TargetModelCorrection)}
    return {name: target_with_corrections(setup, state, name) for name in sorted(corrected)}


def moving_view_error_priors(setup: Setup, state: State) -> list[ViewErrorPrior]:
    """Return, per group, covariance and value of the error of a moving view; None at rest."""
    out = []
    for g in setup.groups:
        covariance = moving_view_covariance(setup, state, g)
        if covariance is None:
            out.append(ViewErrorPrior(None, None))
        else:
            error = state.moving_view_errors[g.placement - setup.n_still]
            out.append(ViewErrorPrior(covariance, error))
    return out


def update_moving_view_errors(
    setup: Setup, state: State, factors: Sequence[Factor], step: np.ndarray
) -> np.ndarray:
    """Return the errors (m, 6) of the moving views after a step (n,) of the unknowns."""
    errors = state.moving_view_errors.copy()
    for g, factor in zip(setup.groups, factors, strict=True):
        if factor.view_covariance is not None:
            errors[g.placement - setup.n_still] = factor.update_view_error(step[factor.columns])
    return errors


def _damped_prior(setup: Setup, prior: Prior) -> Prior:
    """Add a weak prior at the current poses: directions without information would drift.

    Steps in directions with information become slightly shorter.
    """
    weight = prior.weight.copy()
    poses = slice(setup.n_pose_unknowns)
    weight[poses] = np.hypot(prior.weight[poses], 1 / DAMPING_SIGMA)
    return Prior(prior.mean * (prior.weight / weight) ** 2, weight)
