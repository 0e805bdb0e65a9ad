"""Export formats: format_registry lists them, one file per format."""
