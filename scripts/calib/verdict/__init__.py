"""Stage judge: findings against the limits of config.yaml (block judge; defaults in
workflow/schemas/config.schema.yaml). Preflight findings come before a calibration: preflight_guess
(what guess can find), preflight_targets (what crop and extract use of a target),
preflight_visibility (what a sensor may see), preflight_findings and preflight_json."""
