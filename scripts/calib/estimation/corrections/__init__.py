"""Corrections: values estimated or tested beside the poses.

base                  Correction and its four kinds: testable, estimable, of a model, of a clock
target_errors         sizes of targets, mounts
lidar_range_errors    ranges of all beams and of single beams
lidar_outline_errors  outlines seen too wide or from another place
slips_and_bumps       targets that slip, sensors that are bumped
camera_intrinsics     focal length, principal point; all parameters, estimated on request
clock_offset, clock_drift, robot_markers   estimated on request or if observable
correction_catalog    lists what score tests look for
group_linearization   derivatives of a group's residuals
correction_estimate   estimated values with their σ
score_test            how much a correction would explain (Rao 1948)
number_wording        values with σ in descriptions
"""
