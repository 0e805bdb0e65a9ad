"""Calibrate with common faults of labs, with the options that correct them on and off."""
