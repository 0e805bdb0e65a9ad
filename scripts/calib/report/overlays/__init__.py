"""Overlays: targets drawn over images and scans, by the initial guess and by the result."""
