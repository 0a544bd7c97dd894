"""Encoder readings of an arm's angles and speeds: the effects of the encoder stage, and the resolution."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.arm import ArmEffect
from sim.effects import Effect


class Encoders:
    """Encoders of an arm. effects: each with its joint; those without a joint are ignored. resolution rad."""

    def __init__(self, effects: Iterable[tuple[Effect, int | None, ArmEffect]], resolution: float) -> None:
        self._effects = [(effect, slice(j, j + 1), item.parameters) for effect, j, item in effects if j is not None]
        self._resolution = resolution

    def read(self, angle: np.ndarray) -> np.ndarray:
        """Readings (n,) rad of angles (n,) rad, rounded to the resolution."""
        angle = angle.copy()
        for effect, here, parameters in self._effects:
            angle[here] = effect.reading(angle[here], parameters)
        return np.asarray(np.round(angle / self._resolution) * self._resolution)

    def motor(self, angle: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (n,) rad and speed (n,) rad/s on the drive's own encoder, without rounding; both arguments are overwritten."""
        for effect, here, parameters in self._effects:
            speed[here] = effect.reading_speed(angle[here], speed[here], parameters)
            angle[here] = effect.reading(angle[here], parameters)
        return angle, speed

    def angle(self, reading: np.ndarray) -> np.ndarray:
        """Angles (n,) rad that give a reading (n,) rad."""
        angle = reading.copy()
        for effect, here, parameters in self._effects:
            for _ in range(20):
                angle[here] += reading[here] - effect.reading(angle[here], parameters)
        return angle
