"""What a UR controller is asked before motion, and what the operator does on the pendant where the answer is no."""

from __future__ import annotations

from drivers.driver import Check
from drivers.ur_rtde.condition import power, safety, slider
from drivers.ur_rtde.dashboard import DashboardFacts
from sim.joint_state import Status

# ur_rtde 1.6.5: register protocol of the lower doubles from 3.4; the dashboard's remote control state from 5.6
OLDEST = {3: (3, 10), 5: (5, 6), 10: (10, 10)}


def readiness(values: dict[str, tuple[float, ...]], said: DashboardFacts, version: tuple[int, ...]) -> list[Check]:
    """Version, remote control, safety, power and slider, as one frame and the dashboard have them; nothing moves or changes."""
    checks = [_version(version, said)]
    if said.remote is not None:
        checks.append(
            Check(
                "remote control", said.remote, "the robot is in remote control" if said.remote else "the robot is in local control",
                "switch the pendant from Local to Remote Control (top right corner; enable it first in Settings > System > Remote "
                "Control)",
            )
        )  # fmt: skip
    for name, answer in (
        ("safety", safety(int(values["safety_status_bits"][0]))),
        ("power", power(int(values["robot_mode"][0]))),
        ("speed slider", slider(values["target_speed_fraction"][0], values["speed_scaling"][0])),
    ):
        status, sentence, remedy = answer
        checks.append(Check(name, status is Status.RUNNING, sentence, remedy))
    return checks


def _version(version: tuple[int, ...], said: DashboardFacts) -> Check:
    oldest = OLDEST.get(version[0])
    text = ".".join(map(str, version[:3]))
    ok = oldest is not None and version[:2] >= oldest
    known = ", ".join(f"{a}.{b}" for a, b in OLDEST.values())
    return Check(
        "PolyScope", ok, f"PolyScope {said.polyscope}, controller {text}",
        f"update PolyScope: the oldest versions that this driver was made for are {known}",
    )  # fmt: skip


def torque(source: str, has_constant: bool) -> Check:
    """Where torque comes from: the controller, or the current and the arm file's torque constant."""
    if source == "actual_current_as_torque":
        return Check("torque", True, "the controller reports joint torque (actual_current_as_torque)")
    return Check(
        "torque", has_constant,
        "the controller reports current only" + ("; the arm file's torque_constant converts it" if has_constant else ""),
        "update PolyScope to 5.23 or newer, or give torque_constant in arm.toml",
    )  # fmt: skip
