"""Accuracy against known truth, and whether the covariance covers the error."""
