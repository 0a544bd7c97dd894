"""The command servo over emulated drives, as the operator types it."""

from __future__ import annotations

import json
import os
import re
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
    """A cell file on a bus in memory, and its emulated drives."""
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
