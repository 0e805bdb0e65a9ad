"""Geometry without files.

se3              rigid motions, their exponential and covariance
rotation_spread  rotations of poses about their main axes
frame_graph      frames joined by transforms
polygon          distances to a polygon of the plane
ransac_plane     the plane that most points lie on
icp              registration of a template to a scan
pose_margin      angular reach of an uncertain pose
numpy_or_casadi  elementwise branches for NumPy arrays and CasADi expressions
mask_runs        runs of true values in a mask
units            factors between units
"""
