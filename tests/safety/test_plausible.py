"""A setting that would disable a rule is refused, unless the cell file waives that setting by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.plausible import BOUNDS, check_plausible, unusual
from sim.arm import Arm, load_arm
from sim.cell import Cell, PayloadTable, ToolCapsule, load_cell
from sim.errors import SafetyStop


@pytest.mark.parametrize("name", ["ur3e", "ur5e", "ur10e", "ur16e", "ur20", "servo6"])
def test_shipped_arms_are_usual(name: str) -> None:
    assert unusual(load_arm(name), load_cell("mock-ur10e")) == {}


def test_the_shipped_cells_are_usual() -> None:
    for name in ("mock-ur10e", "emulated-ur10e", "emulated-servo6"):
        cell = load_cell(name)
        check_plausible(load_arm(cell.table.arm), cell)


def test_a_payload_has_a_shape_or_is_named_as_having_none(arm: Arm, cell: Cell) -> None:
    load = PayloadTable(mass=2.0)
    ball = ToolCapsule(kind="capsule", name="hand", ends=[[0.0, 0.0, 0.1]] * 2, radius=0.05)

    def of(**changes: object) -> Cell:
        return replace(cell, table=cell.table.model_copy(update=changes))

    with pytest.raises(SafetyStop, match="has no shape"):
        check_plausible(arm, of(payload=load))
    check_plausible(arm, of(payload=load, tool=[ball]))
    check_plausible(arm, of(payload=load, assume=["payload-without-shape"]))
    check_plausible(arm, of(payload=PayloadTable(mass=0.0)))


def changed(arm: Arm, cell: Cell, name: str, value: float) -> tuple[Arm, Cell]:
    if name in ("dq_max", "ddq_max", "jerk_max", "tau_max"):
        return replace(arm, **{name: np.append(getattr(arm, name)[:-1], value)}), cell  # type: ignore[arg-type]
    if name in ("rate", "encoder_resolution"):
        return replace(arm, sensors=arm.sensors.model_copy(update={name: value})), cell
    if name in ("velocity_noise", "torque_noise"):
        return replace(arm, sensors=arm.sensors.model_copy(update={name: [value] * 6})), cell
    if name in ("torque_constant", "torque_continuous"):
        return replace(arm, **{name: np.full(6, value)}), cell  # type: ignore[arg-type]
    if name == "prior":
        return replace(arm, prior=arm.prior.model_copy(update={"com": value})), cell
    if name == "payload_mass":
        update: dict[str, object] = {"payload": PayloadTable.model_construct(mass=value, com=[0.0, 0.0, 0.0])}
    elif name == "payload_com":
        update = {"payload": PayloadTable.model_construct(mass=1.0, com=[0.0, value, 0.0])}
    else:
        update = {"motion": cell.table.motion.model_copy(update={name: value})}
    return arm, replace(cell, table=cell.table.model_copy(update=update))


@pytest.mark.parametrize("name", BOUNDS)
def test_each_setting_beyond_its_bounds_is_refused_and_can_be_lifted_by_its_name(arm: Arm, cell: Cell, name: str) -> None:
    least, most = BOUNDS[name]
    odd, there = changed(arm, cell, name, most * 0.999)
    check_plausible(odd, replace(there, table=there.table.model_copy(update={"assume": ["payload-without-shape"]})))
    beyond = [most * 1.001, np.nan, np.inf] + ([least * 0.999] if least > 0 else [])
    for value in beyond:
        odd, there = changed(arm, cell, name, value)
        there = replace(there, table=there.table.model_copy(update={"assume": ["payload-without-shape"]}))
        with pytest.raises(SafetyStop, match=f"unusual-{name}"):
            check_plausible(odd, there)
        lifted = replace(there, table=there.table.model_copy(update={"assume": [f"unusual-{name}", "payload-without-shape"]}))
        check_plausible(odd, lifted)
        assert f"unusual-{name}" in lifted.assumed


@pytest.mark.parametrize("name", ["q_max", "q_min", "tau_max"])
def test_limits_wider_than_the_models_are_refused(arm: Arm, cell: Cell, name: str) -> None:
    tree = replace(arm.tree, tau_max=np.array(arm.tau_max))
    own = replace(arm, tree=tree, q_max=tree.q_max, q_min=tree.q_min)
    check_plausible(own, cell)
    wider = replace(own, **{name: getattr(own, name) * 1.01})  # type: ignore[arg-type]
    with pytest.raises(SafetyStop, match="unusual-limits_of_model"):
        check_plausible(wider, cell)
