"""Inputs of the report: run_loader reads the files, run_data holds them."""
