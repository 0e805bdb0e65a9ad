"""The page docs/benchmark.md and its chart."""
