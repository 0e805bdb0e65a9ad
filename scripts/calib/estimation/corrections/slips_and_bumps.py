"""Possible shifts within a session: of a target in its MCS body, or of a sensor on the robot."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.estimation.corrections.base import SensorCorrection, TargetCorrection
from calib.estimation.corrections.group_linearization import GroupLinearization
from calib.estimation.corrections.number_wording import format_twist_sigma
from calib.estimation.estimation_problem import MeasurementGroup, Placement, Setup
from calib.geometry.se3 import adjoint, invert_pose
from calib.geometry.units import NS_PER_S
from calib.io.config_change import ConfigChange, pipeline_change

TARGET_SLIP, SENSOR_BUMP, ROBOT_KNOCK = "target_slip", "sensor_bump", "robot_knock"
SESSION_SHIFT_NAMES = TARGET_SLIP, SENSOR_BUMP, ROBOT_KNOCK
MIN_SHIFT_PLACEMENTS = 6  # a session with fewer placements is not tested for shifts
SHIFT_CUT_SHARES = (0.25, 0.5, 0.75)  # of the placements, after which a shift is tested
SPLIT_REMEDY = "calibrate what comes before and after as sessions of their own (from_s, to_s)"


@dataclass(frozen=True)
class ShiftStart:
    """The first placement after a shift: session, start, and number in the session, from 1.

    cut_s: time between it and the rest before, s after the first message of the log; None if that
    is not known.
    """

    session: str
    start_ns: int
    number: int
    cut_s: float | None = None

    def is_before(self, linearization: GroupLinearization) -> bool:
        """Return whether a group was measured in the session after the shift."""
        place = linearization.setup.placements[linearization.group.placement]
        return place.session == self.session and place.start_ns >= self.start_ns

    def __str__(self) -> str:
        return f"from its placement {self.number} in session {self.session} on"

    def describe_change(self, key: str) -> str:
        """Return `sessions.<session>.<key>: <time>`."""
        return f"sessions.{self.session}.{key}: {self.cut_s}"

    def change(self, key: str) -> ConfigChange | None:
        """Return the change of a key of the session to the time of the shift, if it is known."""
        if self.cut_s is None:
            return None
        return pipeline_change(f"sessions.{self.session}.{key}", self.cut_s)


@dataclass(frozen=True)
class TargetSlipCorrection(TargetCorrection):
    """Right perturbation of T_body_target from a placement on: its markers were knocked, or the
    target slipped in its holder."""

    name = TARGET_SLIP
    n_values = 6
    start: ShiftStart

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        by_target = linearization.pose_derivative
        return by_target if self.start.is_before(linearization) else np.zeros_like(by_target)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"{self.subject} is shifted in its MCS body {self.start}, along and about its own "
            f"x, y, z: by {format_twist_sigma(values, sigma)}"
        )

    @property
    def remedy(self) -> str:
        check = f"check whether {self.subject} or its markers were knocked then"
        if self.start.cut_s is None:
            return f"{check}; {SPLIT_REMEDY}"
        return f"{check}; to use only what comes before, set {self.start.describe_change('to_s')}"

    def config_change(self, values: np.ndarray) -> ConfigChange | None:
        return self.start.change("to_s")


@dataclass(frozen=True)
class SensorBumpCorrection(SensorCorrection):
    """Right perturbation of T_robot_sensor from a placement on."""

    name = SENSOR_BUMP
    n_values = 6
    start: ShiftStart

    def derivative(self, linearization: GroupLinearization) -> np.ndarray:
        if not self.start.is_before(linearization):
            return np.zeros_like(linearization.pose_derivative)
        A = -adjoint(invert_pose(linearization.T_sensor_target))
        return np.einsum("ikn,ij->jkn", linearization.pose_derivative, A)

    def describe(self, values: np.ndarray, sigma: np.ndarray) -> str:
        return (
            f"{self.subject} is shifted on the robot {self.start}, along and about its own "
            f"x, y, z: by {format_twist_sigma(values, sigma)}"
        )

    @property
    def remedy(self) -> str:
        check = f"check whether {self.subject} was bumped then"
        if self.start.cut_s is None:
            return f"{check}; {SPLIT_REMEDY}"
        return (
            f"{check}; for the pose that it has since, set {self.start.describe_change('from_s')}"
        )

    def config_change(self, values: np.ndarray) -> ConfigChange | None:
        return self.start.change("from_s")


def make_slip_corrections(setup: Setup) -> Iterator[TargetCorrection]:
    """Yield the possible slips of every target that is compared exactly."""
    exact = {n for n, target in setup.targets.items() if target.uses_exact_surface}
    for (session, name), starts in _placement_starts(setup, lambda g, p: p.target):
        if name in exact:
            for start in _cut_session(setup, session, starts):
                yield TargetSlipCorrection(name, start)


def make_bump_corrections(setup: Setup) -> Iterator[SensorCorrection]:
    """Yield the possible bumps of every sensor."""
    for (session, name), starts in _placement_starts(setup, lambda g, p: g.sensor):
        for start in _cut_session(setup, session, starts):
            yield SensorBumpCorrection(name, start)


def _placement_starts(
    setup: Setup, name_subject: Callable[[MeasurementGroup, Placement], str]
) -> list[tuple[tuple[str, str], set[int]]]:
    """Return ((session, subject), starts of its still placements, ns), sorted."""
    starts: dict[tuple[str, str], set[int]] = {}
    for g in setup.groups:
        place = setup.placements[g.placement]
        if place.moving_view is None:
            subject = name_subject(g, place)
            starts.setdefault((place.session, subject), set()).add(place.start_ns)
    return sorted(starts.items())


def find_cut_time_s(setup: Setup, session: str, start_ns: int) -> float | None:
    """Return a time between a rest and the one before, s after the first message of the log.

    None if the start of the log is not known.
    """
    log_start_ns = setup.log_starts_ns.get(session)
    if log_start_ns is None:
        return None
    still = setup.placements[: setup.n_still]
    ends = [p.end_ns for p in still if p.session == session and p.end_ns <= start_ns]
    cut_ns = (max(ends, default=start_ns) + start_ns) / 2
    return round((cut_ns - log_start_ns) / NS_PER_S, 2)


def _cut_session(setup: Setup, session: str, starts: set[int]) -> list[ShiftStart]:
    """Return the placements of a session, starts in ns, before which a shift is tested."""
    if len(starts) < MIN_SHIFT_PLACEMENTS:
        return []
    order = sorted(starts)
    cuts = [int(share * len(order)) for share in SHIFT_CUT_SHARES]
    return [
        ShiftStart(session, order[i], i + 1, find_cut_time_s(setup, session, order[i]))
        for i in cuts
    ]
