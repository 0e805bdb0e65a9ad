"""The simulated room.

room_scene     walls, targets and stands as exact surfaces
ray_surfaces   where rays meet one shape
ray_casting    where rays meet the scene
smooth_motion  poses of robot and targets over time
"""
