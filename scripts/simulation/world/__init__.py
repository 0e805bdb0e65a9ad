"""The simulated room: surfaces, targets on stands, smooth motion, ray casting."""
