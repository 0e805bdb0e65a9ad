"""How good an estimate is: which corrections are needed (correction_selection, suspected_errors
with error_search), leave-one-out, observability, next best view (next_view), sessions compared
(session_repeatability), halves of the placements compared (split_halves), covariances beyond the
model's (covariance), and the files of stage solve (solution_json with sensor_json,
residual_table)."""
