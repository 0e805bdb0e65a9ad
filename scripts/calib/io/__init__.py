"""Files in and out.

status          status of what failed, and the errors that end a job
stage_cli       command line, logging and JSON files of all stages
config          config files, checked against their schemas and completed
safe_names      names that logs and folders bring, in letters that ROS allows
safe_yaml       bounded YAML loader
session_parts   sessions that remounted_at_s cuts in two
yaml_scalars    numbers and names that YAML 1.1 reads otherwise than people write them
config_change   changes of the config that findings advise, as data
pose_block      poses in config files and calibration.json
parquet_tables  tables as columns of arrays, with a status
table_schemas   columns of every table
atomic_files    files that are complete or absent
urdf            joints of a URDF
logs            logs of all containers
"""
