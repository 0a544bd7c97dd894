"""Capturing a session does not disturb it; the capture is anonymous and plays back as a controller."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.main import main
from drivers import open_driver
from drivers.preflight import preflight
from sim.arm import Arm
from sim.capture import read_capture
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.captured import CapturedUr
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import PLAYING
from sim.errors import BadLog
from tests.drivers.ur_rtde.conftest import wait_for


@pytest.mark.parametrize("polyscope", ["10.14.0", *(pytest.param(v, marks=pytest.mark.slow) for v in ("5.25.1", "3.15.4"))])
def test_a_session_is_captured_and_played_back(
    cell: Callable[..., Cell], arm: Arm, tmp_path: Path, polyscope: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cell(polyscope=polyscope).path
    path.write_text(path.read_text().replace('serial = "20230000000"\n', "robot_api_port = 8080\n"))
    table = load_cell(path)
    emulator = open_emulator(table, arm)
    assert isinstance(emulator, UrEmulator)
    emulator.robot.serial = "20234567891"
    emulator.start()
    try:
        emulator.do(lambda: emulator.robot.play("secret-project.urp"))
        wait_for(lambda: emulator.robot.runtime_state == PLAYING, "the program")
        assert main(["capture", str(path), "--seconds", "1.5", "--out", str(tmp_path / "run"), "--json"]) == 0
        assert (emulator.robot.runtime_state, emulator.robot.ended) == (PLAYING, [])
        assert not emulator.robot.claims
        there = checked(table, arm)
    finally:
        emulator.stop()
    file = Path(json.loads(capsys.readouterr().out)["file"])
    text = gzip.decompress(file.read_bytes()).decode()
    for name in ("secret-project", "20234567891", emulator.host):
        assert name not in text
        assert name.encode().hex() not in text
    again = CapturedUr(file, emulator.host)
    again.start()
    try:
        here = checked(table, arm)
    finally:
        again.stop()
    changed = {"serial", "program", "rate", "device clock"}
    assert {k: v for k, v in here.items() if k not in changed} == {k: v for k, v in there.items() if k not in changed}
    assert here["program"] is False


def checked(table: Cell, arm: Arm) -> dict[str, bool | None]:
    driver = open_driver(table, arm)
    try:
        driver.info = driver.inspect()
        return {check.name: check.ok for check in preflight(driver, table, 0.1)}
    finally:
        driver.close()


def test_only_a_ur_is_captured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "mock-ur10e"]) == 2
    assert "only a session with a UR" in capsys.readouterr().err


@pytest.mark.parametrize(
    "lines", [[], ["{}"], ['{"schema": "capture/2"}'], ['{"schema": "capture/1"}', "{"], ['{"schema": "capture/1"}', '{"t": 0}'],
              ['{"schema": "capture/1"}', '{"t": 0, "channel": "rtde", "from": "<", "hex": "0"}']],
)  # fmt: skip
def test_a_file_that_is_no_capture_is_refused(tmp_path: Path, lines: list[str]) -> None:
    file = tmp_path / "x.jsonl.gz"
    file.write_bytes(gzip.compress("\n".join(lines).encode()))
    with pytest.raises(BadLog, match=r"not part of a capture"):
        read_capture(file)
    file.write_bytes(b"nothing compressed")
    with pytest.raises(BadLog):
        read_capture(file)


def test_a_capture_with_a_damaged_byte_is_refused_or_read(tmp_path: Path) -> None:
    """A flipped byte of a compressed file is no OSError, ValueError or EOFError, but an error of zlib."""
    file, rng = tmp_path / "x.jsonl.gz", np.random.default_rng(5)
    message = '{"t": 0.5, "channel": "rtde", "from": "<", "hex": "%s"}'
    lines = ['{"schema": "capture/1"}', *(message % rng.bytes(20).hex() for _ in range(20))]
    whole = gzip.compress("\n".join(lines).encode())
    refused = 0
    for place in range(10, len(whole)):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            read_capture(file)
        except BadLog:
            refused += 1
    assert refused > 0.9 * len(whole)


def test_a_folder_that_is_taken_is_refused_before_anybody_listens(
    cell: Callable[..., Cell], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    listened = list[int]()
    monkeypatch.setattr("drivers.ur_rtde.capturing.captured", lambda *a: listened.append(1))
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "a").write_text("x")
    assert main(["capture", str(cell().path), "--out", str(tmp_path / "taken")]) == 2
    assert listened == []
