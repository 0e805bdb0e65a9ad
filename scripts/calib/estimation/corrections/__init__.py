"""Corrections: numbers estimated beside the poses. correction defines them, correction_catalog
lists them, score_test decides which the residuals ask for."""
