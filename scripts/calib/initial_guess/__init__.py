"""Stage guess: the first pose and time offset of each sensor, with its uncertainty.

initial_guess           a guess with its σ, or the reason why there is none
sensor_guess            decides the guess of one sensor: stated, or else searched
stated_pose             poses that the rig config, an earlier calibration or /tf_static state
previous_calibration    reads the file of `guess_from`
session_search          searches in the log: time offset, poses, mounts
clock_lag               time offset: what a sensor sees changes while something moves
pose_voting             the pose that most placements agree on
camera_from_patterns    camera pose from printed patterns (bearing_pnp)
camera_from_blobs       camera pose from coloured bodies
lidar_matching          lidar pose from things like the targets (lidar_candidates,
                        candidate_matches)
hand_eye                mount of a target in its MCS body
"""
