"""For small values the columns of a candidate are the change of the predicted torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.candidates import candidates
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.scoring import Bank, scored
from calib.diagnosis.selection import add, started
from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS
from tests.calib.diagnosis.conftest import recording

# Effects without a small value: a stiff joint, bristles, a limit, a spring's rest angle, an event, a gap, a memory of heat.
WITHOUT = {
    "joint_elasticity", "presliding_friction", "torque_saturation", "joint_spring", "external_contact", "backlash", "thermal_friction",
}  # fmt: skip
SMALL, ALIKE, SIZE = 0.02, 0.98, 0.15


@pytest.fixture(scope="module")
def model(ur10e: Arm) -> LogModel:
    return LogModel(measured(recording(ur10e, 1, seconds=12.0), ur10e), Hypothesis.nominal(ur10e))


@pytest.mark.parametrize("effect", [e.name for e in EFFECTS if e.name not in WITHOUT])
def test_the_columns_of_a_candidate_are_the_slope_of_its_law(model: LogModel, effect: str) -> None:
    rng, m, seen, compared = np.random.default_rng(0), model.measurement, set(), 0
    for c in candidates([model]):
        (columns,) = c.columns
        width = next(iter(columns.values())).shape[1]
        if c.effect != effect or (c.joint, width) in seen:
            continue
        seen.add((c.joint, width))
        small = SMALL * rng.uniform(0.5, 1.0, width) * np.array(c.spread or 1.0)
        # A column without a parameter, such as the moments of a link whose mass changes, is set to zero.
        small *= [c.combine(small) != c.combine(np.where(np.arange(width) == k, 2 * small, small)) for k in range(width)]
        item = ArmEffect(effect, c.joint, {name: float(x) for name, x in c.combine(small).items()})
        with_it = LogModel(m, model.hypothesis.with_effects((item,)), like=model)
        exact = np.where(m.row_usable, model.residual - with_it.residual, 0.0)
        promised = np.zeros_like(exact)
        for j, x in columns.items():
            promised[:, j] = np.where(m.row_usable[:, j], x @ small, 0.0)
        size = float(np.linalg.norm(exact))
        if size < 1e-8 * np.linalg.norm(m.tau):  # for example the angle of a vertical axis, which changes no torque
            continue
        assert float(np.sum(exact * promised)) > ALIKE * size * np.linalg.norm(promised), (effect, c.joint)
        assert np.linalg.norm(promised) == pytest.approx(size, rel=SIZE), (effect, c.joint)
        compared += 1
    assert compared


def test_columns_that_nobody_asks_for_are_not_computed(ur10e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns are computed on first use: most products are known from another fit, and accepted effects are skipped."""
    model = LogModel(measured(recording(ur10e, 1, seconds=6.0), ur10e), Hypothesis.nominal(ur10e))
    computed, asked = LogModel.torque_with, set[str]()

    def counted(self: LogModel, j: int, effect: str, values: Mapping[str, float]) -> np.ndarray:
        asked.add(effect)
        return computed(self, j, effect, values)

    monkeypatch.setattr(LogModel, "torque_with", counted)
    (gain,) = (c for c in candidates([model]) if c.key == ("torque_gain", "elbow_joint"))
    assert not asked
    assert gain.columns[0][2].shape == (len(model.measurement.row_samples), 1)
    assert asked == {"torque_gain"}


@pytest.mark.slow
def test_a_link_is_found_whether_its_moments_follow_its_mass_or_not(ur10e: Arm) -> None:
    """Half of the elbow's link is missing. When the moments had to follow the mass, the mass was off by up to 2.6 std here."""
    tree, elbow = ur10e.tree, ur10e.joint_index("elbow_joint")
    for follow in (0.5, 1.0, 2.0):
        mass, inertia = tree.mass.copy(), tree.inertia.copy()
        mass[elbow], inertia[elbow] = 0.5 * mass[elbow], follow * inertia[elbow]
        truth = replace(ur10e, tree=replace(tree, mass=mass, inertia=inertia))
        logs = warmed([measured(recording(ur10e, seed, truth=truth), ur10e) for seed in (1, 2, 3)])
        base = started(logs, Hypothesis.nominal(ur10e))
        (found,) = (s for s in scored(base, set(), Bank()) if s.key == ("link_inertia", "elbow_joint"))
        with_it = add(logs, base, found)
        (std,) = with_it.std()
        wrong = with_it.accepted[0].parameters["mass"] - mass[elbow]
        assert abs(wrong) < std["mass"]
        assert found.gain == pytest.approx(base.objective - with_it.objective, rel=0.03)
