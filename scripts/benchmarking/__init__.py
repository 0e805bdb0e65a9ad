"""Developer tool: measures accuracy, cost and robustness; writes docs/benchmark.md and faults.md.

accuracy      errors with known truth, and coverage of the covariance
decode_cost   CPU time and memory of decode, and of mcap's own reader
fault_matrix  faults × causes named, errors, and what the advice comes to
fuzzing       random damaged logs and configs
lab_faults    late clocks, moved targets, wrong lenses, biased beams
page          docs/benchmark.md and its chart
pipeline_runs simulated logs and runs of the pipeline, for several of these
room_rigs     rigs with the noise of real rooms, for several of these
split_halves  whether σ is true: halves of recordings, known errors
"""
