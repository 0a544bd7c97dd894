"""Units found in recordings, as factors to SI, under the names that people write."""

from __future__ import annotations

import math

# channel -> unit -> factor to the unit of the log; the first is the log's own
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
ANGLE = {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3, "rev": 2 * math.pi}
SPEED = {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": 2 * math.pi / 60, "rev/s": 2 * math.pi, "mrad/s": 1e-3}
TORQUE = {"N m": 1.0, "mN m": 1e-3, "N mm": 1e-3, "N cm": 1e-2, "kgf cm": 0.0980665, "kgf m": 9.80665}
CURRENT = {"A": 1.0, "mA": 1e-3}
TEMPERATURE = {"degC": 1.0, "K": 1.0, "degF": 5 / 9}
TEMPERATURE_ZERO = {"degC": 0.0, "K": 273.15, "degF": 32.0}

UNITS: dict[str, dict[str, float]] = {
    "q": ANGLE, "dq": SPEED, "tau": TORQUE, "current": CURRENT, "temperature": TEMPERATURE,
    "q_cmd": ANGLE, "dq_cmd": SPEED, "tau_cmd": TORQUE,
}  # fmt: skip
