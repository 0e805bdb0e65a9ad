"""Mistakes of convention in the config, tried where extract finds nothing or what is absurd.

mistake_registry    the mistakes, in the order in which equal ones are named
mistake_search      tries them against what the sensor saw, and names the one that works
stated_setup        what the config states, and a correction of it
sightings           the pose that a sensor's own detections agree on, under any stated setup
lost_agreement      when the mistakes are tried
pose_corrections    a change of T_robot_sensor or T_body_target, in words
inverted_pose, swapped_axes, lost_signs, quaternion_order, pattern_layout, pattern_size,
mirrored_picture, lens_resolution: one mistake each
"""
