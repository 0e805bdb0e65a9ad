"""Errors of a camera's lens.

camera_intrinsics  focal length, principal point; all parameters, estimated on request
lens_distortion    distortion that the stated lens lacks
"""
