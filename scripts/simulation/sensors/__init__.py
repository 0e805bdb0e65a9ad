"""What simulated sensors measure.

scan_patterns    where a lidar's beams point, and when
lidar_scanner    ranges of a scan, with noise and beam divergence
cloud_formats    points as lidar drivers lay them out
image_renderer   exact images of the scene
camera_exposure  from exact images to those of a camera
mocap_errors     poses that the motion capture reports
"""
