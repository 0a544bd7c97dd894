"""`calib import`: what it prints, what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.main import main
from logs import State, read_log

STEMS = ("actual_q", "actual_qd", "actual_current")


@pytest.fixture
def csv_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    lines = [",".join(["timestamp", *(f"{stem}_{j}" for stem in STEMS for j in range(6))])]
    rows = ([0.01 * k, *(0.2 * np.sin(0.02 * k + np.arange(18)))] for k in range(400))
    lines += [",".join(f"{value:.5f}" for value in row) for row in rows]
    file = tmp_path / "recorded.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_a_csv_file(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(csv_file)]) == 0
    out = capsys.readouterr().out
    assert "400 in 3.990 s, 100 Hz" in out
    path = Path(out.splitlines()[-1])
    assert path.parent.parent == Path("runs")
    log = read_log(path)
    assert (len(log), log.state) == (400, State.CLEAN)


def test_json_tells_the_loss(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv_file.write_text(csv_file.read_text()[:-20])
    assert main(["import", str(csv_file), "--out", "here", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "import/1"
    assert (told["samples"], told["state"], told["source_state"]) == (399, "aborted", "cut")
    assert told["measured"] == ["q", "dq", "current"]
    assert any("row 401" in sentence for sentence in told["left_out"])
    assert Path(told["log"]) == Path("here/recorded.mcap")


def test_the_arm_is_checked_before_anything_is_written(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv_file.write_text(csv_file.read_text().replace("actual_q_0", "nothing", 1))
    assert main(["import", str(csv_file), "--arm", "ur10e"]) == 2
    assert "columns actual_q_0 are missing" in capsys.readouterr().err
    assert not Path("runs").exists()


def test_a_file_that_is_not_there(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["import", "nothing.mcap"]) == 2
    assert "nothing.mcap" in capsys.readouterr().err
