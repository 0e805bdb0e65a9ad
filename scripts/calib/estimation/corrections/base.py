"""Corrections: what they have in common, and the four kinds that the estimation tells apart.

A correction has a few values θ, zero if all is as configured, that change the residuals of the
groups it affects. A TestableCorrection describes an error that a score test can find. The values
of an EstimableCorrection can be unknowns of the joint problem: a ModelCorrection changes the model
of a sensor, a TargetModelCorrection the shape of a target, a ClockCorrection the time at which a
moving target is looked up.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.estimation.residuals.residual_registry import RESIDUAL_KINDS
from calib.io.config_change import ConfigChange
from calib.sensors.camera.camera_model import CameraModel
from calib.sensors.lidar.lidar_model import LidarModel

if TYPE_CHECKING:  # it imports the chain of poses, which asks corrections for models and delays
    from calib.estimation.corrections.group_linearization import GroupLinearization

Model = TypeVar("Model", CameraModel, LidarModel)


@dataclass(frozen=True)
class Correction(ABC):
    """Values θ about one subject: the name of a sensor, a target or a session.

    name: what the values correct, as in calibration.json.
    """

    name: ClassVar[str]
    subject: str

    @property
    @abstractmethod
    def n_values(self) -> int:
        """Return the number of values θ."""

    @abstractmethod
    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        """Return whether residuals of a group may depend on the values."""

    @abstractmethod
    def derivative(self, linearization: "GroupLinearization") -> np.ndarray:
        """Return the derivatives (n_values, k, n) of a group's standardized residuals."""

    @abstractmethod
    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        """Describe the error that values (n_values,) with their σ stand for."""


class TestableCorrection(Correction):
    """A possible error of the configuration or the hardware that a score test looks for.

    kinds: the kinds of measurement that depend on it. min_lead: gain in log likelihood by which it
    must be ahead of every other explanation to be estimated unasked. max_size: of a value; a larger
    one is no solution, as derivatives no longer hold.
    """

    kinds: ClassVar[frozenset[str]] = frozenset(RESIDUAL_KINDS)
    min_lead: ClassVar[float] = -np.inf
    max_size: ClassVar[float] = np.inf

    @property
    @abstractmethod
    def remedy(self) -> str:
        """Say what to do if the error is found."""

    def config_change(self, values: np.ndarray) -> ConfigChange | None:
        """Return the change of the config that corrects the error or lets it be estimated.

        values (n_values,): estimate of the error. None if no key holds what is wrong.
        """
        return None

    def add_to_setup(self, setup: Setup) -> Setup | None:
        """Return the Setup that estimates the error, or None if it cannot be estimated."""
        return None


class SensorCorrection(TestableCorrection):
    """An error of one sensor."""

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        return (
            group.sensor == self.subject
            and group.kind in self.kinds
            and is_compared_exactly(setup, group)
        )


class TargetCorrection(TestableCorrection):
    """An error of one target."""

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        return (
            setup.placements[group.placement].target == self.subject
            and group.kind in self.kinds
            and is_compared_exactly(setup, group)
        )


@dataclass(frozen=True)
class EstimableCorrection(Correction):
    """Values that can be unknowns of the joint problem.

    prior_sigma: (n_values,) σ of their prior, SI.
    """

    prior_sigma: np.ndarray = field(repr=False)

    @property
    def n_values(self) -> int:
        return len(self.prior_sigma)

    @property
    def initial_values(self) -> np.ndarray:
        """Return the values (n_values,) from which the estimation starts."""
        return np.zeros(self.n_values)


class ModelCorrection(SensorCorrection, EstimableCorrection, Generic[Model]):
    """Values that change the model of a sensor."""

    @abstractmethod
    def apply_to_model(self, model: Model, values: np.ndarray, placement: int) -> Model:
        """Return the sensor's model in a placement (its index) with the values applied."""

    def add_to_setup(self, setup: Setup) -> Setup:
        return replace(setup, corrections=(*setup.corrections, self))


class TargetModelCorrection(TargetCorrection, EstimableCorrection):
    """Values that change the shape of a target, for all sensors alike."""

    @abstractmethod
    def apply_to_target(self, target: Any, values: np.ndarray) -> Any:
        """Return the target's shape with the values applied."""

    def add_to_setup(self, setup: Setup) -> Setup:
        return replace(setup, corrections=(*setup.corrections, self))


class ClockCorrection(EstimableCorrection):
    """Values that change how far a sensor's clock is behind the motion capture's."""

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        return (
            group.is_moving and group.sensor == self.subject and is_compared_exactly(setup, group)
        )

    @abstractmethod
    def delay_s(self, values: np.ndarray, placement: Placement) -> float:
        """Return t_mcs - stamp, s, in a view of a moving target, beyond the initial guess."""


def is_compared_exactly(setup: Setup, group: MeasurementGroup) -> bool:
    """Return whether residuals use the exact shape of the target, not the points of a template."""
    return setup.targets[setup.placements[group.placement].target].uses_exact_surface
