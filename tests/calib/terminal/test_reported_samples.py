"""A command that reads a recording directly reports what is wrong with its samples."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import logs
from calib.terminal.recordings import read_logs, read_pieces
from logs.convert import write_log
from sim.arm import load_arm

SAMPLES = Path(logs.__file__).parent / "samples"


@pytest.mark.parametrize("what", ["jitter", "repeats", "lost", "halved", "nothing"])
def test_samples_that_an_import_would_put_right_are_reported(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Late stamps, repeated samples, losses and a change of rate are reported."""
    log, rng = logs.read_log(SAMPLES / "servo6_excitation.mcap"), np.random.default_rng(1)
    k = np.arange(len(log))
    t = log.t
    if what == "repeats":
        k[5::14] -= 1
    if what == "jitter":
        t = np.sort(t + 2e-3 * rng.standard_normal(len(log)))
    if what == "lost":
        k = k[rng.random(len(k)) > 0.01]
    if what == "halved":
        k = k[(k < len(k) // 2) | (k % 2 == 0)]
    t = t if len(t) == len(k) else t[k]
    nothing = np.full((len(k), log.n), np.nan)
    names = ("q", "dq", "tau", "temperature")
    changed = replace(log, t=t, t_host=nothing[:, 0], q_cmd=nothing, dq_cmd=nothing, **{n: getattr(log, n)[k] for n in names})
    write_log(changed, tmp_path / "log.mcap", "clean", {"arm": "servo6"})
    read_logs([tmp_path / "log.mcap"], load_arm("servo6"))
    read_pieces([tmp_path / "log.mcap"], load_arm("servo6"), tmp_path)
    printed = " ".join(capsys.readouterr().err.split())
    assert printed.count("`calib import` corrects what can be") == (2 if what in ("jitter", "repeats") else 0)
    assert ("repeat the one before" in printed) == (what == "repeats")
    assert ("the clock was rebuilt" in printed) == (what == "jitter")
    lines = [line.partition("log.mcap: ")[2] for line in printed.split("calib: ")[1:]]
    if what == "lost":
        assert len(lines) == 2
        assert all(re.match(r"\d+ samples are missing in \d+ places", line) for line in lines)
    if what == "halved":
        assert len(lines) == 2
        assert all(line.startswith("the rate changes: ") for line in lines)
    assert what != "nothing" or not lines
