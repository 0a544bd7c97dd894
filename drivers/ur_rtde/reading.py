"""One RTDE frame as a reading, and as device information."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.driver import DeviceInfo
from drivers.ur_rtde.dashboard import ControllerInfo
from drivers.ur_rtde.receiver import Frame
from sim.joint_state import JointState, Status

JOINTS = 6
TORQUE = "actual_current_as_torque"

Values = Mapping[str, tuple[float, ...]]


def joint_state(frame: Frame, status: Status, detail: str) -> JointState:
    """The frame as a reading; torque is NaN if the controller does not report it."""
    values = frame.values
    nothing = np.full(JOINTS, np.nan)
    return JointState(
        t=frame.t, t_device=frame.t_device, q=np.array(values["actual_q"]), dq=np.array(values["actual_qd"]),
        tau=np.array(values[TORQUE]) if TORQUE in values else nothing, current=np.array(values["actual_current"]),
        temperature=np.array(values["joint_temperatures"]), status=status, detail=detail,
    )  # fmt: skip


def torque_source(values: Values) -> str:
    """The variable that torque comes from: the controller's own torque, or the current."""
    return TORQUE if TORQUE in values else "actual_current"


def device_info(
    values: Values, controller: ControllerInfo, version: tuple[int, ...], rate: float, extra: Mapping[str, str]
) -> DeviceInfo:
    """Model, serial number, versions, payload and mounting that the controller assumes; `extra` is added to its version."""
    payload, com, up = values.get("payload"), values.get("payload_cog"), values.get("target_gravity")
    text = ".".join(map(str, version[:3]))
    return DeviceInfo(
        model=controller.model or "UR", serial=controller.serial, firmware=controller.polyscope or text, rate=rate,
        payload_mass=payload[0] if payload else None,
        payload_com=(com[0], com[1], com[2]) if com else None,
        # the read-back of set_gravity, which URScript defines as the acceleration away from the earth's centre
        gravity=(-up[0], -up[1], -up[2]) if up else None,
        torque_source=torque_source(values),
        extra={"controller": text, **extra},
    )  # fmt: skip
