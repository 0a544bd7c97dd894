"""A program that runs on the controller belongs to somebody: neither inspecting the robot nor taking control ends it."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from drivers.preflight import preflight
from drivers.ur_rtde.command_process import CommandProcess
from sim.cell import Cell
from sim.emulated.ur.robot import PAUSED, PLAYING, STOPPED
from sim.errors import DeviceError
from tests.drivers.ur_rtde.conftest import Pair, rests, stream, wait_for

NAME = "palletise.urp"


def test_looking_leaves_a_program_that_plays_alone_and_names_it(pair: Pair, cell: Callable[..., Cell]) -> None:
    emulator, driver = pair()
    emulator.inject("program_played")
    wait_for(lambda: emulator.robot.runtime_state == PLAYING, "the program")
    driver.info = driver.inspect()
    found = {check.name: check for check in preflight(driver, cell(), 0.2)}
    driver.close()
    assert found["program"].ok is False
    assert NAME in found["program"].detail
    assert (emulator.robot.runtime_state, emulator.robot.program_name, emulator.robot.ended) == (PLAYING, NAME, [])


@pytest.mark.parametrize(("fault", "state"), [("program_played", PLAYING), ("program_paused", PAUSED)])
@pytest.mark.parametrize("polyscope", ["5.25.1", "3.15.4", "10.12.0"])
def test_taking_control_refuses_and_leaves_it_alone(pair: Pair, polyscope: str, fault: str, state: int) -> None:
    emulator, driver = pair(polyscope=polyscope)
    emulator.inject(fault)
    wait_for(lambda: emulator.robot.runtime_state == state, "the program")
    with pytest.raises(DeviceError, match="left alone"):
        driver.connect()
    assert (emulator.robot.runtime_state, emulator.robot.program_name, emulator.robot.ended) == (state, NAME, [])


def test_a_program_that_begins_between_the_checks_and_the_upload_is_left_alone(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, driver = pair()
    start = CommandProcess.start

    def begins(self: CommandProcess) -> None:
        start(self)  # everything up to the upload
        emulator.inject("program_played")
        wait_for(lambda: emulator.robot.runtime_state == PLAYING, "the program")
        time.sleep(0.02)

    monkeypatch.setattr(CommandProcess, "start", begins)
    with pytest.raises(DeviceError, match="it began just now"):
        driver.connect()
    time.sleep(0.3)
    assert (emulator.robot.runtime_state, emulator.robot.program_name, emulator.robot.ended) == (PLAYING, NAME, [])
    assert not emulator.robot.claims


def test_leaving_does_not_end_a_program_that_took_over(pair: Pair) -> None:
    emulator, driver = pair()
    driver.connect()
    stream(driver, 0.1)
    emulator.inject("program_played")
    wait_for(lambda: emulator.robot.program_name == NAME, "the program")
    driver.stop()
    driver.close()
    wait_for(lambda: rests(emulator), "standstill")
    assert (emulator.robot.runtime_state, emulator.robot.program_name) == (PLAYING, NAME)


def test_what_is_uploaded_is_what_ur_rtde_uploads(pair: Pair) -> None:
    emulator, driver = pair()
    seen: list[str] = []
    upload = emulator.robot.upload
    emulator.robot.upload = lambda text: (seen.append(text), upload(text))[1]  # type: ignore[assignment,method-assign]
    with driver:
        assert len(seen) == 1
    assert seen[0].startswith("def rtde_control():\n")
    assert "# float register offset\n0" in seen[0]
    assert emulator.robot.runtime_state == STOPPED
