"""What must be stated about an arm before a motion is planned or recordings are diagnosed; what is missing is named."""

from __future__ import annotations

import math

from sim.arm import Arm
from sim.errors import ConfigError


def require_limits(arm: Arm, *names: str) -> None:
    """ConfigError if a named limit is missing at some joint; a motion is never planned on a guessed limit."""
    for name in names:
        value = getattr(arm, name)
        missing = [j for j, v in zip(arm.joint_names, value, strict=True) if not math.isfinite(v)]
        if missing:
            place = f"write it to [limits] of {arm.model_path.parent / 'arm.toml'} and remove it from incomplete"
            folder = (arm.model_path.parent / "arm.toml").is_file()
            raise ConfigError(
                f"{arm.model_path}: {name} of {', '.join(missing)} is not given; a bare model file does not state it: "
                + (place if folder else "make an arm folder with `calib arm new`, with the limits of the arm's data sheet")
            )


def require_masses(arm: Arm) -> None:
    """ConfigError if the arm's masses are unknown: the torque of a motion cannot be predicted then."""
    if arm.prior.numbers == "unknown":
        raise ConfigError(
            f"{arm.model_path}: the arm's masses are unknown, so no motion's torque can be bounded; identify them first from "
            "recordings that its own controller made (`calib import`, `calib identify`), or make the arm with --numbers"
        )


def require_identified(arm: Arm, otherwise: str) -> None:
    """ConfigError if the masses of several links are unknown; otherwise: what would come of going on, for the message.

    A drive on a bench has one load, which is fitted together with everything else.
    """
    if arm.prior.numbers == "unknown" and arm.n > 1:
        raise ConfigError(
            f"{arm.model_path}: the arm's masses are unknown, so {otherwise}; identify them first "
            f"(`calib identify {arm.model_path.parent} LOG...`) and use the arm that identify writes"
        )
