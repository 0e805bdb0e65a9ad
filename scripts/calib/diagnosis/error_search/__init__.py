"""The search for errors of the model: a test of each candidate, and the set that explains most.

score_terms: residuals with derivatives; candidate_scores: tests; correction_search: the set.
"""
