"""A recording that contains its own samples again is refused with both spans, however often they recur."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.wrong_data import base
from calib.gate import gate
from calib.gate.commands import require
from calib.gate.copies import twice
from logs import Pieces
from logs.log import SAMPLES, Log
from sim.errors import BadLog


def again(log: Log, times: int, noise: float = 0.0) -> Log:
    """The samples of `log` several times in one log, with new noise on the torques."""
    length = log.t[-1] - log.t[0] + log.period
    arrays = {name: np.concatenate([getattr(log, name)] * times) for name in SAMPLES}
    t = np.concatenate([log.t + k * length for k in range(times)])
    tau = arrays["tau"] + noise * np.random.default_rng(2).standard_normal(arrays["tau"].shape)
    return replace(log, **arrays | {"t": t, "t_host": np.full(len(t), np.nan), "tau": tau}, path=Path("rep.mcap"))


@pytest.mark.parametrize("times", [2, 3, 24])
def test_a_motion_copied_in_one_file_is_refused_with_its_spans(times: int) -> None:
    of, log = base("servo6 2")
    copied = again(log, times)
    pieces = list(Pieces(copied))
    with pytest.raises(BadLog, match="one recording was copied several times into one file: give it once") as error:
        require(of, pieces)
    end, begin = log.t[-1], log.t[-1] + log.period
    assert f"the samples from {log.t[0]:.1f} to {end:.1f} s appear again from {begin:.1f} to " in str(error.value)
    assert "as-recorded" not in str(error.value)


def test_pieces_of_one_file_that_are_copies_are_named_by_their_spans() -> None:
    _, log = base("servo6 2")
    two = again(log, 2)
    found = twice([two.part(slice(0, len(log))), two.part(slice(len(log), None))])
    assert not found.ok
    assert found.detail.startswith(f"rep.mcap: the samples from 0.0 to {log.t[-1]:.1f} s appear again from ")


def test_a_motion_that_an_arm_repeats_is_no_copy() -> None:
    of, log = base("servo6 2")
    noisy = again(log, 3, 1e-6)
    assert gate(of, [noisy]).refusal is None
    assert twice([log]).ok
