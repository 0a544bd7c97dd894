"""The checks of a UR controller before motion, and what the operator does on the pendant if one fails."""

from __future__ import annotations

from collections.abc import Collection

from drivers.driver import Check
from drivers.emulated_address import at_emulator
from drivers.ur_rtde.condition import other_program, power, safety, slider
from drivers.ur_rtde.dashboard import ControllerInfo
from drivers.ur_rtde.options import UrOptions
from sim.joint_state import Status

# ur_rtde 1.6.5: register protocol of the lower doubles from 3.4; the dashboard's remote control state from 5.6
OLDEST = {3: (3, 10), 5: (5, 6), 10: (10, 10)}


def readiness(
    values: dict[str, tuple[float, ...]], info: ControllerInfo, version: tuple[int, ...], assumed: Collection[str]
) -> list[Check]:
    """Checks of version, remote control, safety, power, program and slider, as one frame and the controller report them."""
    checks = [_version(version, info)]
    if info.remote is not None:
        checks.append(
            Check(
                "remote control", info.remote, "the robot is in remote control" if info.remote else "the robot is in local control",
                "switch the pendant from Local to Remote Control (top right corner; enable it first in Settings > System > Remote "
                "Control)",
            )
        )  # fmt: skip
    if info.operational_mode:
        checks.append(Check("operational mode", None, f"the operational mode is {info.operational_mode.lower()}"))
    for name, answer in (
        ("safety", safety(int(values["safety_status_bits"][0]), assumed)),
        ("power", power(int(values["robot_mode"][0]))),
        ("program", other_program(int(values["runtime_state"][0]), info.program)),
        ("speed slider", slider(values["target_speed_fraction"][0])),
    ):
        status, sentence, remedy = answer
        checks.append(Check(name, status is Status.RUNNING, sentence, remedy))
    return checks


def _version(version: tuple[int, ...], info: ControllerInfo) -> Check:
    oldest = OLDEST.get(version[0])
    text = ".".join(map(str, version[:3]))
    ok = oldest is not None and version[:2] >= oldest
    known = ", ".join(f"{a}.{b}" for a, b in OLDEST.values())
    return Check(
        "PolyScope", ok, f"PolyScope {info.polyscope}, controller {text}",
        f"update PolyScope: the oldest versions that this driver was made for are {known}",
        "version-works",
    )  # fmt: skip


def serial(info: ControllerInfo, options: UrOptions) -> Check:
    """Check that this is the robot of the cell file, by the serial number pinned there at first use."""
    if not info.serial:
        return Check("serial", None, "this version does not report its serial number")
    if options.serial is None:
        return Check(
            "serial", None if at_emulator(options.host) else False, f"the robot reports serial number {info.serial}, the cell file states none",
            f'check that it is the robot you mean, then write serial = "{info.serial}" into [options] of the cell file', "serial-as-found",
        )  # fmt: skip
    return Check(
        "serial", info.serial == options.serial, f"the robot reports serial number {info.serial}, the cell file states {options.serial}",
        "another robot answers at this address: correct host, or serial if the robot was replaced", "serial-as-found",
    )  # fmt: skip


def safety_checksum(found: int | None, options: UrOptions) -> Check:
    """Check that the safety configuration is that of the cell file, if one is stated there."""
    pinned, name = options.safety_checksum, "safety checksum"
    if found is None:
        return Check(
            name, None if pinned is None else False, "the controller does not report its safety checksum",
            "compare the one on the pendant with your risk assessment, then remove safety_checksum from the cell file",
        )  # fmt: skip
    stated = "the cell file states none" if pinned is None else f"the cell file {pinned}"
    return Check(
        name, None if pinned is None else found == pinned,
        f"the number of the safety configuration is {found}, {stated}; the pendant shows it as characters",
        "somebody has changed the safety configuration: compare it with your risk assessment, then correct safety_checksum in the cell file",
    )  # fmt: skip


def tcp(values: dict[str, tuple[float, ...]]) -> Check:
    """Tool centre point that the controller holds. Joint motions do not depend on it; the tool's shape may be compared with it."""
    offset = values.get("tcp_offset")
    if offset is None:
        return Check("TCP", None, "this version does not report its tool centre point")
    x, y, z = offset[:3]
    return Check("TCP", True, f"the tool centre point is at ({1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f}) mm from the flange")


def torque(source: str, has_constant: bool) -> Check:
    """Source of torque: the controller, or current times the arm file's torque constant. An unknown source is not a failure."""
    if source == "actual_current_as_torque":
        return Check("torque", True, "the controller reports joint torque (actual_current_as_torque)")
    if has_constant:
        return Check("torque", True, "the controller reports current only; the arm file's torque_constant converts it")
    return Check(
        "torque", None,
        "the controller reports current only, and the arm file has no torque_constant: currents are recorded, torque stays unknown "
        "until a constant is known; PolyScope 5.23 and 10.11 report torque themselves",
    )  # fmt: skip
