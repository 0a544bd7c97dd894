"""How well an arm predicts recordings, by torque and by simulated motion, and what improves on it."""
