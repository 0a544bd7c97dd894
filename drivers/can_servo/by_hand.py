"""Which drive moves which joint, and which way: somebody turns each joint by hand, and only the positions of the drives are read."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.can_servo.drive import Drive
from drivers.can_servo.link import Link
from sim.clock import Clock
from sim.errors import DeviceError

OTHERS = 0.5  # part of what counts as a turn that no other drive may move
STILL = 0.02  # rad within STILL_TIME of a joint at rest
STILL_TIME = 0.5  # s
PATIENCE = 120.0  # s for one joint
PERIOD = 0.03  # s between two looks


class ByHand:
    """Positions of drives that nobody has described, their torque off."""

    def __init__(self, drives: Sequence[Drive], link: Link, clock: Clock, patience: float = PATIENCE) -> None:
        self.drives, self.link, self.clock, self.patience = list(drives), link, clock, patience
        self.q = np.full(len(self.drives), np.nan)

    def look(self) -> np.ndarray:
        """Where every drive stands, (n,) rad on the drive's side; DeviceError names those that do not say."""
        self.q = np.full(len(self.drives), np.nan)
        end = self.clock.now() + 10 * PERIOD
        while np.isnan(self.q).any():
            if self.clock.now() >= end:
                silent = ", ".join(d.name for d, q in zip(self.drives, self.q, strict=True) if math.isnan(q))
                raise DeviceError(
                    f"{silent}: where it stands cannot be read: silent, or at the end of its range; look at its cable, supply and zero"
                )
            self.link.send(
                [m for d, q in zip(self.drives, self.q, strict=True) if math.isnan(q) and (m := d.position_question())]
            )
            pause = self.clock.now() + PERIOD
            while (message := self.link.receive(pause)) is not None:
                for j, drive in enumerate(self.drives):
                    q = drive.position_in(message)
                    if q is not None:
                        self.q[j] = q
        return self.q

    def settle(self) -> np.ndarray:
        """Wait until nothing moves; where every drive then stands."""
        before, end = self.look().copy(), self.clock.now() + self.patience
        while self.clock.now() < end:
            self.clock.sleep_until(self.clock.now() + STILL_TIME)
            now = self.look().copy()
            if np.all(np.abs(now - before) < STILL):
                return now
            before = now
        raise DeviceError(f"the arm did not come to rest within {self.patience:g} s; support it, then begin again")

    def turned(self) -> tuple[int, int]:
        """(drive, sign) of the joint that is turned from here; DeviceError where nobody turns one, or two move together."""
        start, end = self.settle(), self.clock.now() + self.patience
        while self.clock.now() < end:
            moved = (self.look() - start) / [d.hand_turn for d in self.drives]
            order = np.argsort(-np.abs(moved))
            if abs(moved[order[0]]) >= 1.0:
                if len(order) > 1 and abs(moved[order[1]]) > OTHERS * abs(moved[order[0]]):
                    first, second = (self.drives[int(k)].name for k in order[:2])
                    raise DeviceError(f"{first} and {second} moved together; hold the other joints and turn one alone")
                return int(order[0]), 1 if moved[order[0]] > 0 else -1
            self.clock.sleep_until(self.clock.now() + PERIOD)
        raise DeviceError(f"no joint was turned far enough within {self.patience:g} s; begin again when somebody is at the arm")
