"""Stages associate and solve: the problem (estimation_problem, problem_assembly,
measurement_groups), the estimate and its pose chain, noise, and the solver's loop; nlp/ holds the
CasADi problem, residuals/ the kinds of measurement, corrections/ what may be estimated beside the
poses."""
