"""Stage judge: findings against the limits of config.yaml (block judge; defaults in
workflow/schemas/config.schema.yaml). Preflight findings come before a calibration."""
