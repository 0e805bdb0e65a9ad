"""Stage crop: which frames of a sensor show a target, and the part of each around it.

target_placements       still placements of targets, their poses, frames in them
field_of_view           whether a target is in view of a sensor at an uncertain pose
pose_selection          the most different poses
placement_selection     placements of a target that a sensor uses
frame_selection         frames of a still target that are read
moving_view_selection   frames of a moving target that are read
initial_guess_frames    one frame per placement, for the searches of guess
crop_windows            part of a scan or image around a target
sensor_croppers         croppers by kind of sensor, reading of frames
view_cutter             rows of views.parquet and moving_views.parquet
view_payloads           reads single views back
"""
