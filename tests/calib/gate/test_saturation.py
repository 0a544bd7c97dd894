"""A drive at its limit can look like exchanged columns.

If commands show the limit, its rows are left out; otherwise it is named beside exchanged columns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wrong_data import BASES, base, changes, family
from calib.gate import gate
from calib.gate.saturation import below_limits
from calib.gate.signals import signals
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.plant import Plant

SWAPPED, AT_LIMIT = "columns of shoulder_lift_joint and wrist_3_joint are swapped", "the drive of {} was at its torque limit"


@pytest.mark.parametrize("name", BASES)
def test_exchanged_columns_alone_are_no_limit(name: str) -> None:
    of, log = base(name)
    what = f"loads exchanged, {of.joint_names[1]},{of.joint_names[5]}"
    wrong, _ = changes(of)[what](log, of, np.random.default_rng(0))
    refusal = gate(of, [wrong], family=family).refusal
    assert refusal is not None
    assert "torque limit" not in refusal


def test_a_torque_that_stands_at_its_largest_value_is_named_beside_exchanged_columns() -> None:
    of, log = base("servo6 2")
    tau = log.tau.copy()
    tau[:, [1, 5]] = tau[:, [5, 1]]
    most = 0.5 * np.abs(tau[:, 5]).max()
    tau[:, 5] = np.clip(tau[:, 5], -most, most)
    found = gate(of, [replace(log, tau=tau)], family=family)
    assert found.refusal is not None
    assert SWAPPED in found.causes[0].sentence
    assert found.causes[1].sentence.startswith(AT_LIMIT.format("wrist_3_joint"))
    assert found.causes[1].sentence in found.refusal


def test_rows_at_a_limit_that_the_commands_show_are_left_out() -> None:
    of, log = base("ur10e 3")
    most = 0.6 * np.abs(log.tau[:, 1]).max()
    over = np.abs(log.tau[:, 1]) > most
    limited = replace(log, tau=log.tau.copy(), q_cmd=log.q + 1e-5 * np.sin(7.0 * log.t)[:, None])
    limited.tau[:, 1] = np.clip(log.tau[:, 1], -most, most)
    limited.q_cmd[:, 1] += 0.3 * over
    s = signals([limited], [limited.tau])
    below = below_limits(of, [limited], [limited.tau], s)
    assert below.mean() == pytest.approx(1 - over.mean(), rel=0.2)
    assert np.abs(s.rows(below).load[:, 1]).max() < 0.92 * most
    assert below_limits(of, [log], [log.tau], signals([log], [log.tau])).all()


@pytest.mark.slow
def test_a_drive_at_its_limit_is_not_taken_for_exchanged_columns() -> None:
    """A joint that its drive cannot lift, while each joint moves in turn."""
    arm = load_arm("servo6")
    log = lifted_by_too_little(arm)
    found = gate(arm, [log])
    assert found.refusal is None
    assert any("at its torque limit nearly all the time" in check.detail for check in found.checks)
    assert gate(arm, [replace(log, q_cmd=np.full_like(log.q, np.nan))]).refusal is None
    in_degrees = gate(arm, [replace(log, dq=np.rad2deg(log.dq))]).refusal
    assert in_degrees is not None
    assert "speed" in in_degrees


def lifted_by_too_little(arm: Arm) -> Log:
    """Each joint moves in turn, 36 s in all. The shoulder's drive gives 6 of the 7.3 N m that hold the arm."""
    home, rate = np.array([0.0, -0.9, 1.0, -1.5, -1.5, 0.0]), 100
    plant = Plant(with_effect(arm, ArmEffect("torque_saturation", "shoulder_lift_joint", {"limit": 6.0})), arm, seed=3)
    plant.reset(home)
    t = np.arange(0, 6.0 * arm.n, 1 / rate)
    turn = (t[:, None] // 6.0 == np.arange(arm.n)) * np.pi / 3
    q, dq = home + 0.5 * np.sin(turn * t[:, None]), 0.5 * turn * np.cos(turn * t[:, None])
    states = []
    for k in range(len(t)):
        plant.command(q[k], dq[k], np.zeros(arm.n))
        plant.advance(1 / rate)
        states.append(plant.read())
    read = {name: np.array([getattr(x, name) for x in states]) for name in ("q", "dq", "tau")}
    none = np.full_like(q, np.nan)
    return Log(
        arm.joint_names, t=t, t_host=t, **read, current=none, temperature=none, q_cmd=q, dq_cmd=dq, tau_cmd=none, metadata={}
    )
