"""Split halves: two complementary halves of the placements, each estimated with its own choices.

σ is true if the poses of the halves differ by what their covariances say. The halves share what
errs alike in every placement (lens, board, mount): they test whether a result repeats.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import null_space

from calib.diagnosis.covariance.cluster_covariance import with_reported_covariance
from calib.diagnosis.error_search.supported_corrections import (
    BY_ONE_HALF,
    list_adopted_corrections,
    select_corrections,
    with_requested_corrections,
)
from calib.diagnosis.observability import find_undetermined_directions
from calib.estimation.estimation_problem import Setup
from calib.estimation.estimation_result import EstimationResult
from calib.estimation.nlp.information_matrix import scale_to_unit_diagonal
from calib.geometry.se3 import invert_pose, se3_log

MIN_HALF_PLACEMENTS = 4  # of a sensor in each half: with fewer, it is not compared
SEED = 7
MIN_HALF_TOLERANCE = 1e-6  # m, rad: halves are compared to a hundredth of their σ

Rest = list[int]  # placements of one rest of the robot, by index


@dataclass(frozen=True)
class HalfEstimate:
    """The estimate of one half of the placements.

    setup: of these placements, with what the half estimates; adopted: (name, subject) of the
    corrections that the half chose by itself, a mount by its target.
    """

    setup: Setup
    result: EstimationResult
    adopted: frozenset[tuple[str, str]]


class HalfComparison(NamedTuple):
    """A sensor's pose in the second half against the first, along the sensor's axes.

    shift, sigma: (6,) m and rad. nees: normalised squared error, on average n_directions, of the
    directions that both halves determine.
    """

    shift: np.ndarray
    sigma: np.ndarray
    nees: float
    n_directions: int


def estimate_halves(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    *,
    seed: int = SEED,
    **limits: Any,
) -> tuple[HalfEstimate, HalfEstimate] | None:
    """Estimate two halves of the still placements, each with its own choice of corrections.

    None if no sensor sees MIN_HALF_PLACEMENTS placements of both. Moving views are left out.
    estimate_options: solve.estimate of the config; limits: of estimate_poses.
    """
    halves, limits = split_placements(setup, seed), _limits_of_halves(limits)
    if not sensors_in_halves(setup, halves):
        return None
    first, second = (
        _estimate_half(setup, T_robot_sensor, estimate_options, h, limits) for h in halves
    )
    return first, second


def _limits_of_halves(limits: dict[str, Any]) -> dict[str, Any]:
    """Return the limits of estimate_poses for halves; limits: those for all placements."""
    tolerances = {k: max(limits[k], MIN_HALF_TOLERANCE) for k in ("tolerance_m", "tolerance_rad")}
    return limits | tolerances


def split_placements(setup: Setup, seed: int = SEED) -> tuple[list[int], list[int]]:
    """Return the indices of the still placements of two complementary halves, each sorted.

    The placements of one rest of the robot stay together, as they share its error. Rests come in
    random order, each into the half that has fewer placements of its sensors and targets.
    """
    rng = np.random.default_rng(seed)
    halves: tuple[Rest, Rest] = ([], [])
    excess: Counter[tuple[str, ...]] = Counter()  # of the first half over the second
    rests = _list_rests(setup)
    for i in rng.permutation(len(rests)):
        views = _count_views(setup, rests[i])
        balance = sum(excess[key] * n for key, n in views.items())
        joins_second = balance > 0 or (balance == 0 and rng.random() < 0.5)
        halves[joins_second].extend(rests[i])
        sign = -1 if joins_second else 1
        excess.update({key: sign * n for key, n in views.items()})
    return sorted(halves[0]), sorted(halves[1])


def sensors_in_halves(setup: Setup, halves: Sequence[Collection[int]]) -> list[str]:
    """Return the sensors that see enough placements of both halves."""
    seen = {name: {g.placement for g in setup.groups if g.sensor == name} for name in setup.models}
    return [
        name
        for name, placements in sorted(seen.items())
        if min(len(placements & set(half)) for half in halves) >= MIN_HALF_PLACEMENTS
    ]


def compare_halves(
    halves: tuple[HalfEstimate, HalfEstimate], sensor: str, added: np.ndarray | None = None
) -> HalfComparison | None:
    """Compare a sensor's poses of both halves; None if they determine no common direction.

    added: (6, 6) covariance of the sensor's pose in each half beyond that of its estimate.
    """
    solved = [
        h
        for h in halves
        if h.result.solve_result is not None
        and count_placements(h.setup, sensor) >= MIN_HALF_PLACEMENTS
    ]
    if len(solved) < 2:
        return None
    first, second = (h.result.state.T_robot_sensor[sensor] for h in halves)
    shift = se3_log(invert_pose(first) @ second)
    covariance = sum(_pose_covariance(h, sensor) for h in halves)
    if added is not None:
        covariance = covariance + 2 * added
    U = _determined_directions(np.vstack([_undetermined_directions(h, sensor) for h in halves]))
    if not U.shape[1]:
        return None
    scale, unit = scale_to_unit_diagonal(U.T @ covariance @ U)
    error = scale * (U.T @ shift)
    nees = float(error @ np.linalg.solve(unit, error))
    return HalfComparison(shift, np.sqrt(np.diag(covariance)), nees, U.shape[1])


def split_halves_json(
    setup: Setup, halves: tuple[HalfEstimate, HalfEstimate] | None, added: np.ndarray
) -> dict[str, Any] | None:
    """Return {adopted, sensors} of both halves; None without halves.

    adopted: [{name, subject}] by half. sensors: by name {shift, sigma, nees, n_directions,
    placements}; placements: their number by half. setup: of all placements. added: (m, m)
    covariance of its sensors and mounts that the choice of corrections adds in each half.
    """
    if halves is None:
        return None
    sensors = {}
    for i, name in enumerate(sorted(setup.models)):
        at = slice(6 * i, 6 * i + 6)
        comparison = compare_halves(halves, name, added[at, at])
        if comparison is not None:
            sensors[name] = {
                "shift": comparison.shift.tolist(),
                "sigma": comparison.sigma.tolist(),
                "nees": comparison.nees,
                "n_directions": comparison.n_directions,
                "placements": [count_placements(h.setup, name) for h in halves],
            }
    adopted = [
        [{"name": name, "subject": subject} for name, subject in sorted(h.adopted)] for h in halves
    ]
    return {"adopted": adopted, "sensors": sensors}


def count_placements(setup: Setup, subject: str) -> int:
    """Return the number of placements of a sensor, target or session."""
    p = setup.placements
    return len(
        {
            g.placement
            for g in setup.groups
            if subject in (g.sensor, p[g.placement].target, p[g.placement].session)
        }
    )


def _estimate_half(
    setup: Setup,
    T_robot_sensor: dict[str, np.ndarray],
    estimate_options: dict[str, Any],
    indices: Sequence[int],
    limits: dict[str, Any],
) -> HalfEstimate:
    half = setup.at_placements(indices)
    start = {n: T_robot_sensor[n] for n in half.models}
    chosen, result = select_corrections(
        half, start, estimate_options, required=BY_ONE_HALF, **limits
    )
    adopted = list_adopted_corrections(with_requested_corrections(half, estimate_options), chosen)
    return HalfEstimate(chosen, with_reported_covariance(chosen, result), adopted)


def _list_rests(setup: Setup) -> list[Rest]:
    rests: dict[tuple[str, int], Rest] = {}
    for k, p in enumerate(setup.placements[: setup.n_still]):
        rests.setdefault((p.session, int(setup.robot_error_index[k])), []).append(k)
    return list(rests.values())


def _count_views(setup: Setup, rest: Rest) -> Counter[tuple[str, ...]]:
    """Count the placements of a rest by sensor, by target, and by sensor and target."""
    views = {
        (g.sensor, setup.placements[g.placement].target, g.placement)
        for g in setup.groups
        if g.placement in rest
    }
    out: Counter[tuple[str, ...]] = Counter()
    for sensor, target, _ in views:
        out.update([(sensor,), (sensor, target)])
    return out


def _pose_covariance(half: HalfEstimate, sensor: str) -> np.ndarray:
    at = 6 * sorted(half.setup.models).index(sensor)
    return half.result.solved.covariance[at : at + 6, at : at + 6]


def _undetermined_directions(half: HalfEstimate, sensor: str) -> np.ndarray:
    names = sorted(half.setup.models)
    return find_undetermined_directions(
        half.result.solved.information, len(names), names.index(sensor)
    )


def _determined_directions(undetermined: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (6, k) of the directions beside undetermined ones (m, 6)."""
    if not len(undetermined):
        return np.eye(6)
    return null_space(undetermined)
