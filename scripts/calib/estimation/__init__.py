"""Stages associate and solve: from keypoints to poses of all sensors.

problem_assembly       the one place that builds the problem (estimation_problem.Setup) of keypoints
measurement_groups     placements at rest and groups of keypoints, from their tables
moving_view_poses      the same for targets in motion
solver                 the loop: solve, assign, estimate the noise, until nothing changes
round_solution         one round: linearize, solve the joint problem (nlp/), step
measurement_assignment which measurement belongs to which feature (residuals/)
noise/                 noise of measurements and motion capture, from the residuals
estimate_state         the current estimate; pose_chain gives poses from it
estimation_result      what comes out
corrections/           what can be estimated beside the poses
"""
