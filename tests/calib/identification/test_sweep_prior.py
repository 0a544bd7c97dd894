"""The friction sweep of a slide says nothing of its torque offset, because its weight is as constant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.identification.friction import Sweep, as_prior
from calib.identification.model import TorqueModel
from sim.arm import Arm


def test_the_offset_of_a_slide_is_no_prior(ur5e: Arm) -> None:
    slides = np.arange(ur5e.n) == 2
    model = TorqueModel.of_arm(ur5e)
    mixed = replace(model, arm=replace(ur5e, tree=replace(ur5e.tree, prismatic=slides)))
    sweeps = [Sweep(j, np.array([1.0, 2.0, 20.0]), np.diag([0.1, 0.1, 0.5])) for j in (1, 2)]
    prior = as_prior(sweeps, mixed)
    kinds = [(kind, j) for j in (1, 2) for kind in ("viscous", "coulomb", "offset")]
    assert [of for of in kinds if prior.precision[(k := model.friction_column(*of)), k] == 0.0] == [("offset", 2)]
    assert prior.mean[model.friction_column("coulomb", 2)] == 2.0
    assert prior.mean[model.friction_column("offset", 1)] == 20.0
