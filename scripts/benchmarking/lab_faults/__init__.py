"""Faults of laboratories, with the options that correct them on and off."""
