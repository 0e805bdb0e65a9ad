"""Sensors: camera/ and lidar/ with their models and messages; sensor_models makes them from config
blocks, lens_from_log takes the lens from CameraInfo."""
