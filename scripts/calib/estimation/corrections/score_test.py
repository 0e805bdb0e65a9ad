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

from calib.estimation.nlp.information_matrix import ROUNDING

RESCALED = 4  # times that the noise shrinks and the step is taken again
HELD = 1e-11  # of a number's own information: directions with less left are not looked at
TOLD_APART = 1.0  # least information of a number that is looked at: σ of 1 m, rad, px or 100 %


@dataclass(frozen=True)
class Block:
    """Terms over unknowns x in columns (m,) and numbers θ at (q,): H (m, m), G (m, q), K (q, q),
    gradient (m,), score (q,), weighted sum of squares and how many terms; cluster: its number
    among those whose errors are independent of each other's."""

    cluster: int
    columns: np.ndarray
    at: np.ndarray
    H: np.ndarray
    G: np.ndarray
    K: np.ndarray
    gradient: np.ndarray
    score: np.ndarray
    squares: float
    count: float

    def slope(self, x, theta, along_x, along_theta):
        """Derivative of half its squares at a step (x, θ) along another."""
        x, theta = x[self.columns], theta[self.at]
        by_x = self.gradient + self.H @ x + self.G @ theta
        by_theta = self.score + self.G.T @ x + self.K @ theta
        return by_x @ along_x[self.columns] + by_theta @ along_theta[self.at]


class Noise:
    """The Blocks that share one noise, summed over n unknowns x and p numbers θ.

    least: the smallest factor that its variance may take.
    """

    def __init__(self, blocks, n, p, least):
        self.blocks, self.least = blocks, least
        self.G, self.K = np.zeros((n, p)), np.zeros((p, p))
        self.gradient, self.score = np.zeros(n), np.zeros(p)
        for b in blocks:
            self.G[np.ix_(b.columns, b.at)] += b.G
            self.K[np.ix_(b.at, b.at)] += b.K
            np.add.at(self.gradient, b.columns, b.gradient)
            self.score[b.at] += b.score
        rows = np.concatenate([np.repeat(b.columns, len(b.columns)) for b in blocks])
        columns = np.concatenate([np.tile(b.columns, len(b.columns)) for b in blocks])
        values = np.concatenate([b.H.ravel() for b in blocks])
        self.H = sparse.coo_matrix((values, (rows, columns)), (n, n)).tocsc()
        self.squares = sum(b.squares for b in blocks)
        self.count = sum(b.count for b in blocks)

    def after(self, x, theta):
        """The sum of squares after a step."""
        linear = self.gradient @ x + self.score @ theta
        square = x @ (self.H @ x) + 2 * x @ (self.G @ theta) + theta @ self.K @ theta
        return max(self.squares + 2 * linear + square, 0.0)

    def factor(self, after):
        """On the variance, to suit a sum of squares; a noise without terms to tell it keeps its."""
        return max(self.least, after / self.count) if self.count else 1.0


class System:
    """The normal equations of x and θ with a factor on every noise's variance, x eliminated."""

    def __init__(self, terms, factor):
        H, self.G, self.K, self.gradient, score = (
            sum(getattr(t, name) / factor[k] for k, t in terms.items())
            for name in ("H", "G", "K", "gradient", "score")
        )
        told = H.diagonal()
        scale = 1 / np.sqrt(np.where(told > 0, told, 1.0))
        unit = sparse.diags(scale) @ H @ sparse.diags(scale)
        lu = splu((unit + ROUNDING * sparse.eye(len(scale))).tocsc())
        self.solve = lambda b: (scale * lu.solve((scale * b.T).T).T).T
        self.scores = score - self.G.T @ self.solve(self.gradient)
        self.information = self.K - self.G.T @ self.solve(self.G)
        known = np.diag(self.K) > TOLD_APART
        self.unit = np.where(known, 1 / np.sqrt(np.where(known, np.diag(self.K), 1.0)), 0.0)

    def root(self, free):
        """(f, r), R with R Rᵀ the covariance of the free numbers; what nothing tells is held."""
        unit = self.unit[free]
        block = unit[:, None] * self.information[np.ix_(free, free)] * unit
        values, vectors = np.linalg.eigh(block)
        known = values > HELD
        return unit[:, None] * vectors[:, known] / np.sqrt(values[known])

    def drop(self, free):
        """Of the cost, by a step in the free numbers."""
        return float(np.sum((self.root(free).T @ self.scores[free]) ** 2)) / 2

    def step(self, free):
        """(x (n,), θ (p,)) to the minimum over x and the free numbers."""
        theta, root = np.zeros(len(self.scores)), self.root(free)
        theta[free] = -root @ (root.T @ self.scores[free])
        return -self.solve(self.gradient + self.G @ theta), theta

    def covariance(self, free, rows):
        """Of the free numbers (f, f), and of the unknowns x in those rows, all unknowns free."""
        root = self.root(free)
        units = np.zeros((len(self.gradient), len(rows)))
        units[rows, np.arange(len(rows))] = 1
        moved = self.solve(self.G[:, free] @ root)[rows]
        return root @ root.T, self.solve(units)[rows] + moved @ moved.T


@dataclass(frozen=True)
class Fit:
    """A step (x (n,), θ (p,)) with the numbers `free`; what is left of every noise's squares, the
    factor on its variance, and the log likelihood."""

    free: np.ndarray
    x: np.ndarray
    theta: np.ndarray
    left: dict
    factor: dict
    likelihood: float
    system: System = field(repr=False)


def fitted(terms, free):
    """The Fit with those numbers free and every noise of terms {name: Noise} at its best."""
    factor = {k: t.factor(t.squares) for k, t in terms.items()}
    for _ in range(RESCALED):
        system = System(terms, factor)
        x, theta = system.step(free)
        left = {k: t.after(x, theta) for k, t in terms.items()}
        factor = {k: t.factor(left[k]) for k, t in terms.items()}
    cost = sum(t.count * np.log(factor[k]) + left[k] / factor[k] for k, t in terms.items())
    return Fit(free, x, theta, left, factor, -float(cost) / 2, system)


def scatter(terms, fit, own):
    """Variance of the scores of whole clusters along the step of the numbers `own` over what their
    information gives, at least 1."""
    others = fit.free[~np.isin(fit.free, own)]
    x, theta = fit.system.step(others)
    by_x, by_theta = fit.x - x, fit.theta - theta
    sums, expected = {}, 0.0
    for name, t in terms.items():
        for b in t.blocks:
            slope = b.slope(fit.x, fit.theta, by_x, by_theta) / fit.factor[name]
            sums[b.cluster] = sums.get(b.cluster, 0.0) + slope
        rise = by_x @ (t.H @ by_x) + 2 * by_x @ (t.G @ by_theta) + by_theta @ t.K @ by_theta
        expected += rise / fit.factor[name]
    return max(1.0, float(np.sum(np.square(list(sums.values()))) / max(expected, 1e-300)))


def gain(value, sigma):
    """In log likelihood, of one number that differs from zero by so many of its σ."""
    return (value / sigma) ** 2 / 2


def chance(gain, size):
    """Of a gain in log likelihood at least so large by `size` numbers that mean nothing."""
    return float(stats.chi2.sf(2 * max(gain, 0.0), size))
