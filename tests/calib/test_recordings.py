"""A recording that was cut short is refused by the commands, and used when they are told to, with its loss in plain sight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.main import main
from calib.recordings import read_logs
from logs import Recorder, State
from sim.arm import load_arm
from sim.errors import BadLog
from sim.joint_state import JointState


@pytest.fixture
def aborted(tmp_path: Path) -> Path:
    """Forty samples of a UR5e, ended by a fault."""
    arm = load_arm("ur5e")
    path = tmp_path / "aborted.mcap"
    recorder = Recorder(path, arm.joint_names)
    for k in range(40):
        x = np.full(6, 0.001 * k)
        recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
    recorder.close("the emergency stop was pressed")
    return path


def test_it_is_refused_unless_told_otherwise(aborted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = load_arm("ur5e")
    with pytest.raises(BadLog, match=r"emergency stop was pressed.*--accept-partial"):
        read_logs([aborted], arm)
    log = read_logs([aborted], arm, accept_partial=True)[0]
    assert (len(log), log.state) == (40, State.ABORTED)
    assert "the emergency stop was pressed" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["identify", "validate"])
def test_the_commands_refuse_it(command: str, aborted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "ur5e", str(aborted), "--out", str(aborted.parent / "out")]) == 2
    told = capsys.readouterr().err
    assert "ended by a fault" in told
    main([command, "ur5e", str(aborted), "--accept-partial", "--out", str(aborted.parent / "out")])
    assert "ended by a fault (the emergency stop was pressed); record" not in capsys.readouterr().err
