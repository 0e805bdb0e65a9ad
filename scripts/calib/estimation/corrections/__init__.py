"""Corrections: values estimated or tested beside the poses.

base                  Correction and its kinds: testable, estimable, of a sensor's model, of a shape
target_errors         sizes of targets, mounts
board_shape           boards that are bowed or twisted
slips_and_bumps       targets that slip, sensors that are bumped
camera                errors of a lens: focal length, principal point, distortion
clock_offset, clock_drift   estimated if observable
lidar                 errors of a lidar: ranges, outlines
mocap                 errors of the motion capture: its scale, the robot's markers
correction_catalog    lists what score tests look for
group_linearization   derivatives of a group's residuals
correction_estimate   estimated values with their σ
score_test            how much a correction would explain (Rao 1948)
number_wording        values with σ in descriptions
"""
