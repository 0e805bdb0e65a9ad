"""Lidars: scan pattern and beams (lidar_model), cloud messages (clouds/), the search for a target
in one scan, and where scan lines leave a board's outline."""
