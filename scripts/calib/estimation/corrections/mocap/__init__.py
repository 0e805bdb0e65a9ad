"""Errors of the motion capture.

robot_markers   the robot's markers, re-attached before a session
"""
