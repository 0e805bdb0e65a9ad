"""Export formats, one module each; format_registry lists them and says what a format must have."""
