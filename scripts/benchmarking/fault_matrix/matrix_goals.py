"""The summary of the matrix: each goal, what was measured, and whether it is met."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.stats import beta

from benchmarking.fault_matrix.draw_outcome import DrawOutcome
from benchmarking.fault_matrix.row_measurement import RowResult

MIN_CLEAN_PASS = 0.99
MOVED_SIGMAS = 3.0  # from which a fault moves a pose
MIN_WARNED, MIN_NAMED = 0.99, 0.90
WRONG_SIGMAS = 5.0  # from which an estimate is wrong
CONFIDENCE = 0.95  # of the least share that draws show
CURED_SHARE = 0.5  # of an error before the advice, that a cure leaves at most


class GoalLine(NamedTuple):
    """A goal in words, what was measured, and whether it is met."""

    goal: str
    measured: str
    is_met: bool


def check_goals(clean: list[RowResult], faulty: list[RowResult]) -> list[GoalLine]:
    """Return the lines of the summary."""
    moved = [row for row in faulty if does_matter(row)]
    return [
        _share_line(
            f"clean recordings pass in {MIN_CLEAN_PASS:.0%} of draws",
            [(row, d.level == "pass") for row in clean for d in row.before],
            MIN_CLEAN_PASS,
        ),
        _share_line(
            f"what moves a pose by {MOVED_SIGMAS:g} σ, or leaves none, is warned of or fails in "
            f"{MIN_WARNED:.0%}",
            [(row, d.level != "pass") for row in moved for d in row.before],
            MIN_WARNED,
        ),
        _share_line(
            f"its cause is named first in {MIN_NAMED:.0%}",
            [(row, d.names(row.causes)) for row in moved if row.causes for d in row.before],
            MIN_NAMED,
        ),
        _share_line(
            f"no estimate that is off by {WRONG_SIGMAS:g} σ passes",
            [(row, not is_wrong_pass(d)) for row in [*clean, *faulty] for d in row.before],
            1.0,
        ),
        _share_line(
            "following the first advice turns no wrong result into a pass",
            [
                (row, not is_hidden(before, after))
                for row in faulty
                for before, after in zip(row.before, row.after, strict=True)
                if after is not None and before.worst_sigmas > WRONG_SIGMAS
            ],
            1.0,
        ),
    ]


def does_matter(row: RowResult) -> bool:
    """Return whether a fault moves a pose, in the middle one of its draws, or leaves none."""
    sigmas = [d.worst_sigmas if d.errors else np.inf for d in row.before]
    lacks_pose = any(len(d.errors) < row.n_sensors for d in row.before)
    return bool(sigmas) and (lacks_pose or float(np.median(sigmas)) > MOVED_SIGMAS)


def is_wrong_pass(outcome: DrawOutcome) -> bool:
    """Return whether a wrong estimate passes."""
    return outcome.level == "pass" and outcome.worst_sigmas > WRONG_SIGMAS


def is_hidden(before: DrawOutcome, after: DrawOutcome) -> bool:
    """Return whether a wrong result passes after the advice, without having been cured.

    A σ that was only widened cures nothing: the error must become smaller, too.
    """
    if after.level != "pass":
        return False
    wrong = [n for n, error in before.errors.items() if error[2] > WRONG_SIGMAS]
    return not all(_is_cured(before.errors[n], after.errors[n]) for n in wrong if n in after.errors)


def _is_cured(before: tuple[float, float, float], after: tuple[float, float, float]) -> bool:
    """Return whether the error of a pose, (mm, °, in σ), is cured."""
    shrunk = after[0] <= CURED_SHARE * before[0] or after[1] <= CURED_SHARE * before[1]
    return shrunk and after[2] <= WRONG_SIGMAS


def _share_line(goal: str, found: Iterable[tuple[RowResult, bool]], min_share: float) -> GoalLine:
    """Return the line of a goal that a share of draws meets; the rows that fall short are named."""
    found = list(found)
    if not found:
        return GoalLine(goal, "not measured", False)
    good = sum(ok for _, ok in found)
    short: dict[str, list[bool]] = {}
    for row, ok in found:
        short.setdefault(row.title, []).append(ok)
    names = [f"{title} {len(v) - sum(v)} of {len(v)}" for title, v in short.items() if not all(v)]
    least = least_share(good, len(found))
    measured = f"{good} of {len(found)} draws, {good / len(found):.1%}, at least {least:.1%}"
    if names:
        measured += f"; short: {', '.join(names)}"
    return GoalLine(goal, measured, good >= min_share * len(found))


def least_share(n_good: int, n: int) -> float:
    """Return the least share of good draws that n_good of n show (Clopper and Pearson 1934)."""
    return float(beta.ppf(1 - CONFIDENCE, n_good, n - n_good + 1)) if n_good else 0.0
