"""How well an arm predicts recordings, in torque and in simulated motion, and what improves the prediction."""
