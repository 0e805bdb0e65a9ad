"""Score tests at an optimum: what further numbers θ, all zero there, would explain (Rao 1948).

One Gauss-Newton step in θ while all unknowns x follow. A wrong model widens the noise that is
estimated from the residuals, and with it whatever hides the error; so every noise shrinks to what
is left after the step, and the step is taken again. The gain is that in log likelihood with each
noise at its own best, ½ Σ n log(squares before / after), as in an F test. Residuals of a placement
may err together in ways that no noise model knows: the gain is divided by what the scores of whole
placements scatter beyond what their information gives (White 1982).
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse, stats
from scipy.sparse.linalg import splu

from calib.estimation.nlp.information_matrix import MIN_EIGENVALUE_RATIO

N_NOISE_RESCALINGS = 4  # times that the noise shrinks and the step is taken again
MIN_INFORMATION_RATIO = (
    1e-11  # of a number's own information: directions with less left are not looked at
)
MIN_PARAMETER_INFORMATION = (
    1.0  # least information of a number that is looked at: σ of 1 m, rad, px or 100 %
)


@dataclass(frozen=True)
class ScoreBlock:
    """Terms over unknowns x in columns (m,) and numbers θ at (q,): H (m, m), G (m, q), K (q, q),
    gradient (m,), score (q,), weighted sum of squares and how many terms; cluster: its number
    among those whose errors are independent of each other's."""

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

    def directional_derivative(self, x, theta, along_x, along_theta):
        """Derivative of half its squares at a step (x, θ) along another."""
        x, theta = x[self.columns], theta[self.correction_index]
        by_x = self.gradient + self.H @ x + self.G @ theta
        by_theta = self.score + self.G.T @ x + self.K @ theta
        return by_x @ along_x[self.columns] + by_theta @ along_theta[self.correction_index]


class NoiseTerm:
    """The Blocks that share one noise, summed over n unknowns x and p numbers θ.

    least: the smallest factor that its variance may take.
    """

    def __init__(self, blocks, n, p, least):
        self.blocks, self.min_variance_factor = blocks, least
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

    def squares_after(self, x, theta):
        """The sum of squares after a step."""
        linear = self.gradient @ x + self.score @ theta
        square = x @ (self.H @ x) + 2 * x @ (self.G @ theta) + theta @ self.K @ theta
        return max(self.squared_residuals + 2 * linear + square, 0.0)

    def variance_factor(self, after):
        """On the variance, to suit a sum of squares; a noise without terms to tell it keeps its."""
        return max(self.min_variance_factor, after / self.n_terms) if self.n_terms else 1.0


class ScoreSystem:
    """The normal equations of x and θ with a factor on every noise's variance, x eliminated."""

    def __init__(self, terms, factor):
        H, self.G, self.K, self.gradient, score = (
            sum(getattr(t, name) / factor[k] for k, t in terms.items())
            for name in ("H", "G", "K", "gradient", "score")
        )
        told = H.diagonal()
        scale = 1 / np.sqrt(np.where(told > 0, told, 1.0))
        unit = sparse.diags(scale) @ H @ sparse.diags(scale)
        lu = splu((unit + MIN_EIGENVALUE_RATIO * sparse.eye(len(scale))).tocsc())
        self.solve_unknowns = lambda b: (scale * lu.solve((scale * b.T).T).T).T
        self.reduced_score = score - self.G.T @ self.solve_unknowns(self.gradient)
        self.reduced_information = self.K - self.G.T @ self.solve_unknowns(self.G)
        known = np.diag(self.K) > MIN_PARAMETER_INFORMATION
        self.parameter_scale = np.where(
            known, 1 / np.sqrt(np.where(known, np.diag(self.K), 1.0)), 0.0
        )

    def covariance_root(self, free):
        """(f, r), R with R Rᵀ the covariance of the free numbers; what nothing tells is held."""
        unit = self.parameter_scale[free]
        block = unit[:, None] * self.reduced_information[np.ix_(free, free)] * unit
        values, vectors = np.linalg.eigh(block)
        known = values > MIN_INFORMATION_RATIO
        return unit[:, None] * vectors[:, known] / np.sqrt(values[known])

    def cost_drop(self, free):
        """Of the cost, by a step in the free numbers."""
        return float(np.sum((self.covariance_root(free).T @ self.reduced_score[free]) ** 2)) / 2

    def newton_step(self, free):
        """(x (n,), θ (p,)) to the minimum over x and the free numbers."""
        theta, root = np.zeros(len(self.reduced_score)), self.covariance_root(free)
        theta[free] = -root @ (root.T @ self.reduced_score[free])
        return -self.solve_unknowns(self.gradient + self.G @ theta), theta

    def covariance(self, free, rows):
        """Of the free numbers (f, f), and of the unknowns x in those rows, all unknowns free."""
        root = self.covariance_root(free)
        units = np.zeros((len(self.gradient), len(rows)))
        units[rows, np.arange(len(rows))] = 1
        moved = self.solve_unknowns(self.G[:, free] @ root)[rows]
        return root @ root.T, self.solve_unknowns(units)[rows] + moved @ moved.T


@dataclass(frozen=True)
class ScoreStep:
    """A step (x (n,), θ (p,)) with the numbers `free`; what is left of every noise's squares, the
    factor on its variance, and the log likelihood."""

    free_index: np.ndarray
    x: np.ndarray
    correction_values: np.ndarray
    squares_after: dict
    variance_factors: dict
    log_likelihood: float
    system: ScoreSystem = field(repr=False)


def fit_score_step(terms, free):
    """The Fit with those numbers free and every noise of terms {name: Noise} at its best."""
    factor = {k: t.variance_factor(t.squared_residuals) for k, t in terms.items()}
    for _ in range(N_NOISE_RESCALINGS):
        system = ScoreSystem(terms, factor)
        x, theta = system.newton_step(free)
        left = {k: t.squares_after(x, theta) for k, t in terms.items()}
        factor = {k: t.variance_factor(left[k]) for k, t in terms.items()}
    cost = sum(t.n_terms * np.log(factor[k]) + left[k] / factor[k] for k, t in terms.items())
    return ScoreStep(free, x, theta, left, factor, -float(cost) / 2, system)


def cluster_scatter(terms, fit, tested_index):
    """Variance of the scores of whole clusters along the step of the numbers `own` over what their
    information gives, at least 1."""
    others = fit.free_index[~np.isin(fit.free_index, tested_index)]
    x, theta = fit.system.newton_step(others)
    by_x, by_theta = fit.x - x, fit.correction_values - theta
    sums, expected = {}, 0.0
    for name, t in terms.items():
        for b in t.blocks:
            slope = (
                b.directional_derivative(fit.x, fit.correction_values, by_x, by_theta)
                / fit.variance_factors[name]
            )
            sums[b.cluster] = sums.get(b.cluster, 0.0) + slope
        rise = by_x @ (t.H @ by_x) + 2 * by_x @ (t.G @ by_theta) + by_theta @ t.K @ by_theta
        expected += rise / fit.variance_factors[name]
    return max(1.0, float(np.sum(np.square(list(sums.values()))) / max(expected, 1e-300)))


def likelihood_gain(value, sigma):
    """In log likelihood, of one number that differs from zero by so many of its σ."""
    return (value / sigma) ** 2 / 2


def gain_p_value(gain, size):
    """Of a gain in log likelihood at least so large by `size` numbers that mean nothing."""
    return float(stats.chi2.sf(2 * max(gain, 0.0), size))
