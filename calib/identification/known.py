"""uncertainty.json beside arm.toml: the uncertainty of a calibrated arm, so that its predictions can have bounds.

It holds the covariance of base parameters and friction, and the unexplained torque as white noise of equal low-frequency power.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from calib.regression.normal_equations import inverse
from sim.arm import Arm
from sim.errors import ConfigError

FILE = "uncertainty.json"
SCHEMA = "uncertainty/1"


@dataclass(frozen=True)
class Known:
    """covariance (p, p) of the parameters of the arm's TorqueModel; intensity (n,) (N m)^2 s of the unexplained torque.

    The intensity is its power at low frequency. source: where these come from, in words.
    """

    covariance: np.ndarray
    intensity: np.ndarray
    source: str

    @staticmethod
    def of_arm(arm: Arm) -> Known:
        """From uncertainty.json in the arm's folder; without it, from the prior and the sensor noise in the arm's file.

        ConfigError where uncertainty.json is invalid or belongs to another arm.
        """
        model = TorqueModel.of_arm(arm)
        file = arm.model_path.parent / FILE
        if file.is_file():
            return _read(file, model)
        prior = nominal_prior(arm, model)
        noise = np.array(arm.sensors.torque_noise, dtype=float)
        return Known(
            inverse(prior.precision), noise**2 / arm.sensors.rate, "the arm's file states of its numbers and its sensors"
        )

    def write(self, folder: Path, model: TorqueModel) -> None:
        """Write uncertainty.json into the arm's folder."""
        table = {
            "schema": SCHEMA, "parameters": list(model.names), "covariance": self.covariance.tolist(), "intensity": self.intensity.tolist(),
            "unit": "(N*m)^2*s", "source": self.source,
        }  # fmt: skip
        (folder / FILE).write_text(json.dumps(table) + "\n", encoding="utf-8")


def _read(file: Path, model: TorqueModel) -> Known:
    remedy = "identify the arm again, or remove the file so that the arm's own tolerances apply"
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        covariance, intensity = (np.array(table[key], dtype=float) for key in ("covariance", "intensity"))
        names, source = table["parameters"], str(table["source"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{file}: {type(error).__name__}: {error}: not a file that `calib identify` wrote; {remedy}"
        ) from error
    p, n = model.p, model.arm.n
    if names != list(model.names) or covariance.shape != (p, p) or intensity.shape != (n,):
        raise ConfigError(f"{file}: belongs to an arm with other parameters than {model.arm.name}; {remedy}")
    if not (np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) >= 0) and np.all(intensity >= 0)):
        raise ConfigError(f"{file}: variances must be finite and not negative; {remedy}")
    return Known(covariance, intensity, source)
