"""Geometry without files: rigid motions (se3), frames connected by transforms (frame_graph),
polygons, ICP, the angular reach of an uncertain pose (pose_margin), elementwise branches for NumPy or
CasADi, and factors between units (units)."""
