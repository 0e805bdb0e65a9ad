"""Stage export: files that robots load, and the history of accepted calibrations.

calibrated_scene         the calibrated sensors in the user's parent frame
scene_from_calibration   builds that scene from calibration.json and the config
formats/                 one module per format, listed in formats/format_registry.py
placement_views          what sensors saw at a placement, for the Foxglove format
export_mcap              MCAP files of the formats
export_readme            README.md of the export folder
accepted_calibrations    history/0001.json, history/0002.json, ...
"""
