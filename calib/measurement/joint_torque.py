"""Joint torque of a recording, from what its drives report."""

from __future__ import annotations

import numpy as np

from calib.measurement.exclusions import (
    names_of,
)
from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog, ConfigError


def joint_torque(log: Log, arm: Arm, name: str = "log") -> np.ndarray:
    """(N, n) N m, joint by joint: the reported effort, else the current times the arm's torque constant.

    BadLog where a joint has neither; ConfigError where it has only a current and the arm no torque constant.
    """
    tau = np.array(log.tau, dtype=float)
    silent = ~np.isfinite(tau).any(axis=0)
    if not silent.any():
        return tau
    dark = silent & ~np.isfinite(log.current).any(axis=0)
    if dark.any():
        raise BadLog(f"{name}: neither effort nor current of {names_of(log, dark)}; a log needs one of them for every joint")
    if arm.torque_constant is None:
        raise ConfigError(
            f"{name}: only the current of {names_of(log, silent)} is recorded, and {arm.name} has no torque_constant; write it (N m/A at "
            "the joint) and its source into arm.toml, or identify it with a known mass: `calib identify --known-mass`"
        )
    tau[:, silent] = log.current[:, silent] * arm.torque_constant[silent]
    return tau
