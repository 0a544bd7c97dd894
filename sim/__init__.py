"""Model and simulation of the arm: trajectory, joint state, rigid bodies, plant, effects, emulated hardware."""
