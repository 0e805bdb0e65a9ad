"""How good an estimate is: which corrections are needed (correction_selection, suspected_errors),
leave- one-out, observability, next best view (next_view), sessions compared, and the files of stage
solve (solution_json with sensor_json, residual_table)."""
