"""URDF files of robots.

urdf_file      the joints of a file, and their poses changed in place
sensor_joints  where joints must be for the sensors to sit as calibrated
patch_urdf     writes these poses into the user's file, with a backup
"""
