"""A watch from the first reading to the last: what it survives, and what it writes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.watch.session import watch
from calib.watch.source import Source
from logs import read_log
from sim.arm import Arm
from sim.joint_state import JointState


def source(arm: Arm, readings: Iterable[JointState], **changes: Any) -> Source:
    return replace(Source("a-cell", arm, 200.0, iter(readings), lambda: None, live=True), **changes)


@pytest.mark.parametrize("samples", [False, True])
@pytest.mark.parametrize("at", [0, 900])
def test_a_reading_without_an_instant_is_an_event_and_not_the_end(
    tmp_path: Path, servo6: Arm, calm: list[JointState], at: int, samples: bool
) -> None:
    readings = [replace(s, t_device=np.nan) if k == at else s for k, s in enumerate(calm[:1200])]
    found = watch(source(servo6, readings), tmp_path, samples=samples)
    assert found.fault is None
    assert [e.message.split(";")[0] for e in found.events] == ["device time is nan"]
    assert found.picture.samples == 1200
    assert len(read_log(tmp_path / "watch.mcap")) == (1199 if samples else 6)
