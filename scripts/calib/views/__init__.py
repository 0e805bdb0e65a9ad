"""Stage crop: whether a target is in view (field_of_view), which frames are kept (frame_selection,
moving_view_selection), the part around the target (windows), and reading them (sensor_reader,
view_payloads)."""
