"""What encoders make of the angles and speeds of an arm: the effects of that stage, and their resolution."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.arm import ArmEffect
from sim.effects import Effect


class Encoders:
    """The encoders of an arm: `effects` with the joint that each belongs to, those of no joint are left out; resolution rad."""

    def __init__(self, effects: Iterable[tuple[Effect, int | None, ArmEffect]], resolution: float) -> None:
        self._effects = [(effect, slice(j, j + 1), item.parameters) for effect, j, item in effects if j is not None]
        self._resolution = resolution

    def read(self, angle: np.ndarray) -> np.ndarray:
        """The readings (n,) rad of angles (n,) rad, in whole steps."""
        angle = angle.copy()
        for effect, here, parameters in self._effects:
            angle[here] = effect.reading(angle[here], parameters)
        return np.asarray(np.round(angle / self._resolution) * self._resolution)

    def motor(self, angle: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (n,) rad and speed (n,) rad/s as the drive's own encoder has them, without steps; both are written to."""
        for effect, here, parameters in self._effects:
            speed[here] = effect.reading_speed(angle[here], speed[here], parameters)
            angle[here] = effect.reading(angle[here], parameters)
        return angle, speed

    def angle(self, reading: np.ndarray) -> np.ndarray:
        """The angles (n,) rad that give a reading."""
        angle = reading.copy()
        for effect, here, parameters in self._effects:
            for _ in range(20):
                angle[here] += reading[here] - effect.reading(angle[here], parameters)
        return angle
