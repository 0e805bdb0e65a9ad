"""Four simulated rigs with the noise of real rooms: clean recordings, as arguments of simulate.py.

Motion capture scatters as a Qualisys room's does with a robot at rest for 30 s: means over 1 s by
0.145 mm and 0.019, 0.070 and 0.020 degrees, mostly slowly. Corners of real images scatter by 0.3
to 0.5 px, which no noise of the simulator's images makes: CORNER_SIGMA_PX, for drawn keypoints.
"""

CORNER_SIGMA_PX = 0.3
ROOM_NOISE = (
    "--range-noise-m 0.01 --image-noise 1.8 --blur-px 0.7 "
    "--mcs-noise-m 0.00015 --mcs-noise-deg 0.02 "
    "--mcs-wander-m 0.00015 --mcs-wander-deg 0.02 0.07 0.02 --mcs-wander-s 3"
)
ROOM_RIGS = {  # title: arguments of simulate.py
    "lidar and camera": f"--rig sim --placements 10 {ROOM_NOISE}",
    "lidar alone, targets all round": f"--rig round --placements 12 {ROOM_NOISE}",
    "two lidars, two cameras, two sessions": f"--rig demo --placements 12 {ROOM_NOISE}",
    "lidar of 32 beams, fisheye camera": (
        f"--rig sim --placements 12 --seed 2 --lidar ouster --camera-model kannala_brandt "
        f"{ROOM_NOISE}"
    ),
}
