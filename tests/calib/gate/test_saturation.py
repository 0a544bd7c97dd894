"""A drive at its limit can look like exchanged columns: it is named beside them, and exchanged columns alone are not taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wrong_data import BASES, base, changes, family
from calib.gate import gate

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
