"""Motion capture.

messages           readers of the messages of every driver
pose_streams       streams of poses by topic and frame
position_unit      metres or millimetres, by the distances between bodies
pose_conventions   quaternion order and up axis
pose_faults        faults of single poses: zeros, jumps, frozen poses, late stamps
swapped_bodies     names that were swapped for a while
body_poses_in_map  poses composed along a chain of frames
body_trajectory    trajectories, interpolated between samples
rest_noise         white and slow noise of the poses of bodies at rest
stillness          still intervals, and how much their poses tell
stillness_losses   why a body is never still: time lost to gaps, rate and speed
moving_pose_fit    pose and velocity of a moving target at a time
placements         still intervals of a target and those between, with mean poses
"""
