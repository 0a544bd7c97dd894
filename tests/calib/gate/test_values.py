"""A value that no arm can have, in any channel that an estimator may read, is refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wrong_data import base
from calib.gate import gate
from calib.gate.commands import read_as
from logs.log import COMMANDED, MEASURED


@pytest.mark.parametrize("value", [1.7e308, -1e10, np.inf])
@pytest.mark.parametrize("channel", [*MEASURED, *COMMANDED])
def test_a_value_that_no_arm_has_is_refused_with_its_channel(channel: str, value: float) -> None:
    of, log = base("servo6 sample")
    x = np.array(getattr(log, channel), dtype=float)
    x[62, 0] = value
    damaged = read_as(replace(log, **{channel: x}), ["as-recorded"])  # which does not make it a value
    refusal = gate(of, [damaged]).refusal
    where = f"{channel} of {log.joint_names[0]} reaches {abs(value):.3g} at {log.t[62]:.3f} s, and 1 of {len(log)} samples"
    assert where in (refusal or "")
    assert "the file is damaged" in (refusal or "")
