"""Recordings of any container: open_log chooses by suffix between MCAP, rosbag2 (SQLite) and ROS 1
bags; messages are decoded on demand."""
