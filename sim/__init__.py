"""What the arm is and does: arm, trajectory, joint state, rigid body, plant, effects, emulated hardware."""
