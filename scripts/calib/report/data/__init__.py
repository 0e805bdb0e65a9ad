"""The inputs of the report: load_run reads the files, run_data holds them."""
