"""Geometry without files: rigid motions (se3), frames connected by transforms (frame_graph),
polygons, ICP, how far an uncertain pose reaches (pose_margin), and `where` for NumPy or CasADi."""
