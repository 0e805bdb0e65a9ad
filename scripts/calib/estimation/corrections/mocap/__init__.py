"""Errors of the motion capture.

robot_markers     the robot's markers, re-attached before a session
knocked_markers   the robot's markers, knocked within a session
mocap_scale       distances too long or too short
"""
