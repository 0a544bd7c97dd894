"""Recordings in pieces: a large file unpacked to disk gives the same samples and errors as the reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs import Pieces, Recorder, open_pieces, read_log
from logs.log import CHANNELS
from logs.spool import spool
from sim.errors import BadLog
from sim.joint_state import JointState

JOINTS = ("a", "b")
NOTHING = np.full(2, np.nan)


def record(path: Path, seconds: float, end: str = "completed", back: int = -1) -> Path:
    rng = np.random.default_rng(0)
    with Recorder(path, JOINTS, {"arm": "two"}, reserve=1 << 16) as recorder:
        for k in range(round(seconds * 20)):
            q = np.array([np.sin(0.1 * k), np.cos(0.1 * k)])
            current = rng.standard_normal(2) if k % 3 == 0 else NOTHING
            t = 5 + (k - 2 if k == back else k) / 20
            recorder.write(JointState(t, t, q, NOTHING, 2 * q, current, NOTHING), q, q, NOTHING)
        recorder.close(end)
    return path


@pytest.mark.parametrize("names", [JOINTS, JOINTS[::-1]])
def test_what_is_unpacked_is_what_is_read(tmp_path: Path, names: tuple[str, ...]) -> None:
    file = record(tmp_path / "long.mcap", 400.0)
    log = read_log(file, names)
    whole, unpacked = Pieces(log), Pieces(spool(file, names, tmp_path / "spool"))
    assert len(whole) == len(unpacked) == 3
    assert whole.seconds == pytest.approx(unpacked.seconds)
    for a, b in zip(whole, unpacked, strict=True):
        for name in ("t", *CHANNELS):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-10, err_msg=name)
        assert (a.metadata, a.state, a.t_origin) == (b.metadata, b.state, b.t_origin)


def test_short_files_are_read_at_once(tmp_path: Path) -> None:
    file = record(tmp_path / "short.mcap", 10.0)
    pieces = open_pieces(file, JOINTS, tmp_path / "spool")
    assert len(pieces) == 1
    assert not (tmp_path / "spool").exists()


def test_damage_is_refused_as_by_the_reader(tmp_path: Path) -> None:
    file = record(tmp_path / "log.mcap", 60.0)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(bytes(data))
    with pytest.raises(BadLog) as caught:
        read_log(broken, JOINTS)
    with pytest.raises(BadLog) as again:
        spool(broken, JOINTS, tmp_path / "spool")
    assert str(again.value) == str(caught.value)


def test_a_sample_that_is_written_late_is_read_where_it_belongs(tmp_path: Path) -> None:
    file = record(tmp_path / "back.mcap", 20.0, back=100)
    whole, unpacked = read_log(file, JOINTS), spool(file, JOINTS, tmp_path / "spool")
    assert np.all(np.diff(unpacked.t) >= 0)
    np.testing.assert_array_equal(unpacked.log(0, unpacked.samples).q, whole.q)


def test_an_aborted_recording_is_refused_unless_accepted(tmp_path: Path) -> None:
    file = record(tmp_path / "aborted.mcap", 20.0, end="stopped by hand")
    with pytest.raises(BadLog, match="stopped by hand"):
        spool(file, JOINTS, tmp_path / "spool")
    assert spool(file, JOINTS, tmp_path / "spool", accept_partial=True).samples == 400


def test_joints_that_are_not_there_are_named(tmp_path: Path) -> None:
    file = record(tmp_path / "log.mcap", 5.0)
    with pytest.raises(BadLog, match=r"joint.* other"):
        spool(file, ("a", "other"), tmp_path / "spool")
