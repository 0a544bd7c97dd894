"""Checks of a controller before motion: whether it is ready, which arm it has, and its torque at rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from drivers.driver import Check
from drivers.preflight import STANDSTILL, lifted
from drivers.ur_rtde import checks, family, own_folder, primary, reading
from drivers.ur_rtde.dashboard import ControllerInfo
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.reading import JOINTS
from drivers.ur_rtde.receiver import Frame
from sim.arm import Arm
from sim.cell import PayloadTable
from sim.errors import DeviceError


def readiness(
    frame: Frame, controller: ControllerInfo, version: tuple[int, ...], arm: Arm, options: UrOptions, assumed: Collection[str]
) -> list[Check]:
    """Checks of model and serial number, and of readiness as one frame and the controller report it."""
    found = [
        family.model(controller.model, version[0], arm),
        checks.serial(controller, options),
        *checks.readiness(frame.values, controller, version, assumed),
    ]
    return lifted(found, assumed)


def own_arm(arm: Arm, options: UrOptions) -> list[Check]:
    """Checks of the controller's own calibration and safety checksum against the arm folder and the cell."""
    try:
        own = primary.own_arm(options.host)
    except DeviceError as error:
        return [Check("kinematics", None, str(error)), checks.safety_checksum(None, options)]
    return [own_folder.kinematics(arm, own), checks.safety_checksum(own.safety, options)]


def arm_at_rest(arm: Arm, payload: PayloadTable | None, frames: Sequence[Frame], running: bool) -> Check:
    """Check of which arm of the family fits the mean torque at rest in these frames; ok is None if it moves or is off."""
    q, dq, tau, current = (
        np.mean([f.values.get(name, (np.nan,) * JOINTS) for f in frames], axis=0)
        for name in ("actual_q", "actual_qd", reading.TORQUE, "actual_current")
    )
    if arm.torque_constant is not None:
        tau = np.where(np.isfinite(tau), tau, arm.torque_constant * current)
    at_rest = running and bool(np.all(np.abs(dq) <= STANDSTILL))
    return family.torque(arm, payload, q, tau if at_rest else np.full(JOINTS, np.nan))
