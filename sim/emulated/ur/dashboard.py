"""The dashboard server: one line in, one line out.

Universal Robots, "Dashboard Server e-Series, port 29999".
"""

from __future__ import annotations

from typing import Any

GREETING = "Connected: Universal Robots Dashboard Server"
ROBOT_MODES = {3: "POWER_OFF", 5: "IDLE", 7: "RUNNING"}
SAFETY = {1: "NORMAL", 2: "REDUCED", 3: "PROTECTIVE_STOP", 7: "ROBOT_EMERGENCY_STOP"}
PROGRAM = {1: "STOPPED", 2: "PLAYING", 4: "PAUSED"}


def respond(robot: Any, line: str) -> str:
    """The answer to one command."""
    command = line.strip()
    reports_identity = robot.version >= ((3, 12, 0) if robot.version[0] == 3 else (5, 6, 0))
    match command.lower():
        case "polyscopeversion":
            return f"URSoftware {robot.version[0]}.{robot.version[1]}.{robot.version[2]}.{robot.build} (emulated)"
        case "robotmode":
            return f"Robotmode: {ROBOT_MODES[robot.robot_mode]}"
        case "safetystatus":
            return f"Safetystatus: {SAFETY[robot.safety_mode]}"
        case "safetymode":
            return f"Safetymode: {SAFETY[robot.safety_mode]}"
        case "programstate":
            return f"{PROGRAM[robot.runtime_state]} {robot.program_name or '<unnamed>'}"
        case "running":
            return f"Program running: {str(robot.program_running).lower()}"
        case "is in remote control" if robot.version >= (5, 6, 0):
            return str(robot.remote).lower()
        case "get serial number" if reports_identity:
            return str(robot.serial)
        case "get robot model" if reports_identity:
            return str(robot.model)
        case "get operational mode" if robot.version >= (5, 6, 0):
            return str(robot.operational_mode)
        case "get loaded program":
            return f"Loaded program: {robot.program_name}" if robot.program_name else "No program loaded"
        case "stop":
            robot.stop_program()
            return "Stopped"
        case "play":
            return "Failed to execute: play"
        case "pause":
            return "Failed to execute: pause"
        case "unlock protective stop":
            return "Protective stop releasing" if robot.unlock() else "Cannot unlock protective stop until 5s after occurrence"
        case "close safety popup" | "close popup":
            return command
        case "quit":
            return "Disconnected"
    return f'could not understand: "{command}"'
