"""Logs of all containers; messages are decoded on demand.

open_log         registry: opens a log by the suffix of its files
mcap_log         MCAP files, with mcap_index
rosbags_reader   common part of rosbag1 and rosbag2_sqlite
log_message      a message of a log
message_types    type definitions and decoders, with struct_arrays for long lists
message_headers  stamp and frame of a message
bounded          bounds of what a log may ask for in memory and time
"""
