"""Friction that leaves its band: warm-up is normal, growing friction on a warm joint is not.

A joint's friction is compared with its calibrated values or, where the arm was never calibrated, with those of the first `LEARN` seconds
of the joint's motion. Warm grease is thinner: friction may fall by `PER_KELVIN` for every kelvin that the joint has warmed, and rise as
it cools (A. C. Bittencourt and S. Gunnarsson 2012, doi:10.1115/1.4006589, report a fall of the order of a third between cold and warm).

Friction of real gears is not a straight line over speed: motions at speeds other than those of the calibration yield less dry and more
viscous friction, or the reverse, for the same joint in the same state. That leaves the total friction at the joint's usual speed
unchanged; wear does not. A value that has left its band therefore counts only where the total at that speed has changed in the same
direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.watch.events import Kind, Quantity, WatchEvent
from calib.watch.filter import TorqueFilter
from calib.watch.momentum import Row
from sim.arm import Arm

BAND = 0.25  # relative change of friction that needs no attention
PER_KELVIN = 0.015
WARMUP = 25.0  # K that a joint may have warmed where it reports no temperature
MATTERS = (
    0.1  # least relative change, in the same direction, of the total friction at the joint's usual speed that counts as wear
)
SURE = 3.0  # standard deviations
LEARN = 60.0  # s of motion of a joint
HOLDS = 5.0  # s of motion for which a drift must persist


@dataclass(frozen=True, slots=True)
class JointFriction:
    """Friction of one joint now: dry N m and viscous N m s/rad with their standard deviations, and temperature degC."""

    coulomb: Quantity
    viscous: Quantity
    temperature: float


class WearWatch:
    """Rows in, drift events out: one for each time that a joint's friction leaves its band."""

    def __init__(self, arm: Arm, filter_: TorqueFilter, coulomb: np.ndarray, viscous: np.ndarray) -> None:
        n = arm.n
        self._arm, self._filter = arm, filter_
        self._stated = (coulomb, viscous)
        self._reference = np.where(_calibrated(arm), np.stack(self._stated), np.nan)
        self._temperature = np.full(n, np.nan)
        self._moved = np.zeros(n)
        self._square = np.zeros(n)
        self._sure = np.zeros(n)
        self._reported = np.zeros(n, dtype=bool)
        self._due = 0.0

    def now(self, temperature: np.ndarray) -> list[JointFriction]:
        """Friction of every joint."""
        std = np.sqrt(np.diag(self._filter.covariance))
        dry, wet = self._values()
        return [
            JointFriction(
                Quantity(float(dry[j]), float(std[self._filter.coulomb][j]), "N*m"),
                Quantity(float(wet[j]), float(std[self._filter.viscous][j]), "N*m*s/rad"),
                float(temperature[j]),
            )
            for j in range(self._arm.n)
        ]

    def add(self, row: Row, temperature: np.ndarray) -> list[WatchEvent]:
        """Drift events that this row confirms; temperature (n,) degC, NaN where it is not reported."""
        used = self._filter.usable(row)
        self._moved += used * row.seconds
        self._square += used * row.seconds * row.speed**2
        self._due += row.seconds
        fresh = np.isnan(self._temperature)
        self._temperature[fresh] = temperature[fresh]
        learnt = (self._moved >= LEARN) & np.isnan(self._reference).any(axis=0)
        self._reference[:, learnt] = self._values()[:, learnt]
        if self._due < 0.5:
            return []
        seconds, self._due = self._due, 0.0
        beyond, which = self._beyond(temperature)
        self._sure = np.where(beyond, self._sure + seconds * used, 0.0)
        events = [self._event(row.t, int(j), int(which[j])) for j in np.flatnonzero((self._sure >= HOLDS) & ~self._reported)]
        self._reported = (self._reported & beyond) | (self._sure >= HOLDS)
        return events

    def _values(self) -> np.ndarray:
        """(2, n) dry and viscous friction."""
        x = self._filter.x
        return np.stack([self._stated[0] + x[self._filter.coulomb], self._stated[1] + x[self._filter.viscous]])

    def _relative(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Relative change (2, n) of dry and viscous friction, its standard deviation, and the change (n,) of the total at the usual speed."""
        speed = np.sqrt(self._square / np.maximum(self._moved, 1e-9))
        unit = np.stack([np.ones(self._arm.n), speed])
        torque = self._reference * unit
        whole = np.where(np.isfinite(torque), torque, 0.0).sum(axis=0)
        std = np.sqrt(np.diag(self._filter.covariance))
        spread = np.stack([std[self._filter.coulomb], std[self._filter.viscous]])
        base = np.maximum(self._reference, 0.1 * whole / np.maximum(unit, 1e-3))
        change = self._values() - self._reference
        together = np.where(np.isfinite(change), change * unit, 0.0).sum(axis=0)
        return change / base, spread / base, together / np.maximum(whole, 1e-12)

    def _beyond(self, temperature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) whether a friction value has certainly left its band, and (n,) which: 0 dry, 1 viscous."""
        relative, spread, together = self._relative()
        warmed = temperature - self._temperature
        falls = BAND + PER_KELVIN * np.where(np.isfinite(warmed), np.maximum(warmed, 0.0), WARMUP)
        rises = BAND + PER_KELVIN * np.where(np.isfinite(warmed), np.maximum(-warmed, 0.0), 0.0)
        out = ((relative - SURE * spread > rises) | (relative + SURE * spread < -falls)) & (
            np.sign(relative) * together > MATTERS
        )
        worst = np.argmax(np.where(out, np.abs(relative), -1.0), axis=0)
        return np.asarray(out.any(axis=0)), worst

    def _event(self, t: float, j: int, which: int) -> WatchEvent:
        word, unit = (("dry", "N*m"), ("viscous", "N*m*s/rad"))[which]
        relative, spread, _ = self._relative()
        value, change = self._values()[which, j], Quantity(float(relative[which, j]), float(spread[which, j]), "1")
        std = np.sqrt(np.diag(self._filter.covariance))[(self._filter.coulomb, self._filter.viscous)[which]][j]
        now = Quantity(float(value), float(std), unit)
        joint = self._arm.joint_names[j]
        text = (
            f"{word} friction of {joint} is {now}, {change.value:+.0%} ± {2 * change.std:.0%} from {self._reference[which, j]:.3g} {unit.replace('*', ' ')}: "
            f"more than warming explains; check grease, belt and bearing, and see calib watch --trend"
        )
        return WatchEvent(
            Kind.FRICTION_DRIFT, t, (t - self._sure[j], t), text, {"friction": now, "relative_change": change}, joint
        )


def _calibrated(arm: Arm) -> np.ndarray:
    """(n,) whether a joint's friction was estimated from recordings of this arm rather than taken from a data sheet."""
    friction = ("coulomb_friction", "viscous_friction")
    return np.array([all((e := arm.effect(name, j)) is not None and e.std for name in friction) for j in arm.joint_names])
