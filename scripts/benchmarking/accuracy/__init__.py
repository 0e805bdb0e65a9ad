"""Measure accuracy with known truth, and check that the covariance covers the error."""
