"""The set of corrections that explains the residuals: one is added, removed or replaced at a time.

The best candidate is accepted first, then others beside it. What later ones have made superfluous
is removed. A replacement is kept only if the likelihood of the whole set, after growing again,
rises; so the search ends.
"""

from dataclasses import dataclass, field

from calib.diagnosis.error_search.candidate_scores import (
    P_CONSIDER,
    ScoredCorrection,
    Scores,
    ScoreTests,
)
from calib.estimation.corrections.score_test import ScoreStep, min_gain
from calib.estimation.corrections.slips_and_bumps import SESSION_SHIFT_NAMES

MAX_SUSPECTED_ERRORS = 6  # accepted beside each other
# Share of the best gain from which another correction may be the true one.
MIN_ALTERNATIVE_GAIN_RATIO = 0.5
MIN_GAIN_PER_PARAMETER = 3.0  # log-likelihood gain that each further parameter must bring
LEAD_SHARE = 0.5  # of Correction.min_lead: halves of the placements are searched too
MIN_LIKELIHOOD_RISE = 1e-6  # of a set of corrections, to replace another set

Gains = dict[int, float]  # in log likelihood, by index of the candidate
IndexSet = frozenset[int]


@dataclass(frozen=True)
class AcceptedError:
    """An accepted candidate, the step without it, and the scores of it and its alternatives."""

    index: int
    step_without: ScoreStep
    scores: Scores

    @property
    def score(self) -> ScoredCorrection:
        """Return the score of the candidate itself."""
        return self.scores[self.index]


def accept_errors(tests: ScoreTests) -> list[AcceptedError]:
    """Accept the candidates that, beside each other, explain more than chance.

    In order of their index. Nothing that explains more than chance beside them is left, unless
    MAX_SUSPECTED_ERRORS are accepted.
    """
    chosen = _CorrectionSearch(tests).run()
    return [_beside_others(tests, chosen, i) for i in sorted(chosen)]


def _beside_others(tests: ScoreTests, chosen: IndexSet, index: int) -> AcceptedError:
    """Score a chosen candidate and its alternatives beside the other chosen ones."""
    step = tests.step(chosen - {index})
    scores = tests.scores_beside(step)
    minimum = MIN_ALTERNATIVE_GAIN_RATIO * scores[index].gain
    return AcceptedError(
        index, step, {i: score for i, score in scores.items() if score.gain >= minimum}
    )


@dataclass(frozen=True)
class _CorrectionSearch:
    """A search over sets of candidates; the gains beside each set are computed once."""

    tests: ScoreTests
    gains: dict[IndexSet, Gains] = field(default_factory=dict)
    likelihoods: dict[IndexSet, float] = field(default_factory=dict)

    def run(self) -> IndexSet:
        """Return the set that no addition, removal or single replacement improves."""
        chosen = self._grow_and_prune(frozenset())
        while (better := self._better_set(chosen)) is not None:
            chosen = better
        return chosen

    def _better_set(self, chosen: IndexSet) -> IndexSet | None:
        """Return a likelier set after one change and growing again, or None."""
        replacements = [
            chosen - {i} | {self._best(gains)}
            for i in sorted(chosen)
            if (gains := self._gains_beside(chosen - {i}))
        ]
        for start in (chosen, *replacements):
            trial = self._grow_and_prune(start)
            if self._likelihood(trial) > self._likelihood(chosen) + MIN_LIKELIHOOD_RISE:
                return trial
        return None

    def _grow_and_prune(self, chosen: IndexSet) -> IndexSet:
        """Add the best one by one; then remove one by one what is superfluous beside the others."""
        while len(chosen) < MAX_SUSPECTED_ERRORS and (gains := self._gains_beside(chosen)):
            chosen |= {self._best(gains)}
        while superfluous := [i for i in chosen if i not in self._gains_beside(chosen - {i})]:
            chosen -= {max(superfluous, key=lambda i: (self._likelihood(chosen - {i}), i))}
        return chosen

    def _gains_beside(self, chosen: IndexSet) -> Gains:
        """Return the gains of the candidates that explain more than chance beside the chosen."""
        if chosen not in self.gains:
            step = self.tests.step(chosen)
            scores = self.tests.scores_beside(step)
            self.gains[chosen] = {i: score.gain for i, score in scores.items()}
            self.likelihoods[chosen] = step.log_likelihood
        return self.gains[chosen]

    def _likelihood(self, chosen: IndexSet) -> float:
        """Return the log likelihood with the chosen free, less what each must at least gain."""
        self._gains_beside(chosen)
        required = [
            min_gain(P_CONSIDER, len(self.tests.candidates[i].columns)) + self._required_lead(i)
            for i in chosen
        ]
        return self.likelihoods[chosen] - float(sum(required))

    def _required_lead(self, index: int) -> float:
        """Return by how much a candidate must explain more than another one to be preferred."""
        return max(self.tests.candidates[index].correction.min_lead, 0.0) * LEAD_SHARE

    def _best(self, gains: Gains) -> int:
        """Return the candidate that explains the most for its number of parameters.

        A target or sensor that moved within a session is preferred only if no permanent error
        explains at least half as much.
        """
        minimum = MIN_ALTERNATIVE_GAIN_RATIO * max(gains.values())
        permanent = [
            i
            for i, gain in gains.items()
            if self.tests.candidates[i].correction.name not in SESSION_SHIFT_NAMES
            and gain >= minimum
        ]
        return max(
            permanent or gains,
            key=lambda i: (
                gains[i]
                - MIN_GAIN_PER_PARAMETER * len(self.tests.candidates[i].columns)
                - self._required_lead(i)
            ),
        )
