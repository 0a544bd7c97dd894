"""The parameter table and the summary count apply the same rule of identifiability."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.identification.base_fit import Options
from calib.identification.estimates import is_identified
from calib.identification.identify import identify
from calib.identification.outcome import parameter_table
from logs.log import Log
from sim.new_arm import drive_arm

INERTIA = 0.03


def test_a_free_shafts_reflected_inertia_is_identified_in_the_table_as_in_the_summary(tmp_path: Path) -> None:
    """A drive without stated limits. The shaft's inertia is known, so reflected inertia is as identified as their sum."""
    arm = drive_arm("bench", "joint1", None, False, tmp_path)
    rng, t = np.random.default_rng(1), np.arange(0.0, 20.0, 0.004)
    w, phase = 2 * np.pi * np.array([0.31, 0.73, 1.1]), rng.uniform(0, 2 * np.pi, 3)
    size = np.array([1.2, 0.5, 0.3])
    q = np.sin(np.outer(t, w) + phase) @ size
    dq = (np.cos(np.outer(t, w) + phase) * w) @ size
    ddq = -(np.sin(np.outer(t, w) + phase) * w**2) @ size
    tau = INERTIA * ddq + 0.05 * dq + 0.5 * np.tanh(dq / 0.01) + 0.02 * rng.standard_normal(len(t))
    nan = np.full((len(t), 1), np.nan)
    log = Log(arm.joint_names, t, t, q[:, None], dq[:, None], tau[:, None], nan, nan, nan, nan, nan)
    result = identify(arm, [log], options=Options()).result
    of_sum, alone = result.estimate("Izz_1 + Ia_1"), result.estimate("Ia_1")
    assert abs(alone.value - INERTIA) < 0.1 * INERTIA
    assert of_sum.identifiable
    assert alone.identifiable
    assert not result.estimate("m_1").identifiable
    headers, rows = parameter_table(result)
    assert "not identifiable" not in dict(zip(headers, rows[0], strict=True))["reflected inertia [kg m^2]"]


def test_data_identify_what_they_narrow_or_fix() -> None:
    assert is_identified(1.0, 0.2, 1.0)
    assert is_identified(1.0, 0.09, 0.1)
    assert not is_identified(1.0, 0.35, 1.0)
    assert not is_identified(0.0, np.inf, 0.1)
