"""What a hypothesis is, and how residuals change with what it supposes."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.estimation import noise_model, pose_chain
from calib.estimation.residuals import residual_registry

METRE = 1e-6  # step of a finite difference


@dataclass(frozen=True)
class Hypothesis:
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
    of: str
    on_sensor: bool
    kinds: tuple
    size: int
    derivative: Callable = field(repr=False)
    told: Callable = field(repr=False)
    remedy: str
    sigma: np.ndarray | None = field(default=None, repr=False)
    mended: Callable | None = field(default=None, repr=False)
    instead: "Hypothesis | None" = field(default=None, repr=False)
    joined: Callable | None = field(default=None, repr=False)
    moving: bool = False
    delay: Callable | None = field(default=None, repr=False)
    session: bool = False
    start: np.ndarray | None = field(default=None, repr=False)

    def estimated(self, setup):
        """The Setup in which its numbers are estimated, or None where they cannot be."""
        if self.joined:
            return self.joined(setup)
        if not self.mended:
            return None
        return replace(setup, corrections=(*setup.corrections, self.instead or self))

    def touches(self, setup, group):
        """Whether residuals of a group may depend on it."""
        place = setup.placements[group.placement]
        target = place.target
        if self.session:
            return self.of == place.session
        exact = setup.targets[target].points is None and (group.moving or not self.moving)
        concerned = not self.kinds or group.kind in self.kinds
        return exact and concerned and self.of == (group.sensor if self.on_sensor else target)


@dataclass(frozen=True)
class View:
    """A group where the estimate stands: its sensor's model there, its Assignment, and J (k, 6, n),
    the derivatives of its standardised residuals by the right perturbation of T_sensor_target."""

    setup: object
    state: object
    model: object
    group: object
    assigned: object
    J: np.ndarray

    @property
    def target(self):
        return self.setup.targets[self.setup.placements[self.group.placement].target]

    @cached_property
    def T_sensor_target(self):
        g = self.group
        return pose_chain.T_sensor_target(self.setup, self.state, g.sensor, g.placement)

    @cached_property
    def by_range(self):
        """Derivative (k, n) by what the measured ranges are too long by, m."""
        nearer = replace(self.model, range_bias=self.model.range_bias + METRE)
        moved = self.changed(model=nearer)
        return (moved - self.assigned.standard.T) / METRE

    def changed(self, model=None, target=None, T_sensor_target=None):
        """Standardised residuals (k, n) with another model, target or pose, in the same σ; a
        measurement that then belongs elsewhere keeps its residual."""
        g, setup, state, now = self.group, self.setup, self.state, self.assigned
        found = residual_registry.KINDS[g.kind].assign(
            self.model if model is None else model,
            self.target if target is None else target,
            self.T_sensor_target if T_sensor_target is None else T_sensor_target,
            g.keypoints,
            setup.associate,
            state.noise[noise_model.of(g)],
        )
        same = (found.nearest == now.nearest)[:, None]
        return replace(now, value=np.where(same, found.value, now.value)).standard.T


def differences(change, steps):
    """derivative of a Hypothesis from change(view, θ) -> arguments of View.changed."""

    def derivative(view):
        before = view.assigned.standard.T
        rows = np.diag(steps)
        return np.stack(
            [
                (view.changed(**change(view, row)) - before) / step
                for row, step in zip(rows, steps, strict=True)
            ]
        )

    return derivative
