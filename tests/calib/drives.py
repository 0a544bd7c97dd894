"""Arms whose drives are not known."""

from __future__ import annotations

from dataclasses import replace

from sim.arm import Arm


def silent(arm: Arm) -> Arm:
    """The arm with drives of which nobody stated anything."""
    return replace(arm, prior=arm.prior.model_copy(update={"unknown": ["coulomb", "viscous", "rotor", "offset"]}))
