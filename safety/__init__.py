"""The only way to move: limits, collision, ruckig motions, clearance, monitor, guard."""
