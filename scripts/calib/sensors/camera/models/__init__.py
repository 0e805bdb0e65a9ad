"""Lens models, one file each: project, unproject and the domain where the model holds."""
