"""Run the pipeline on random damaged and hostile inputs."""
