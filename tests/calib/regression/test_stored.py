"""Stored results of a recording are used again only for the same samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded
from calib.regression.stored import digest_of
from sim.arm import load_arm


@pytest.mark.parametrize("channel", ["t", "q", "dq", "tau", "current", "temperature"])
def test_a_digest_changes_with_every_channel_that_is_used(channel: str) -> None:
    arm = load_arm("servo6")
    log = recorded(arm, fourier_motion(arm, 3, 2.0, 100.0), 3)
    other = np.nan_to_num(getattr(log, channel)) + 1.0
    assert digest_of(log) == digest_of(replace(log))
    assert digest_of(replace(log, **{channel: other})) != digest_of(log)
