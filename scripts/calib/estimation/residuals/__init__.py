"""Residuals: residual_registry lists the kinds of measurement; one file per kind; assignment and
robust_loss serve all."""
