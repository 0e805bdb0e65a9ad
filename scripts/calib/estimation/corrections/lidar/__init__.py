"""Errors of a lidar.

lidar_range_errors     ranges of all beams and of single beams
dark_ranges            ranges of the dark squares of a pattern
intensity_ranges       ranges that depend on the intensity of returns
lidar_outline_errors   outlines seen too wide or from another place
"""
