"""Faulty files are refused with file, place, value, rule and remedy, or read as requested."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.main import main
from logs import Recorder, read_log
from sim.arm import load_arm
from sim.arm_folder import write_arm
from sim.joint_state import JointState

SAMPLES = Path(__file__).resolve().parents[2] / "logs" / "samples"
JOINTS = tuple(f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))


def table() -> list[list[str]]:
    return [line.split(",") for line in (SAMPLES / "ur10e_ur_rtde.csv").read_text().splitlines()]


def written(rows: list[list[str]]) -> Path:
    Path("log.csv").write_text("".join(",".join(row) + "\n" for row in rows))
    return Path("log.csv")


def changed(row: int, column: str, value: str) -> Path:
    rows = table()
    rows[row][rows[0].index(column)] = value
    return written(rows)


def truncated() -> Path:
    text = (SAMPLES / "ur10e_ur_rtde.csv").read_text().splitlines(keepends=True)
    Path("log.csv").write_text("".join(text[:500]) + text[500][:60])
    return Path("log.csv")


def without(prefix: str) -> Path:
    rows = table()
    keep = [k for k, name in enumerate(rows[0]) if not name.startswith(prefix)]
    return written([[row[k] for k in keep] for row in rows])


def renamed(old: str, new: str) -> Path:
    rows = table()
    rows[0] = [name.replace(old, new) for name in rows[0]]
    return written(rows)


def of_bytes(name: str, content: bytes) -> Path:
    Path(name).write_bytes(content)
    return Path(name)


def mcap(names: tuple[str, ...] = JOINTS, back: bool = False, bad: float = 0.0) -> Path:
    """One second of motion at 100 Hz, written by the package's recorder."""
    path = Path("log.mcap")
    nan = np.full(len(names), np.nan)
    with Recorder(path, names, {"arm": "servo6"}) as recorder:
        for k in range(100):
            t = 0.01 * (k - 40 if back and k > 60 else k)
            q = 0.1 * np.sin(np.arange(1, len(names) + 1) * t)
            if k == 50:
                q[2] += bad
            recorder.write(JointState(5.0 + 0.01 * k, 5.0 + t, q, nan, q, nan, nan))
    return path


# fault of the file: how it is made, and the words that the error must contain
REFUSED = {
    "a value of 1e279": (
        lambda: changed(300, "actual_q_2", "1e279"),
        ["log.csv", "row 301", "actual_q_2", "1e+279", "rule", "--accept-partial"],
    ),
    "NaN": (
        lambda: changed(300, "actual_q_2", "nan"),
        ["log.csv", "row 301", "actual_q_2", "'nan'", "finite", "--accept-partial"],
    ),
    "a jump": (lambda: changed(300, "actual_q_2", "2.5"), ["log.csv", "row 301", "actual_q_2", "2.5 rad", "100 rad/s"]),
    "a word": (lambda: changed(300, "actual_current_1", "off"), ["log.csv", "row 301", "actual_current_1", "'off'"]),
    "missing columns": (lambda: without("actual_current"), ["log.csv", "row 1", "actual_current_0", "missing", "record with"]),
    "no clock": (lambda: without("timestamp"), ["log.csv", "row 1", "timestamp", "missing", "record with"]),
    "a truncated last row": (truncated, ["log.csv", "row 501", "columns", "--accept-partial"]),
    "other names": (lambda: renamed("actual_q_3", "actual_q_7"), ["log.csv", "row 1", "actual_q_3", "missing"]),
    "time running backwards": (
        lambda: written(table()[:400] + table()[300:]),
        ["log.csv", "sample 399", "runs back from", "must not be set", "record it again"],
    ),
    "an empty file": (lambda: of_bytes("log.csv", b""), ["log.csv", "empty", "record it again"]),
    "a header alone": (lambda: written(table()[:1]), ["log.csv", "row 2", "no samples", "record it again"]),
    "no format at all": (lambda: of_bytes("log.csv", bytes(range(256)) * 8), ["log.csv", "byte 0", "MCAP with ROS 2"]),
    "no MCAP under its name": (lambda: of_bytes("log.mcap", b"hello\n"), ["log.mcap", "not a .mcap file", "copy it again"]),
    "an empty MCAP": (lambda: of_bytes("log.mcap", b""), ["log.mcap", "empty", "record it again"]),
    "an MCAP cut in the middle": (
        lambda: of_bytes("log.mcap", (SAMPLES / "servo6_excitation.mcap").read_bytes()[:70_000]),
        ["log.mcap", "byte", "cut", "--accept-partial", "calib import"],
    ),
    "an MCAP of other joints": (lambda: mcap(("knee_joint", *JOINTS[1:])), ["log.mcap", "shoulder_pan_joint", "knee_joint"]),
    "an MCAP whose time runs backwards": (lambda: mcap(back=True), ["log.mcap", "sample 61", "runs back from"]),
    "an MCAP with NaN": (lambda: mcap(bad=np.nan), ["log.mcap", "elbow_joint", "nan", "finite"]),
    "an MCAP with 1e279": (lambda: mcap(bad=1e279), ["log.mcap", "elbow_joint", "1e+279", "rule"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_the_command_refuses(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    make, words = REFUSED[case]
    path = make()
    before = path.read_bytes()
    arm = "ur10e" if path.suffix == ".csv" else "servo6"
    assert main(["identify", arm, str(path), "--out", "found"]) == 2
    printed = capsys.readouterr().err
    sentence = printed.splitlines()[-1]
    assert [word for word in words if word not in sentence] == []
    assert "Traceback" not in printed
    assert path.read_bytes() == before
    assert not Path("found", "arm").exists()


def test_columns_in_another_order_are_the_same_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = written([row[::-1] for row in table()])
    there, expected = read_log(path), read_log(SAMPLES / "ur10e_ur_rtde.csv")
    for name in ("t", "q", "dq", "current"):
        np.testing.assert_array_equal(getattr(there, name), getattr(expected, name))


def test_joints_in_another_order_are_the_same_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    turned = read_log(mcap(JOINTS[::-1]), JOINTS)
    np.testing.assert_allclose(turned.q[10], 0.1 * np.sin(np.arange(6, 0, -1) * 0.1), atol=1e-12)


def test_a_gap_is_reported_and_nothing_reaches_across(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(table()[:301] + table()[321:])
    assert main(["validate", "ur10e", str(path), "--no-forward", "--out", "found"]) == 0
    assert "1 gap of more than 2.5 sample periods" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["plan", "ur10e", "--configs", "nowhere"], "'--configs': dir 'nowhere' does not exist"),
        (["plan", "ur10e", "--configs", "file"], "'--configs': dir 'file' is a file"),
        (["plan", "ur10e", "--discriminate", "folder"], "folder/diagnosis.json: cannot be read (No such file or directory)"),
        (["runs", "--runs", "file"], "file: is not a folder"),
        (["identify", "ur10e", "link.mcap"], "link.mcap: is a link to gone.mcap, which does not exist"),
        (["identify", "ur10e", "lonk.mcap"], "there is no recording 'lonk.mcap'; give the path"),
        (["identify", "ur10e", "x" * 300 + ".mcap"], "x.mcap'; give the path"),
        (["identify", "x" * 300 + ".mcap"], "x.mcap'; give the path"),
        (["identify", "ur10e", "loop.mcap"], "loop.mcap: is a link to loop.mcap, which does not exist"),
        (["plan", "ur10e", "--home", "1e9,0,0,0,0,0"], "give a posture inside them with --home"),
    ],
)
def test_a_path_that_leads_nowhere_is_named(
    arguments: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    of_bytes("file", b"")
    Path("link.mcap").symlink_to("gone.mcap")
    Path("loop.mcap").symlink_to("loop.mcap")
    assert main(arguments) == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]


def test_an_arm_that_no_run_takes_is_refused_before_it_is_planned_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arm = load_arm("ur10e")
    write_arm(Path("weak"), replace(arm, tau_max=np.full(6, 0.005)), name="weak")
    assert main(["plan", "weak"]) == 3
    remedy = 'write assume = ["unusual-tau_max"] at the top of a cell file, and name it with --cell'
    assert remedy in " ".join(capsys.readouterr().err.split())
