"""An arm, a motion and an instance of any effect, derived from the catalogue: a new effect needs no change here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import Effect
from sim.trajectory import Trajectory

JOINT = "shoulder_lift_joint"
RATE = 250.0


@pytest.fixture(scope="session")
def arm() -> Arm:
    return load_arm("ur10e")


@pytest.fixture(scope="session")
def motion(arm: Arm) -> Trajectory:
    """Eight seconds of three harmonics per joint, from rest to rest, that load every joint and reverse it often."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 8, 1 / RATE)
    wave = 2 * np.pi / 8 * np.arange(1, 4)
    # the shoulder swings through the vertical, so its load changes sign and is large on both sides
    a, b = rng.uniform(-1, 1, (2, 3, arm.n)) * np.array([0.25, 0.6, 0.25, 0.25, 0.25, 0.25])
    home = np.array([0.2, -1.6, 0.4, -1.3, -1.2, 0.3])
    fade = np.sin(np.pi * t / 8)[:, None] ** 2
    q = home + fade * (np.sin(np.outer(t, wave)) @ a + np.cos(np.outer(t, wave)) @ b)
    dq = np.gradient(q, t, axis=0)
    return Trajectory(t, q, dq, np.gradient(dq, t, axis=0))


@pytest.fixture(scope="session")
def present() -> Callable[[Effect], ArmEffect]:
    """Function that gives an effect the middle value of each parameter's grid, plus 0.1 where that would be no effect."""

    def instance(effect: Effect) -> ArmEffect:
        middle = {p: p.grid[len(p.grid) // 2] for p in effect.parameters}
        values = {p.name: x if x != p.zero else x + 0.1 for p, x in middle.items()}
        return ArmEffect(effect.name, JOINT if effect.scope == "joint" else None, values)

    return instance
