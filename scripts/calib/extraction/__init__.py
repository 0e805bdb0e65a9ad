"""Stage extract: keypoints of one sensor, from the initial guess to the working pose.

extractor_registry    extractors by kind of sensor
extraction_inputs     sensor, targets, placements and options; columns of keypoints
extraction_results    keypoints and outcomes of views
camera_keypoints      corners of patterns, contours of colours
lidar_keypoints       returns on surfaces, crossings of outlines, the paper's keypoints
working_pose          the pose that all views of the sensor agree on
moving_keypoints      keypoints of moving targets at that pose
mistakes              mistakes of convention in the config, tried where nothing agrees
"""
