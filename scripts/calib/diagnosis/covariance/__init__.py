"""Covariances: of errors that are not estimated (consider_covariance), and of errors that whole
placements have in common and no noise model contains (cluster_covariance), and of the choice of
corrections (choice_covariance)."""
