"""Stage export: the calibrated rig in the user's parent frame (calibrated_scene), written in many
formats (formats/), joints of a URDF, and the history of accepted calibrations."""
