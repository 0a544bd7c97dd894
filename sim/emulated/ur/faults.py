"""Faults of the robot by name, as an operator, a client or a fieldbus would cause them."""

from __future__ import annotations

from collections.abc import Callable

from sim.emulated.ur.robot import Robot


def robot_faults(robot: Robot) -> dict[str, Callable[[], None]]:
    """Fault -> function that causes it."""
    return {
        "protective_stop": robot.protective_stop,
        "emergency_stop": robot.emergency_stop,
        "reduced_mode": robot.reduce,
        "program_played": lambda: robot.play("palletise.urp"),
        "program_paused": lambda: robot.play("palletise.urp", paused=True),
        "slider_moved": lambda: setattr(robot, "speed_slider", 0.4),
        "program_stopped": robot.stop_program,
        "second_client": lambda: robot.upload("def somebody_else():\n  sync()\nend\n"),
        "local_control": lambda: setattr(robot, "remote", False),
        "fieldbus": lambda: robot.claims.update({f"input_int_register_{i}": "fieldbus" for i in range(24)}),
        "cable_pulled": lambda: setattr(robot, "unplugged", True),
    }
