"""The slip width depends on all recordings, not only on the first one."""

from __future__ import annotations

from benchmarks.known_truth import fourier_motion, recorded
from calib.identification.model import TorqueModel
from calib.identification.slip_width import fitted_slip_width
from calib.measurement.preprocessing import Measurement, prepare
from sim.arm import ArmEffect, load_arm
from sim.effects import effect_named, with_effect

JOINT = 2


def test_every_recording_takes_part() -> None:
    arm = load_arm("servo6")
    own = arm.effect("coulomb_friction", arm.joint_names[JOINT])
    assert own is not None
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"slip_3e-2": 6.0}
    bare = with_effect(arm, ArmEffect("coulomb_friction", arm.joint_names[JOINT], {"coulomb": 0.0}))
    wide = with_effect(bare, ArmEffect("friction_law", arm.joint_names[JOINT], law))

    def taken(truth: object, seed: int, seconds: float) -> Measurement:
        return prepare(recorded(truth, fourier_motion(arm, seed, seconds, 100.0), seed), arm, 20.0)  # type: ignore[arg-type]

    model = TorqueModel.of_arm(arm)
    still = taken(arm, 1, 120.0)
    few = [still, *[taken(wide, seed, 120.0) for seed in (2, 3, 4)]]
    alone, together = (fitted_slip_width(model, x)[JOINT] for x in (few[:1], few))
    assert alone < together
