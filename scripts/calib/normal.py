"""The normal equations at the optimum, for what is asked of them afterwards."""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from calib.information import inverse


def mcs_errors(setup, result):
    """Columns (m,) of the MCS errors in the unknowns, and their values (m,) in σ of the priors."""
    return np.arange(setup.poses, setup.chained), result.state.y.reshape(-1)


def determined(information, columns):
    """How many of the unknowns with unit priors the data tell: a sum of shares (MacKay 1992)."""
    return float(np.sum(1 - np.diag(inverse(information))[columns]))


def together(setup, parts, shared):
    """Number (placements,) of the set that a placement belongs to: those that share unknowns.

    parts: parts.Part of every group; shared: columns of the unknowns that tie placements.
    """
    at = [np.intersect1d(part.columns, shared) for part in parts]
    rows = np.repeat([g.placement for g in setup.groups], [len(a) for a in at])
    columns = np.concatenate([*at, np.zeros(0, int)]).astype(int)
    n, m = len(setup.placements), int(max(columns, default=-1)) + 1
    ties = sparse.coo_matrix((np.ones(len(rows)), (rows, n + columns)), (n + m, n + m))
    return connected_components(ties, directed=False)[1][:n]
