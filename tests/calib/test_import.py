"""`calib import`: what it prints, writes and refuses."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io

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


def test_json_states_the_loss(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv_file.write_text(csv_file.read_text()[:-20])
    assert main(["import", str(csv_file), "--out", "here", "--json"]) == 0
    reply = json.loads(capsys.readouterr().out)
    assert reply["schema"] == "import/1"
    assert (reply["samples"], reply["state"], reply["source_state"]) == (399, "aborted", "cut")
    assert reply["measured"] == ["q", "dq", "current"]
    assert any("row 401" in sentence for sentence in reply["left_out"])
    assert Path(reply["log"]) == Path("here/recorded.mcap")


def test_the_arm_is_checked_before_anything_is_written(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv_file.write_text(csv_file.read_text().replace("actual_q_0", "nothing", 1))
    assert main(["import", str(csv_file), "--arm", "ur10e"]) == 2
    assert "columns actual_q_0 are missing" in capsys.readouterr().err
    assert not Path("runs").exists()


def test_a_file_that_is_not_there(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["import", "nothing.mcap"]) == 2
    assert "nothing.mcap" in capsys.readouterr().err


@pytest.fixture
def table_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A CSV file of another program: degrees, milliseconds, two joints and a column of text."""
    monkeypatch.chdir(tmp_path)
    t = 0.002 * np.arange(1500)
    q = 0.6 * np.sin(np.outer(t, [2.0, 3.1]))
    dq = 0.6 * np.array([2.0, 3.1]) * np.cos(np.outer(t, [2.0, 3.1]))
    lines = ["stamp_ms,pos_deg_1,pos_deg_2,dq1,dq2,tau1,tau2,phase"]
    for k in range(len(t)):
        row = [1e3 * t[k], *np.degrees(q[k]), *dq[k], *(4 * q[k])]
        lines.append(",".join([*(f"{value:.6f}" for value in row), "moving"]))
    file = tmp_path / "bench.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_a_guess_is_shown_and_wants_a_yes(table_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["import", str(table_file), "--out", "first"]) == 2
    printed = capsys.readouterr().err
    assert "pos_deg_1, pos_deg_2  [deg]" in printed
    assert "not used     phase" in printed
    assert "--map first/map.toml" in printed
    assert not list(Path("first").glob("*.mcap"))
    assert main(["import", str(table_file), "--map", "first/map.toml", "--out", "second"]) == 0
    log = read_log("second/bench.mcap")
    np.testing.assert_allclose(log.q[:, 0], 0.6 * np.sin(2.0 * log.t), atol=1e-6)
    assert log.metadata["column_map"] == Path("second/map.toml").read_text()


def test_a_yes_on_a_terminal(table_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class Person:
        def __init__(self, answer: str) -> None:
            self.answer = answer

        def isatty(self) -> bool:
            return True

        def readline(self) -> str:
            return self.answer + "\n"

    monkeypatch.setattr("sys.stdin", Person("n"))
    assert main(["import", str(table_file)]) == 2
    assert "nothing was imported" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", Person("y"))
    assert main(["import", str(table_file)]) == 0
    capsys.readouterr()
    assert main(["import", str(table_file), "--yes"]) == 0
    assert "accepted because of --yes: not used: phase" in capsys.readouterr().err


def test_options_say_what_columns_mean(table_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--column", "time=stamp_ms:ms", "--column", "q=pos_deg_2,pos_deg_1:deg", "--joints", "b,a"]
    assert main(["import", str(table_file), *options, "--out", "here"]) == 0
    log = read_log("here/bench.mcap")
    assert log.joint_names == ("b", "a")
    np.testing.assert_allclose(log.q[:, 1], 0.6 * np.sin(2.0 * log.t), atol=1e-6)
    assert not np.isfinite(log.tau).any()
    for wrong, words in (
        (["--column", "torque=tau1"], "write CHANNEL=NAME"),
        (["--column", "q=pos_deg_1,pos_deg_2:grad"], "'grad' is not a unit of q"),
        (["--column", "tau=tau1,tau2:Nn"], "known: N m, mN m"),
        (["--rate", "0"], "greater than or equal to 0.1"),
        (["--episode", "9" * 400], "less than or equal to 1000000"),
        (["--joints", "a,b,c", "--yes"], "positions of 2 joints"),
        (["--rate", "100", "--yes"], "a rate of 100 Hz contradicts column stamp_ms, whose 1500 times span 2.998 s (500 Hz)"),
        (["--rate", "100", "--column", "q=pos_deg_1,pos_deg_2:deg"], "contradicts column stamp_ms"),
        (
            ["--column", "time=stamp_ms:ms", "--column", "q=pos_deg_1,"],
            "joint 2 has no column; a log needs the position of every joint",
        ),
    ):
        assert main(["import", str(table_file), *wrong]) == 2
        assert words in capsys.readouterr().err


def test_a_matrix_is_named_once_and_speeds_are_guessed_by_their_positions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both are in degrees in a MAT file. No name gives the unit of the speeds, but they are the derivative of the positions."""
    monkeypatch.chdir(tmp_path)
    t = 0.002 * np.arange(1500)
    q, dq = 0.6 * np.sin(np.outer(t, [2.0, 3.1])), 0.6 * np.array([2.0, 3.1]) * np.cos(np.outer(t, [2.0, 3.1]))
    scipy.io.savemat("m.mat", {"time": t, "pos": np.degrees(q), "vel": np.degrees(dq), "torque": 4 * q})
    named = ["--column", "time=time", "--column", "q=pos:deg", "--column", "dq=vel:deg/s", "--column", "tau=torque:Nm"]
    for words, folder in ((named, "named"), (["--column", "q=pos:deg", "--yes"], "guessed")):
        assert main(["import", "m.mat", *words, "--out", folder]) == 0
        log = read_log(f"{folder}/m.mcap")
        np.testing.assert_allclose(log.dq, dq, atol=1e-9)
        np.testing.assert_allclose(log.tau, 4 * q, atol=1e-9)
    assert main(["import", "m.mat", "--column", "q=pose:deg", "--yes", "--out", "none"]) == 2
    assert "pose" in capsys.readouterr().err


def test_options_for_tables_are_refused_elsewhere(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(csv_file), "--rate", "100"]) == 2
    assert "states itself what it holds" in capsys.readouterr().err


def test_a_rate_that_changes_is_reported_and_no_sample_missed(table_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head, *rows = table_file.read_text().splitlines()
    kept = [row for k, row in enumerate(rows) if k < 2 * len(rows) // 3 or k % 2 == 0]
    table_file.write_text("\n".join([head, *kept]) + "\n")
    assert main(["import", str(table_file), "--yes", "--out", "here", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rate"] == pytest.approx(500.0)
    assert found["sampling"]["missing"] == 0
    assert any(sentence.startswith("the rate changes: 500 Hz up to ") for sentence in found["sampling"]["findings"])


def test_jitter_is_reported_and_the_stamps_are_kept(table_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(4)
    lines = table_file.read_text().splitlines()
    t = 0.002 * np.arange(len(lines) - 1)
    stamps = np.sort(1e3 * (t + 3e-4 * rng.standard_normal(len(t))))
    cells = [line.split(",") for line in lines]
    for row, stamp in zip(cells[1:], stamps, strict=True):
        row[0] = f"{stamp:.6f}"
    table_file.write_text("\n".join(map(",".join, cells)) + "\n")
    assert main(["import", str(table_file), "--yes", "--out", "here", "--json"]) == 0
    sampling = json.loads(capsys.readouterr().out)["sampling"]
    assert sampling["rebuilt"]
    assert sampling["jitter"] == pytest.approx(3e-4, rel=0.1)
    log = read_log("here/bench.mcap")
    assert np.std(np.diff(log.t)) < 1e-8
    np.testing.assert_allclose(log.t_host, (stamps - stamps[0]) * 1e-3, atol=2e-9)
    assert main(["import", str(table_file), "--yes", "--report"]) == 0
    out = capsys.readouterr().out
    assert "rebuilt" in out
    assert "dq over dq/dt of q" in out


@pytest.fixture
def servo_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, np.ndarray]:
    """A table of a servo whose signed load word was stored as unsigned, and the load in A."""
    monkeypatch.chdir(tmp_path)
    t = 0.004 * np.arange(1500)
    milliampere = np.rint(600 * np.sin(2.0 * t)).astype(int)
    q = 0.6 * np.sin(2.0 * t)
    rows = [f"{t[k]:.6f},{q[k]:.6f},{1.2 * np.cos(2.0 * t[k]):.6f},{milliampere[k] % 65536}" for k in range(len(t))]
    file = tmp_path / "servo.csv"
    file.write_text("\n".join(["t,q1,dq1,present_current_ma", *rows]) + "\n")
    return file, 1e-3 * milliampere


def test_a_signed_word_that_was_kept_unsigned_is_named_and_converted(
    servo_file: tuple[Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    file, current = servo_file
    stated = ["--column", "time=t", "--column", "q=q1", "--column", "current=present_current_ma:mA"]
    assert main(["import", str(file), *stated, "--out", "first"]) == 2
    error = capsys.readouterr().err
    assert "a signed 16-bit word stored as unsigned (65535 is -1)" in " ".join(error.split())
    assert "--assume current=int16" in error
    assert not list(Path("first").glob("*.mcap"))
    assert main(["import", str(file), *stated, "--assume", "current=int16", "--out", "second"]) == 0
    assert main(["import", str(file), "--map", "second/map.toml", "--out", "third"]) == 0
    assert main(["import", str(file), "--yes", "--out", "guessed"]) == 0
    for folder in ("second", "third", "guessed"):
        log = read_log(Path(folder) / "servo.mcap")
        np.testing.assert_allclose(log.current[:, 0], current, atol=1e-12)
        assert 'integer = "int16"' in log.metadata["column_map"]


def test_a_recording_without_a_torque_constant_is_imported(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """ur5e has none. Its currents are kept, and an unknown torque is no reason to refuse."""
    assert main(["import", str(csv_file), "--arm", "ur5e", "--assume", "as-recorded", "--out", "kept"]) == 0
    printed = capsys.readouterr().out
    assert "ur5e has no torque_constant" in " ".join(printed.split())
    assert np.isfinite(read_log(next(Path("kept").glob("*.mcap"))).current).all()
