"""A possible knock of the robot's markers within a session: all sensors shift alike."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.estimation import pose_chain
from calib.estimation.corrections.base import TestableCorrection, is_compared_exactly
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import format_twist_sigma
from calib.estimation.corrections.slips_and_bumps import (
    MIN_SHIFT_PLACEMENTS,
    ROBOT_KNOCK,
    SPLIT_REMEDY,
    ShiftStart,
    find_cut_time_s,
)
from calib.estimation.estimation_problem import MeasurementGroup, Setup
from calib.geometry.se3 import adjoint, invert_pose
from calib.io.config_change import ConfigChange

MIN_RESTS_ASIDE = 2  # before and after a knock
MAX_KNOCK_CUTS = 12  # rests of a session before which a knock is tested, evenly spaced


@dataclass(frozen=True)
class KnockedMarkersCorrection(TestableCorrection):
    """Twist of the robot's markers, from a placement on, in the robot frame of those before."""

    name = ROBOT_KNOCK
    n_values = 6
    start: ShiftStart

    def affects(self, setup: Setup, group: MeasurementGroup) -> bool:
        session = setup.placements[group.placement].session
        return session == self.subject and is_compared_exactly(setup, group)

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        by_target = linearization.pose_derivative
        if not self.start.is_before(linearization):
            return np.zeros_like(by_target)
        T_robot_target = pose_chain.T_robot_target(
            linearization.setup, linearization.state, linearization.group.placement
        )
        return np.einsum("ikn,ij->jkn", by_target, adjoint(invert_pose(T_robot_target)))

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"the robot's markers sit elsewhere {self.start}, shifted along and about the robot's "
            f"x, y, z by {format_twist_sigma(values, sigma)}; all sensors shift alike"
        )

    @property
    def remedy(self) -> str:
        check = "check whether the robot's markers were knocked then"
        if self.start.cut_s is None:
            return f"{check}; {SPLIT_REMEDY}, the later one with remounted: true"
        return (
            f"{check}; if so, set {self.start.describe_change('remounted_at_s')}, and where they "
            "sit since is estimated"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange | None:
        return self.start.change("remounted_at_s")


def make_knock_corrections(setup: Setup) -> Iterator[TestableCorrection]:
    """Yield the possible knocks of the robot's markers in every session."""
    for session in sorted({p.session for p in setup.placements}):
        starts = _rest_starts(setup, session)
        for i in _cut_positions(len(starts)):
            cut_s = find_cut_time_s(setup, session, starts[i])
            yield KnockedMarkersCorrection(session, ShiftStart(session, starts[i], i + 1, cut_s))


def _rest_starts(setup: Setup, session: str) -> list[int]:
    """Return when the rests of the robot start, ns; targets that rest at one time share a rest."""
    starts: dict[int, int] = {}
    for i, place in enumerate(setup.placements[: setup.n_still]):
        if place.session == session:
            rest = -1 - i if place.robot_rest is None else place.robot_rest
            starts[rest] = min(place.start_ns, starts.get(rest, place.start_ns))
    return sorted(starts.values())


def _cut_positions(n_rests: int) -> list[int]:
    """Return the positions of the first rests after the knocks that are tested."""
    if n_rests < MIN_SHIFT_PLACEMENTS:
        return []
    first, last = MIN_RESTS_ASIDE, n_rests - MIN_RESTS_ASIDE
    n_cuts = min(MAX_KNOCK_CUTS, last - first + 1)
    return np.unique(np.linspace(first, last, n_cuts).round().astype(int)).tolist()
