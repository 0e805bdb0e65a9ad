"""Runs of true values in a boolean mask."""

import numpy as np


def find_runs(mask: np.ndarray) -> np.ndarray:
    """Return the first and last index (k, 2) of each run of true values in a mask (n,)."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(int))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1])
