"""Cost of decode against the raw reader."""
