"""Render docs/benchmark.md and its chart."""
