"""Layout of the joint problem's sparse Hessian.

IPOPT gets the gradient and the sparse Hessian, whose upper triangle is laid out once:

                poses ξ     errors y     θ
              +----------+------------+-------+
     poses ξ  | F . . F  | . F . . F  | C C C |   F  sum of the factors' blocks (24, 24), at their
              |   F . .  | F . . F .  | C C C |      columns: sensor, mount, robot, body
              |     F .  | . . F . .  | C C C |
              +----------+------------+-------+   C  factors' blocks (24, p) between chain and θ
     errors y |          | F . . F .  | C C C |
              |          |   F . . F  | C C C |   T  Hessian (p, p) of all factors by θ
              |          |     F . .  | C C C |
              +----------+------------+-------+   The diagonal also holds the priors' weights.
     θ        |          |            | T T T |
              +----------+------------+-------+

A mount that is not estimated has the column n_chain_unknowns in a factor's layout: it is dropped.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np


class HessianLayout(NamedTuple):
    """Where the parts of gradient and Hessian are summed.

    upper_triangle: sparsity of the Hessian; sum_hessian: constant matrix from all parts, one below
    the other, to its nonzeros; sum_gradient: from the factors' gradients (24, b) to that of the
    chain unknowns.
    """

    upper_triangle: ca.Sparsity
    sum_gradient: ca.DM
    sum_hessian: ca.DM


def layout_hessian(columns: np.ndarray, n_chain_unknowns: int, p: int) -> HessianLayout:
    """Lay out the Hessian for factors with unknowns columns (b, 24) and p values θ.

    Its parts, each column by column as CasADi stores them: the factors' Hessians (24, 24), the
    diagonal, and, if there are θ, the factors' (24, p) and the (p, p) by θ.
    """
    n, theta = n_chain_unknowns + p, n_chain_unknowns + np.arange(p)
    flat = columns.reshape(-1)
    used = np.flatnonzero(flat < n_chain_unknowns)
    sum_gradient = _selection_matrix(flat[used], used, n_chain_unknowns, len(flat))
    known = np.where(columns < n_chain_unknowns, columns, n)  # n: dropped below
    diagonal = np.arange(n)
    rows = [np.tile(known, (1, 24)), diagonal, np.tile(known, (1, p)), np.tile(theta, p)]
    theta_columns = np.tile(np.repeat(theta, 24), len(columns))
    all_columns = [np.repeat(known, 24, axis=1), diagonal, theta_columns, np.repeat(theta, p)]
    row, column = (np.concatenate([np.ravel(v) for v in part]) for part in (rows, all_columns))
    upper = np.flatnonzero((row <= column) & (column < n))
    keys, nonzero = np.unique(column[upper] * n + row[upper], return_inverse=True)
    return HessianLayout(
        upper_triangle=ca.Sparsity.triplet(n, n, (keys % n).tolist(), (keys // n).tolist()),
        sum_gradient=sum_gradient,
        sum_hessian=_selection_matrix(nonzero, upper, len(keys), len(row)),
    )


def _selection_matrix(rows: np.ndarray, columns: np.ndarray, height: int, width: int) -> ca.DM:
    """Return the sparse matrix (height, width) that is 1 at rows (k,) and columns (k,)."""
    pattern = ca.Sparsity.triplet(height, width, rows.tolist(), columns.tolist())
    return ca.DM(pattern, 1.0)
