"""Motion capture: messages of every driver (messages/), streams of poses, their conventions and
faults, swapped bodies, poses of bodies in the map, trajectories, stillness, and the local motion of
a target."""
