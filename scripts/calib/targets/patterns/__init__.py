"""Printed patterns: pattern_registry lists them; checkerboard and charuco find their corners, the
other files refine corners to a fraction of a pixel."""
