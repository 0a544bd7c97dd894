"""Arms with unknown drives."""

from __future__ import annotations

from dataclasses import replace

from sim.arm import Arm


def silent(arm: Arm) -> Arm:
    """The arm with friction, reflected inertia and torque offset declared unknown."""
    return replace(arm, prior=arm.prior.model_copy(update={"unknown": ["coulomb", "viscous", "rotor", "offset"]}))
