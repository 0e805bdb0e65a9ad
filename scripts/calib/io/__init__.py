"""Files in and out: status of what failed, atomic writes, Parquet tables and their schemas, config
files, pose blocks, YAML, URDF, the command line of a stage, and logs of all containers (logs/)."""
