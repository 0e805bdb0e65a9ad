"""Stage decode: one pass through a log.

decoded_log    reads the poses of motion capture and one row per sensor message
sensor_probe   what the first messages of a sensor show of its driver
sensor_audit   block of a sensor in log.json
stream_clocks  whether header stamps or log times are used
clock_steps    steps of a clock within a log
body_tracks    poses of every body in the map, and its block in log.json
"""
