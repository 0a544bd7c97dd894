"""The command `servo` on emulated drives, as an operator types it."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.main import main
from sim.arm import load_arm
from sim.cell import load_cell
from sim.emulated import open_emulator
from sim.emulated.can import CanEmulator
from sim.resources import shipped_configs

JOINT = "elbow_joint"
LOST = 0xD


@pytest.fixture
def there(tmp_path: Path) -> Iterator[tuple[str, CanEmulator]]:
    """A cell file for a bus in memory, and its emulated drives."""
    text = (shipped_configs() / "cells" / "emulated-servo6.toml").read_text()
    text = text.replace('interface = "slcan"', 'interface = "virtual"')
    path = tmp_path / "there.toml"
    path.write_text(re.sub(r"channel = .*", f'channel = "servo-command-{os.getpid()}-{tmp_path.name}"', text))
    cell = load_cell(path)
    emulator = open_emulator(cell, load_arm("servo6"))
    assert isinstance(emulator, CanEmulator)
    emulator.start()
    yield str(path), emulator
    emulator.stop()


def test_every_drive_is_looked_at_and_none_is_switched_on(
    there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str]
) -> None:
    path, emulator = there
    assert main(["servo", path, "--json"]) == 0
    drives = json.loads(capsys.readouterr().out)["drives"]
    assert [d["serial"] for d in drives] == [f"41000{j}" for j in range(1, 7)]
    assert [d["on"] for d in drives] == [False] * 6
    assert not emulator.bus.body.live.any()


def test_a_latched_error_is_exit_code_1_until_it_is_cleared(
    there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str]
) -> None:
    path, emulator = there
    emulator.bus.servos[2].error = LOST
    assert main(["servo", path, JOINT]) == 1
    assert "communication lost" in capsys.readouterr().err
    assert main(["servo", path, JOINT, "--clear"]) == 0
    assert emulator.bus.servos[2].error == 0


def test_a_watchdog_of_zero_is_one_that_is_off(there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str]) -> None:
    path, emulator = there
    assert main(["servo", path, JOINT]) == 0
    out = capsys.readouterr().out
    assert re.search(r"elbow_joint +410003 .* off ", out)
    assert "before any motion it is set to that of the cell file" in out
    emulator.bus.servos[2].registers[9] = 2000  # times 50 us
    assert main(["servo", path, JOINT]) == 0
    out = capsys.readouterr().out
    assert re.search(r"elbow_joint +410003 .* 100 ", out)
    assert "before any motion" not in out


def test_torque_goes_off_only_for_an_arm_that_is_carried(
    there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str]
) -> None:
    path, emulator = there
    emulator.bus.servos[2].switch(True)
    assert main(["servo", path, JOINT, "--off"]) == 4
    assert "--supported" in capsys.readouterr().err
    assert emulator.bus.servos[2].on
    assert main(["servo", path, JOINT, "--off", "--supported"]) == 0
    assert not emulator.bus.servos[2].on


@pytest.mark.parametrize("orders", [["--clear"], [JOINT, "--clear", "--off"]], ids=["no joint", "two orders"])
def test_an_order_is_one_and_for_one_joint(
    there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str], orders: list[str]
) -> None:
    assert main(["servo", there[0], *orders]) == 2
    assert "for one joint" in capsys.readouterr().err


def test_an_arm_without_servo_drives_is_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["servo", "mock-ur10e"]) == 2
    assert "no servo drives" in capsys.readouterr().err


def bus_of(path: str) -> list[str]:
    """Options of `calib servo scan` for the bus of a cell file."""
    options = load_cell(path).table.options
    return ["--interface", options["interface"], "--channel", options["channel"]]


def test_a_scan_reports_every_drive(there: tuple[str, CanEmulator], capsys: pytest.CaptureFixture[str]) -> None:
    path, emulator = there
    emulator.bus.servos[2].error = LOST
    assert main(["servo", "scan", *bus_of(path), "--json"]) == 1
    printed = capsys.readouterr()
    drives = json.loads(printed.out)["drives"]
    assert [(d["protocol"], d["node"], d["serial"], d["fd"]) for d in drives] == [
        ("damiao", n, f"41000{n}", False) for n in range(1, 7)
    ]
    assert "communication lost" in printed.err
    assert not emulator.bus.body.live.any()


def test_a_scan_writes_the_cell_that_hands_show(
    there: tuple[str, CanEmulator], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    turns = iter([(5, 1), (4, -1), (4, 1), (3, 1), (2, -1), (1, 1), (0, 1)])
    monkeypatch.setattr("drivers.can_servo.by_hand.ByHand.turned", lambda hands: next(turns))
    out = tmp_path / "my-arm.toml"
    assert main(["servo", "scan", *bus_of(there[0]), "--arm", "servo6", "--out", str(out)]) == 0
    assert "that was damiao node 5, which is already shoulder_lift_joint" in capsys.readouterr().err
    servos = load_cell(out).table.options["servos"]
    assert [(s["node"], s["feedback"], s["direction"]) for s in servos] == [
        (6, 22, 1), (5, 21, -1), (4, 20, 1), (3, 19, -1), (2, 18, 1), (1, 17, 1),
    ]  # fmt: skip
    assert main(["check", str(out)]) == 2
    assert "needs kp and kd above zero" in capsys.readouterr().err
    assert main(["servo", "scan", *bus_of(there[0]), "--arm", "servo6", "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_scan_makes_the_folder_of_its_cell_and_names_an_arm_by_its_path(
    there: tuple[str, CanEmulator], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turns = iter([(5, 1), (4, -1), (3, 1), (2, -1), (1, 1), (0, 1)])
    monkeypatch.setattr("drivers.can_servo.by_hand.ByHand.turned", lambda hands: next(turns))
    shutil.copytree(shipped_configs() / "arms" / "servo6", tmp_path / "arms of mine" / "servo6")
    out = tmp_path / "configs" / "cells" / "my-arm.toml"
    arm = tmp_path / "arms of mine" / "servo6"
    assert main(["servo", "scan", *bus_of(there[0]), "--arm", str(arm), "--out", str(out)]) == 0
    assert Path(load_cell(out).table.arm).samefile(arm)


@pytest.mark.parametrize(("words", "code", "message"), [
    (["--interface", "virtual", "--channel", "x", "--arm", "servo6", "--out", "my arm.toml"], 2, "must be letters"),
    (["--interface", "virtual", "--channel", "nobody-there"], 4, "no drive answered at 1000000 bit/s"),
    (["--interface", "nonsense", "--channel", "x"], 2, "python-can has no interface of that name"),
    (["--interface", "virtual", "--channel", "x", "--bitrate", "7"], 2, "bitrate = 7"),
    (["--interface", "virtual", "--channel", "x", "--bus", "port"], 2, "not KEY=VALUE"),
    (["--interface", "virtual", "--channel", "x", "--arm", "servo6"], 2, "belong together"),
])  # fmt: skip
def test_a_scan_that_cannot_be(words: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["servo", "scan", *words]) == code
    assert message in capsys.readouterr().err
