"""What tests share: small runs of the pipeline, synthetic setups, recordings in every container and
by every driver, the inputs of a report, a browser, and the catalog of faults."""
