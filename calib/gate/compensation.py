"""A controller that compensates friction and leaves it out of the torque it reports: the reading then falls with the speed of a joint.

No joint does that by itself, so a reversed sign may make the model fit better than the readings as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause
from calib.gate.fit import model_torque, normal
from calib.gate.signals import Signals
from sim.arm import Arm

# Nats by which it must explain the readings better than anything else found. With it, no reversed sign of a joint or of its motion passes for
# compensation (12 of the tests), and none of the 500 wrong recordings of benchmarks/gate.py gets another first cause.
LEAST_GAIN = 0.1


def compensated(arm: Arm, s: Signals, joints: Sequence[int], gain: float) -> list[Cause]:
    """A cause for each of the joints (all if none given) whose readings need a driving torque that grows with speed; gain: nats to exceed."""
    equations, at = normal(s, model_torque(arm, s)), np.arange(s.n)
    braked, _ = equations.solved(s.load)
    driven, theta = equations.solved(s.load, driven=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = np.log(braked[at, at] / driven[at, at])
    found = [(gains[j], j) for j in joints or range(s.n) if gains[j] > gain + LEAST_GAIN]
    return [
        Cause(
            f"the torque (or current) of {arm.joint_names[j]} falls by {theta[j, 2, j]:.3g} per rad/s of its speed: it leaves out friction "
            "that the controller compensates; record the torque or current of the motor",
            more,
        )
        for more, j in sorted(found, reverse=True)
    ]
