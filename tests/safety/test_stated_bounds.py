"""Facts stated about an arm enter its bounds; an effect without a bound is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.bounds import TorqueBounds
from safety.clear import clear
from safety.loads import Loads
from safety.sheets import PathSheet
from safety.sudden import high_pass, sudden_change
from safety.torque import suffices, torque_interval
from sim.arm import Arm, ArmEffect
from sim.cell import Cell
from sim.effects import effect_named, with_effect
from sim.effects.coulomb_friction import CoulombFriction
from sim.effects.effect import Effect
from sim.errors import SafetyStop
from sim.interval import Interval
from sim.prediction import predict
from sim.torque_box import TorqueBox
from sim.trajectory import Trajectory
from tests.safety.conftest import sine
from tests.safety.test_bounds import BOUNDED, RATE, SURE, UNBOUNDED, arm_with, random_values, wild


def test_fitted_parameters_are_doubted_by_their_deviation(arm: Arm, cell: Cell) -> None:
    rng, motion = np.random.default_rng(0), sine(amplitude=0.2, duration=3.0, step=0.002)
    law = random_values(effect_named("friction_law"), rng) | {"power_1": 5.0, "slip_1e-2": 4.0}
    std = {"power_1": 0.5, "slip_1e-2": 0.3}
    made = with_effect(replace(arm, prior=SURE), ArmEffect("friction_law", "j2", law, std))
    torque = torque_interval(motion, made, cell)
    for signs in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        other = law | {name: law[name] + 1.99 * s * std[name] for name, s in zip(std, signs, strict=True)}
        off = np.abs(predict(with_effect(made, ArmEffect("friction_law", "j2", other)), motion) - torque.tau_hat)
        assert np.all(off <= torque.doubt + 1e-9)


def test_dry_friction_that_a_law_takes_back_is_counted_once(arm: Arm, cell: Cell) -> None:
    """Identification writes the level as Coulomb friction.

    The friction law then replaces part of that sharp step by a slower build-up.
    """
    zero = {p.name: 0.0 for p in effect_named("friction_law").parameters}
    made = with_effect(replace(arm, prior=SURE), ArmEffect("coulomb_friction", "j2", {"coulomb": 10.0}))
    made = with_effect(made, ArmEffect("friction_law", "j2", zero | {"slip_1e-4": -8.0, "slip_1e-2": 8.0}, {"slip_1e-4": 1e-9}))
    rest = Interval.zeros((1, 6))
    torque = TorqueBounds(made, cell).of(rest, rest, rest)
    alone = TorqueBounds(replace(arm, prior=SURE), cell).of(rest, rest, rest)
    assert 10.0 <= torque.reading.half[0, 1] - alone.reading.half[0, 1] <= 10.2


def test_an_effect_without_a_bound_is_refused_by_name_and_can_be_waived(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    for name in UNBOUNDED:
        effect = effect_named(name)
        soft = with_effect(arm, ArmEffect(name, "j3", random_values(effect, np.random.default_rng(0))))
        with pytest.raises(SafetyStop, match=f"effect {name} of j3"):
            clear(motion, soft, cell)
        waived = replace(cell, table=cell.table.model_copy(update={"assume": ["effects-without-a-bound"]}))
        assert clear(motion, soft, waived).verdict.room > 0


def test_a_drive_that_is_limited_lowers_what_a_motion_may_need(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    used = torque_interval(motion, arm, cell).most.max(axis=0)
    weak = with_effect(arm, ArmEffect("torque_saturation", "j2", {"limit": 0.98 * float(used[1])}, {"limit": 1e-6}))
    assert suffices(motion, arm, cell)
    assert not suffices(motion, weak, cell)
    with pytest.raises(SafetyStop, match="j2: torque up to"):
        clear(motion, weak, cell)
    sheet = PathSheet(motion, weak)
    with pytest.raises(SafetyStop, match="j2: torque up to"):
        Loads(weak, cell).room(sheet, "the motion", 1e-4, 0.1)


@pytest.mark.parametrize("name", [n for n in BOUNDED if n != "torque_saturation"])
def test_no_effect_of_the_file_is_a_sudden_change(arm: Arm, cell: Cell, name: str) -> None:
    """The residual of an arm that matches its file never changes faster than the monitor allows."""
    rng = np.random.default_rng(5)
    made, motion = arm_with(arm, name, rng), wild(rng)
    residual = predict(made, motion) - torque_interval(motion, made, cell).tau_hat
    allowed = sudden_change(motion, made, cell) + 0.05 * made.tau_max
    assert np.all(np.abs(high_pass(residual, RATE)[0]) <= allowed)


class Unheard(CoulombFriction):
    """tau = nobody knows."""

    name = "unheard"
    bound = Effect.bound


def test_by_default_an_effect_has_no_bound() -> None:
    none = Interval.zeros((1, 2))
    box = TorqueBox.of(none, none, none, np.ones(2), np.ones(2), 0.1, None)
    with pytest.raises(Exception, match="unheard"):
        Unheard().bound(box, np.array([0]), {}, np.zeros(1))
