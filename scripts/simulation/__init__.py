"""Simulated recordings with known truth: rigs, placements, what the sensors and the motion capture
measure, and the log. Used by scripts/simulate.py and the benchmark."""
