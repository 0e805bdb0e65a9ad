"""Noise of measurements and motion capture.

noise_model         the noise to start from, and the key that names a noise
noise_estimation    the noise after a round, from residuals and leverage
placement_noise     whether the noise differs between placements
repeated_residuals  what corner residuals repeat in all placements: lens or board
correlated_rests    slow noise of motion capture that lasts from one rest to the next
"""
