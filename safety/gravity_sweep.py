"""Gravity torque in a few nearby poses, without friction: slowly there and back along the same line, at one speed.

Where a pose is passed in both directions at the same steady speed, half the sum of the torques is g(q) and half their
difference is the friction of each joint. The tolerance of a comparison with a model is thus a small part of measured friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.driver import Driver
from safety.approach import move
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.guard import Guard
from safety.run_progress import Cycle
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.joint_state import JointState

LINES = 3
AWAY = (0.25, 0.5)  # rad that each joint turns on a line
TRIED = 30
SHARE = 0.1  # of the arm's limits
# places on a line where poses are compared, and how far to either side readings are used, as shares of its length; speed is
# steady there
PLACES, AROUND = (0.3, 0.5, 0.7), 0.06


@dataclass(frozen=True)
class Line:
    """The way there and back along one straight line of joint angles, both cleared."""

    there: ClearedTrajectory
    back: ClearedTrajectory


@dataclass(frozen=True)
class Passed:
    """Poses passed in both directions, rows k: q (K, n) rad, half the sum and half the difference (K, n) of the torques, N m.

    If `torque` is False, no torque is known, and they are those of the currents, A.
    """

    q: np.ndarray
    gravity: np.ndarray
    friction: np.ndarray
    torque: bool


def lines_from(q: np.ndarray, driver: Driver, cell: Cell, clearance: Clearance, latency: float) -> list[Line]:
    """Up to LINES verified lines from q (n,) rad to random poses, each joint turned by AWAY; [] if none can be verified."""
    arm, rng, lines = driver.arm, np.random.default_rng(0), []
    for _ in range(TRIED):
        end = q + rng.uniform(*AWAY, arm.n) * rng.choice((-1.0, 1.0), arm.n)
        try:
            lines.append(
                Line(*(
                    clear(move(a, b, arm, driver.rate, SHARE), arm, cell, driver.rate, driver.device_stop, latency, clearance)
                    for a, b in ((q, end), (end, q))
                ))
            )  # fmt: skip
        except SafetyStop:
            continue
        if len(lines) == LINES:
            break
    return lines


def sweep(lines: list[Line], arm: Arm, guard: Guard, seen: list[Cycle]) -> Passed:
    """Drive the lines. seen: filled by the guard's watcher. NaN where the device reports neither torque nor current."""
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    torque = True
    for line in lines:
        begin, end = line.there.q[0], line.there.q[-1]
        ways: list[tuple[np.ndarray, np.ndarray]] = []
        for way in (line.there, line.back):
            seen.clear()
            guard.run(way, "there and back for the gravity torque")
            states = [cycle.state for cycle in seen]
            torque &= _torque_is_known(states, arm)
            ways.append(at_places(states, begin, end, arm))
        (q, there), (_, back) = ways
        rows.append((q, (there + back) / 2, np.abs(there - back) / 2))
    q, gravity, friction = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Passed(q, gravity, friction, torque)


def at_places(states: list[JointState], begin: np.ndarray, end: np.ndarray, arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """q (P, n) and torque (P, n), by a linear fit, at PLACES of the line from begin to end (n,) rad.

    Current if no torque is known; NaN where fewer than three readings are near.
    """
    q, along = np.array([s.q for s in states]), end - begin
    torque, current = np.array([s.tau for s in states]), np.array([s.current for s in states])
    if arm.torque_constant is not None:
        torque = np.where(np.isfinite(torque), torque, arm.torque_constant * current)
    if not _torque_is_known(states, arm):
        torque = current
    share = (q - begin) @ along / float(along @ along)
    out = np.full((len(PLACES), len(begin)), np.nan)
    for k, place in enumerate(PLACES):
        near = np.abs(share - place) <= AROUND
        if np.count_nonzero(near) >= 3:
            # a linear fit, as readings are not evenly spread about the place
            fit = np.polynomial.polynomial.polyfit(share[near] - place, torque[near], 1)
            out[k] = fit[0]
    return begin + np.array(PLACES)[:, None] * along, out


def _torque_is_known(states: list[JointState], arm: Arm) -> bool:
    """False if the readings hold only currents and the arm has no torque constant."""
    return arm.torque_constant is not None or any(bool(np.isfinite(s.tau).any()) for s in states)
