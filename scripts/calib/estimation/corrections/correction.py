"""What a hypothesis is, and how residuals change with what it supposes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.noise_model import noise_key
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS

FINITE_STEP_M = 1e-6  # step of a finite difference


@dataclass(frozen=True)
class Correction:
    """name, e.g. squares; of: the target or sensor that it is about, on_sensor says which;
    kinds: of the measurements that depend on it, none for all; size: how many numbers θ;
    derivative(view) -> (size, k, n) of the standardised residuals of a View; told(θ, σ) -> what is
    wrong, in words and numbers; remedy: what to do about it.

    Where θ may be estimated along with the poses: sigma (size,) of its prior, and
    mended(model, θ, placement) -> the sensor's model that knows of it; instead: the Hypothesis that
    is then estimated, where it has finer numbers than the residuals can ask for. Or, where θ is a
    pose of the chain, joined(setup) -> the Setup in which it is estimated. moving: whether it
    concerns only views in motion, and delay(θ, placement) -> s by which the sensor's clock then is
    behind that of the MCS; session: whether `of` is a session; start (size,): θ to begin with,
    default zero."""

    name: str
    subject: str
    is_sensor_correction: bool
    kinds: tuple
    n_values: int
    derivative: Callable = field(repr=False)
    describe: Callable = field(repr=False)
    remedy: str
    prior_sigma: np.ndarray | None = field(default=None, repr=False)
    apply_to_model: Callable | None = field(default=None, repr=False)
    estimated_form: "Correction | None" = field(default=None, repr=False)
    as_free_mount: Callable | None = field(default=None, repr=False)
    is_moving_only: bool = False
    clock_delay: Callable | None = field(default=None, repr=False)
    is_per_session: bool = False
    initial_values: np.ndarray | None = field(default=None, repr=False)

    def add_to_setup(self, setup):
        """The Setup in which its numbers are estimated, or None where they cannot be."""
        if self.as_free_mount:
            return self.as_free_mount(setup)
        if not self.apply_to_model:
            return None
        return replace(setup, corrections=(*setup.corrections, self.estimated_form or self))

    def affects(self, setup, group):
        """Whether residuals of a group may depend on it."""
        place = setup.placements[group.placement]
        target = place.target
        if self.is_per_session:
            return self.subject == place.session
        exact = setup.targets[target].uses_exact_surface and (
            group.is_moving or not self.is_moving_only
        )
        concerned = not self.kinds or group.kind in self.kinds
        return (
            exact
            and concerned
            and self.subject == (group.sensor if self.is_sensor_correction else target)
        )


@dataclass(frozen=True)
class GroupLinearization:
    """A group where the estimate stands: its sensor's model there, its Assignment, and J (k, 6, n),
    the derivatives of its standardised residuals by the right perturbation of T_sensor_target."""

    setup: object
    state: object
    model: object
    group: object
    assignment: object
    J_pose: np.ndarray

    @property
    def target(self):
        return self.setup.targets[self.setup.placements[self.group.placement].target]

    @cached_property
    def T_sensor_target(self):
        g = self.group
        return pose_chain.T_sensor_target(self.setup, self.state, g.sensor, g.placement)

    @cached_property
    def range_derivative(self):
        """Derivative (k, n) by what the measured ranges are too long by, m."""
        nearer = replace(self.model, range_bias=self.model.range_bias + FINITE_STEP_M)
        moved = self.residuals_with(model=nearer)
        return (moved - self.assignment.standardized.T) / FINITE_STEP_M

    def residuals_with(self, model=None, target=None, T_sensor_target=None):
        """Standardised residuals (k, n) with another model, target or pose, in the same σ; a
        measurement that then belongs elsewhere keeps its residual."""
        g, setup, state, now = self.group, self.setup, self.state, self.assignment
        found = RESIDUAL_KINDS[g.kind].assign(
            self.model if model is None else model,
            self.target if target is None else target,
            self.T_sensor_target if T_sensor_target is None else T_sensor_target,
            g.keypoints,
            setup.associate_options,
            state.noise[noise_key(g)],
        )
        same = (found.candidate_feature == now.candidate_feature)[:, None]
        return replace(now, residual=np.where(same, found.residual, now.residual)).standardized.T


def make_finite_difference(make_change, steps):
    """derivative of a Hypothesis from change(view, θ) -> arguments of View.changed."""

    def derivative(view):
        before = view.assignment.standardized.T
        rows = np.diag(steps)
        return np.stack(
            [
                (view.residuals_with(**make_change(view, row)) - before) / step
                for row, step in zip(rows, steps, strict=True)
            ]
        )

    return derivative
