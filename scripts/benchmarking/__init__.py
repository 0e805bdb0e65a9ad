"""Developer tool: measures accuracy, cost and robustness; writes docs/benchmark.md."""
