"""The emulated drive follows an arm whose links push one another and whose rotors nobody stated, as well as one that has them."""

import numpy as np
import pytest

from sim.arm import ArmEffect, load_arm
from sim.effects import with_effect
from sim.plant import Plant


def _followed(arm, q):
    """The largest error, rad, over half a second of a smooth motion from q."""
    plant, step, worst = Plant(arm), 1 / arm.sensors.rate, 0.0
    plant.reset(q)
    for k in range(int(0.5 / step)):
        t = k * step
        target = q + 0.1 * (1 - np.cos(2 * t))
        plant.command(target, np.full(arm.n, 0.2 * np.sin(2 * t)), np.zeros(arm.n))
        plant.advance(step)
        worst = max(worst, float(np.abs(plant.data.qpos - target).max()))
    return worst


@pytest.mark.parametrize("q", [np.zeros(6), np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])])
def test_it_is_steady_without_rotors(q):
    arm = load_arm("ur10e")
    bare = arm
    for joint in arm.joint_names:
        bare = with_effect(bare, ArmEffect("rotor_inertia", joint, {"inertia": 0.0}))
        bare = with_effect(bare, ArmEffect("coulomb_friction", joint, {"coulomb": 0.0}))
        bare = with_effect(bare, ArmEffect("viscous_friction", joint, {"viscous": 0.0}))
    assert Plant(bare)._pushed
    assert not Plant(arm)._pushed
    assert _followed(bare, q) < 2e-3
