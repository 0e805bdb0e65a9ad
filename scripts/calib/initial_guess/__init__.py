"""Stage guess: the first pose of a sensor as stated (stated_pose, previous_calibration) or searched
in the data (session_search), mounts of targets (hand_eye) and the coarse time offset (clock_lag).
"""
