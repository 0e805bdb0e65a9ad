"""Cameras: camera_model and its lenses (models/), CameraInfo, image messages (images/), the
silhouette of a cylinder and edges to a fraction of a pixel."""
