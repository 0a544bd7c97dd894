"""The first cell file for what was found: known values are filled in, and those that only a person knows are marked TODO."""

from __future__ import annotations

import tomli_w

from drivers.finding import Robot
from sim.arm import Arm

HOME = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]  # a free posture of every UR, as in the shipped cells
OBSTACLES = """# TODO list everything that the arm can touch: table, walls, machines. Positions in m from the base. See docs/first-day-ur.md.
[[obstacles]]
kind = "plane"
name = "table"
position = [0.0, 0.0, {height}]
normal = [0.0, 0.0, 1.0]
"""
# servoj lags by about 35 ms at the driver's settings (drivers/ur_rtde/options.py), and a motion reaches about 0.7 rad/s
FOLLOWING = """[motion]
following_error = 0.025

"""
# the capsule begins its radius in front of the flange; its ends are the centres of its round caps
PAYLOAD = """# TODO declare the tool as it is set on the pendant, and its shape, or leave both out where the flange is bare. Without a shape
# no motion with a payload is planned. See docs/safety.md.
# [payload]
# mass = 0.0
# com = [0.0, 0.0, 0.0]
#
# [[tool]]
# kind = "capsule"
# name = "gripper"
# ends = [[0.0, 0.0, 0.05], [0.0, 0.0, 0.15]]
# radius = 0.05

"""


def of_robot(name: str, robot: Robot, arm: str) -> str:
    """The cell of a UR that answered, pinned to its serial number if it reported one."""
    options = {"host": robot.host} | ({"serial": robot.serial} if robot.serial else {})
    text = f"# Written by `calib init`: {robot.model or 'a robot'} with PolyScope {robot.polyscope} answered at {robot.host}.\n"
    text += tomli_w.dumps({"schema": "cell/1", "name": name, "arm": arm, "driver": "ur_rtde"})
    text += f"home = {HOME}\n\n[options]\n{tomli_w.dumps(options)}\n"
    return text + FOLLOWING + PAYLOAD + OBSTACLES.format(height=-0.05)


def of_mock(name: str, arm: Arm, height: float) -> str:
    """A cell with a simulated arm and a plane at `height` m as its obstacle."""
    text = "# Written by `calib init`: a simulated arm, to try everything without hardware.\n"
    text += tomli_w.dumps({"schema": "cell/1", "name": name, "arm": arm.name, "driver": "mock"})
    return text + "\n" + OBSTACLES.format(height=height)
