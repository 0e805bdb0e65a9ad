"""Stage decode: one pass through a log (decoded_log), what each sensor publishes (sensor_probe,
sensor_audit), which clock counts (stream_clocks) and the poses of every body (body_tracks)."""
