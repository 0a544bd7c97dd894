"""Which drive moves which joint, and in which direction: each joint is turned by hand, and only drive positions are read."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.can_servo.drive import Drive
from drivers.can_servo.link import Link
from sim.clock import Clock
from sim.errors import DeviceError

OTHERS = 0.5  # share of the largest movement that no other drive may exceed
STILL = 0.02  # rad that a joint at rest may move within STILL_TIME
STILL_TIME = 0.5  # s
PATIENCE = 120.0  # s for one joint
PERIOD = 0.03  # s between two queries


class ByHand:
    """Positions of drives that no cell file describes, with torque off."""

    def __init__(self, drives: Sequence[Drive], link: Link, clock: Clock, patience: float = PATIENCE) -> None:
        self.drives, self.link, self.clock, self.patience = list(drives), link, clock, patience
        self.q = np.full(len(self.drives), np.nan)

    def look(self) -> np.ndarray:
        """Position of every drive, (n,) rad on the drive's side; DeviceError names those that do not report it."""
        self.q = np.full(len(self.drives), np.nan)
        end = self.clock.now() + 10 * PERIOD
        while np.isnan(self.q).any():
            if self.clock.now() >= end:
                silent = ", ".join(d.name for d, q in zip(self.drives, self.q, strict=True) if math.isnan(q))
                raise DeviceError(
                    f"{silent}: its position cannot be read: silent, or at the end of its range; check its cable, supply and zero"
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
        """Wait until nothing moves; return the position of every drive, (n,) rad."""
        before, end = self.look().copy(), self.clock.now() + self.patience
        while self.clock.now() < end:
            self.clock.sleep_until(self.clock.now() + STILL_TIME)
            now = self.look().copy()
            if np.all(np.abs(now - before) < STILL):
                return now
            before = now
        raise DeviceError(f"the arm did not come to rest within {self.patience:g} s; support it, then begin again")

    def turned(self) -> tuple[int, int]:
        """(drive, sign) of the joint that is turned from here; DeviceError if none is turned, or two move together."""
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
