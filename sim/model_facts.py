"""What a model file states about an arm besides its kinematic tree, and the default for sensors that are not described."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from sim.arm_table import SensorsTable
from sim.errors import ConfigError
from sim.files import is_name
from sim.tree import KinematicTree


def model_limits(tree: KinematicTree) -> dict[str, Any]:
    """Limits (n,) that a model file states, NaN where it has none; no model format states acceleration or jerk."""
    nan = np.full(tree.n, np.nan)
    return {
        "q_min": tree.q_min,
        "q_max": tree.q_max,
        "dq_max": tree.dq_max,
        "ddq_max": nan,
        "jerk_max": nan,
        "tau_max": tree.tau_max,
    }


def unknown_sensors(n: int) -> SensorsTable:
    """Default for n joints whose sensors are not described: 500 Hz, 1e-5 rad, no noise."""
    return SensorsTable(rate=500.0, encoder_resolution=1e-5, velocity_noise=[0.0] * n, torque_noise=[0.0] * n)


def model_name(text: str, path: Path) -> str:
    """The model's own name if it is valid, else that of its file; ConfigError if neither is."""
    found = re.search(r"<(?:mujoco\s+model|robot\s+name)\s*=\s*[\"']([^\"']+)[\"']", text)
    for name in (found.group(1) if found else "", path.stem):
        if is_name(name):
            return name
    raise ConfigError(
        f"{path}: neither the model's name nor the file's is valid: 1 to 64 letters, digits, dots, dashes and underscores; rename the file"
    )
