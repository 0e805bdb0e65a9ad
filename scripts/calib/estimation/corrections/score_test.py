"""Score tests at an optimum: what further values θ, all zero there, would explain (Rao 1948).

A test takes one Gauss-Newton step in θ while all unknowns x follow. A wrong model widens the noise
that is estimated from the residuals, and with it whatever hides the error. So every noise shrinks
to what is left after the step, and the step is taken again. The gain is that in log likelihood with
each noise at its own best, ½ Σ n log(squares before / after), as in an F test. Residuals of a
placement may have a common error that no noise model contains: the gain is divided by the scatter
of the scores of whole placements over what their information gives (White 1982).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse, stats
from scipy.sparse.linalg import splu

from calib.estimation.nlp.information_matrix import MIN_EIGENVALUE_RATIO

N_NOISE_RESCALINGS = 4  # times that the noise shrinks and the step is taken again
MIN_INFORMATION_RATIO = 1e-11  # of a value's own information: directions with less are not tested
MIN_PRIOR_FACTOR = 1e-4  # on the stated variance of unknowns with priors
STATED_SIGMA_LEVEL = 0.99  # of the test that a stated σ is too large
MIN_PARAMETER_INFORMATION = 1.0  # of a value that is tested: σ of 1 m, rad, px or 100 %


@dataclass(frozen=True)
class ScoreBlock:
    """Terms of the cost over the unknowns x in columns (m,) and the values θ at (q,).

    cluster: number of the set of terms with a common error; H (m, m), G (m, q), K (q, q): second
    derivatives by x, by both, by θ; gradient (m,), score (q,): first derivatives;
    squared_residuals: weighted sum; n_terms: how many.
    """

    cluster: int
    columns: np.ndarray
    correction_index: np.ndarray
    H: np.ndarray
    G: np.ndarray
    K: np.ndarray
    gradient: np.ndarray
    score: np.ndarray
    squared_residuals: float
    n_terms: float

    def directional_derivative(
        self, x: np.ndarray, theta: np.ndarray, along_x: np.ndarray, along_theta: np.ndarray
    ) -> float:
        """Return the derivative of half the squares at a step (x, θ) along another step."""
        x, theta = x[self.columns], theta[self.correction_index]
        by_x = self.gradient + self.H @ x + self.G @ theta
        by_theta = self.score + self.G.T @ x + self.K @ theta
        return by_x @ along_x[self.columns] + by_theta @ along_theta[self.correction_index]


class NoiseTerm:
    """The blocks that share one noise, summed over n unknowns x and p values θ.

    min_variance_factor: the smallest factor that the variance of the noise may take.
    """

    def __init__(
        self, blocks: Sequence[ScoreBlock], n: int, p: int, min_variance_factor: float
    ) -> None:
        self.blocks, self.min_variance_factor = blocks, min_variance_factor
        self.G, self.K = np.zeros((n, p)), np.zeros((p, p))
        self.gradient, self.score = np.zeros(n), np.zeros(p)
        for b in blocks:
            self.G[np.ix_(b.columns, b.correction_index)] += b.G
            self.K[np.ix_(b.correction_index, b.correction_index)] += b.K
            np.add.at(self.gradient, b.columns, b.gradient)
            self.score[b.correction_index] += b.score
        rows = np.concatenate([np.repeat(b.columns, len(b.columns)) for b in blocks])
        columns = np.concatenate([np.tile(b.columns, len(b.columns)) for b in blocks])
        values = np.concatenate([b.H.ravel() for b in blocks])
        self.H = sparse.coo_matrix((values, (rows, columns)), (n, n)).tocsc()
        self.squared_residuals = sum(b.squared_residuals for b in blocks)
        self.n_terms = sum(b.n_terms for b in blocks)

    def squares_after(self, x: np.ndarray, theta: np.ndarray) -> float:
        """Return the sum of squares after a step."""
        linear = self.gradient @ x + self.score @ theta
        square = x @ (self.H @ x) + 2 * x @ (self.G @ theta) + theta @ self.K @ theta
        return max(self.squared_residuals + 2 * linear + square, 0.0)

    def variance_factor(self, squares: float, previous: float) -> float:
        """Return the factor on the variance that suits a sum of squares; 1 without terms.

        previous: the factor with which these squares were found.
        """
        return max(self.min_variance_factor, squares / self.n_terms) if self.n_terms else 1.0

    def cost(self, factor: float, squares: float) -> float:
        """Return -2 times the log likelihood with a factor on the variance, but for a constant."""
        return self.n_terms * float(np.log(factor)) + squares / factor


class PriorNoiseTerm(NoiseTerm):
    """The terms of unknowns with priors of one σ, which was stated and may be too large.

    information: (k,) what the data tell about them, in units of their priors, along independent
    directions. stated_factor: the factor on the variance that gives the stated σ. A factor is found
    by the evidence (MacKay 1992); it is below the stated one only if the stated σ cannot be true.
    """

    def __init__(
        self,
        blocks: Sequence[ScoreBlock],
        n: int,
        p: int,
        *,
        information: np.ndarray,
        stated_factor: float,
    ) -> None:
        super().__init__(blocks, n, p, min_variance_factor=MIN_PRIOR_FACTOR * stated_factor)
        self.information, self.stated_factor = information, stated_factor

    def variance_factor(self, squares: float, previous: float) -> float:
        known = previous * self.information
        n_determined = float(np.sum(known / (1 + known)))
        if not n_determined:
            return previous
        # It is 0 where the data tell next to nothing: then the stated σ stands.
        quantile = float(stats.chi2.ppf(1 - STATED_SIGMA_LEVEL, n_determined))
        least = squares / quantile if quantile > 0 else np.inf
        lower = min(self.stated_factor, max(self.min_variance_factor, least))
        return max(lower, squares / n_determined)

    def cost(self, factor: float, squares: float) -> float:
        return float(np.sum(np.log1p(factor * self.information))) + squares / factor


class ScoreSystem:
    """The normal equations of x and θ with a factor on every noise's variance, x eliminated."""

    def __init__(self, terms: Mapping[str, NoiseTerm], factors: Mapping[str, float]) -> None:
        H, self.G, self.K, self.gradient, score = (
            sum(getattr(t, name) / factors[k] for k, t in terms.items())
            for name in ("H", "G", "K", "gradient", "score")
        )
        diagonal = H.diagonal()
        self._scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        unit = sparse.diags(self._scale) @ H @ sparse.diags(self._scale)
        self._lu = splu((unit + MIN_EIGENVALUE_RATIO * sparse.eye(len(self._scale))).tocsc())
        self.reduced_score = score - self.G.T @ self.solve_unknowns(self.gradient)
        self.reduced_information = self.K - self.G.T @ self.solve_unknowns(self.G)
        known = np.diag(self.K) > MIN_PARAMETER_INFORMATION
        self.parameter_scale = np.where(
            known, 1 / np.sqrt(np.where(known, np.diag(self.K), 1.0)), 0.0
        )

    def solve_unknowns(self, b: np.ndarray) -> np.ndarray:
        """Return H⁻¹ b of b (n,) or (n, k)."""
        return (self._scale * self._lu.solve((self._scale * b.T).T).T).T

    def covariance_root(self, free: np.ndarray) -> np.ndarray:
        """Return R (f, r) with R Rᵀ the covariance of the free values, by index (f,).

        Undetermined directions are held.
        """
        unit = self.parameter_scale[free]
        block = unit[:, None] * self.reduced_information[np.ix_(free, free)] * unit
        values, vectors = np.linalg.eigh(block)
        known = values > MIN_INFORMATION_RATIO
        return unit[:, None] * vectors[:, known] / np.sqrt(values[known])

    def cost_drop(self, free: np.ndarray) -> float:
        """Return the drop of the cost by a step in the free values."""
        return float(np.sum((self.covariance_root(free).T @ self.reduced_score[free]) ** 2)) / 2

    def newton_step(self, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the step (x (n,), θ (p,)) to the minimum over x and the free values."""
        theta, root = np.zeros(len(self.reduced_score)), self.covariance_root(free)
        theta[free] = -root @ (root.T @ self.reduced_score[free])
        return -self.solve_unknowns(self.gradient + self.G @ theta), theta

    def covariance(self, free: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariances of the free values (f, f) and of the unknowns x in rows (r,)."""
        root = self.covariance_root(free)
        units = np.zeros((len(self.gradient), len(rows)))
        units[rows, np.arange(len(rows))] = 1
        moved = self.solve_unknowns(self.G[:, free] @ root)[rows]
        return root @ root.T, self.solve_unknowns(units)[rows] + moved @ moved.T


@dataclass(frozen=True)
class ScoreStep:
    """A step (x (n,), θ (p,)) in the unknowns and the free values.

    squares_after, variance_factors: of every noise; log_likelihood: after the step.
    """

    free_index: np.ndarray
    x: np.ndarray
    correction_values: np.ndarray
    squares_after: dict[str, float]
    variance_factors: dict[str, float]
    log_likelihood: float
    system: ScoreSystem = field(repr=False)


def fit_score_step(terms: Mapping[str, NoiseTerm], free: np.ndarray) -> ScoreStep:
    """Return the step with some values free, by index (f,), and every noise at its best."""
    factors = {k: t.variance_factor(t.squared_residuals, 1.0) for k, t in terms.items()}
    for _ in range(N_NOISE_RESCALINGS):
        system = ScoreSystem(terms, factors)
        x, theta = system.newton_step(free)
        squares = {k: t.squares_after(x, theta) for k, t in terms.items()}
        factors = {k: t.variance_factor(squares[k], factors[k]) for k, t in terms.items()}
    cost = sum(t.cost(factors[k], squares[k]) for k, t in terms.items())
    return ScoreStep(
        free_index=free,
        x=x,
        correction_values=theta,
        squares_after=squares,
        variance_factors=factors,
        log_likelihood=-float(cost) / 2,
        system=system,
    )


def cluster_scatter(
    terms: Mapping[str, NoiseTerm], step: ScoreStep, tested_index: np.ndarray
) -> float:
    """Return the variance of the scores of whole clusters over what their information gives.

    Along the part of the step that is due to the tested values; at least 1.
    """
    others = step.free_index[~np.isin(step.free_index, tested_index)]
    x, theta = step.system.newton_step(others)
    by_x, by_theta = step.x - x, step.correction_values - theta
    sums: dict[int, float] = {}
    expected = 0.0
    for name, t in terms.items():
        factor = step.variance_factors[name]
        for b in t.blocks:
            slope = b.directional_derivative(step.x, step.correction_values, by_x, by_theta)
            sums[b.cluster] = sums.get(b.cluster, 0.0) + slope / factor
        rise = by_x @ (t.H @ by_x) + 2 * by_x @ (t.G @ by_theta) + by_theta @ t.K @ by_theta
        expected += rise / factor
    return max(1.0, float(np.sum(np.square(list(sums.values()))) / max(expected, 1e-300)))


def likelihood_gain(value: float, sigma: float) -> float:
    """Return the gain in log likelihood of one value that differs from zero, with its σ."""
    return (value / sigma) ** 2 / 2


def gain_p_value(gain: float, size: int) -> float:
    """Return the probability of at least that gain in log likelihood by `size` values by chance."""
    return float(stats.chi2.sf(2 * max(gain, 0.0), size))


def min_gain(p_value: float, size: int) -> float:
    """Return the gain in log likelihood by `size` values that has this p-value."""
    return float(stats.chi2.isf(p_value, size)) / 2
