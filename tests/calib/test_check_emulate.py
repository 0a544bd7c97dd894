"""The commands `check` and `emulate`, as an operator types them."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import pytest

from benchmarks.ur_cell import ur_cell
from calib.main import main
from sim.arm import load_arm
from sim.cell import load_cell
from sim.emulated import open_emulator


@pytest.fixture
def ur(tmp_path: Path) -> Path:
    return ur_cell(tmp_path / "there.toml", "127.0.5.1", options={"frame_timeout": 0.5})


def test_check_prints_every_check_as_a_table_and_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "mock-ur10e", "--seconds", "0.1"]) == 0
    out = capsys.readouterr().out
    assert "torque at rest" in out
    assert out.endswith("checks pass; 1 noted, without a verdict.\nnext: calib plan ur10e --cell mock-ur10e\n")
    assert main(["check", "mock-ur10e", "--seconds", "0.1", "--json"]) == 0
    reply = json.loads(capsys.readouterr().out)
    assert (reply["schema"], reply["ok"]) == ("check/1", True)


def test_a_failed_check_is_exit_code_1_with_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.toml"
    text = 'schema = "cell/1"\nname = "wrong"\narm = "ur10e"\ndriver = "mock"\nhome = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]\n'
    path.write_text(text + "[payload]\nmass = 12.0\ncom = [0.0, 0.0, 0.2]\n")
    assert main(["check", str(path), "--seconds", "0.1"]) == 1
    printed = capsys.readouterr()
    assert "check for a tool that the cell file does not declare" in printed.out
    assert "torque at rest" in printed.err


def test_what_plan_would_refuse_fails_the_check_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "loaded.toml"
    text = 'schema = "cell/1"\nname = "loaded"\narm = "ur10e"\ndriver = "mock"\nhome = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]\n'
    load = "[payload]\nmass = 1.2\ncom = [0.0, 0.0, 0.05]\n"
    path.write_text(text + load)
    assert main(["check", str(path), "--seconds", "0.1"]) == 1
    printed = capsys.readouterr()
    assert "payload.mass = 1.2 kg has no shape" in printed.out
    assert "settings: describe it with [[tool]], or" in printed.out
    refused = " ".join(printed.err.split())
    assert "settings: must be put right" in refused
    assert main(["plan", "ur10e", "--cell", str(path), "--out", str(tmp_path / "plan")]) == 3
    path.write_text('assume = ["payload-without-shape"]\n' + text + load)
    main(["check", str(path), "--seconds", "0.1", "--json"])
    checks = {check["name"]: check["ok"] for check in json.loads(capsys.readouterr().out)["checks"]}
    assert checks["settings"] is True


def test_a_controller_that_is_not_there_is_exit_code_4_with_what_to_do(ur: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(ur)]) == 4
    assert "start `calib emulate CELL`" in capsys.readouterr().err
    there = ur_cell(ur.parent / "tunnel.toml", "127.0.0.1")
    assert main(["check", str(there)]) == 4
    printed = capsys.readouterr().err
    assert "see that the robot is on" in printed
    assert "emulate" not in printed


def test_check_goes_over_the_wire(ur: Path, capsys: pytest.CaptureFixture[str]) -> None:
    emulator = open_emulator(load_cell(ur), load_arm("ur10e"))
    emulator.start()
    try:
        code = main(["check", str(ur), "--seconds", "0.5", "--json"])
    finally:
        emulator.stop()
    reply = json.loads(capsys.readouterr().out)
    by_name = {check["name"]: check["ok"] for check in reply["checks"]}
    assert by_name["remote control"] is True
    assert by_name["torque at rest"] is True
    assert code in (0, 1), "rate and clock depend on how busy this computer is"


def test_emulate_says_what_to_do_next_and_lets_things_go_wrong(ur: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", str(ur), "--seconds", "0.3", "--fault", "protective_stop@0.1", "--fault", "close@9"]) == 0
    out = capsys.readouterr().out
    assert "calib check" in out
    assert "0.1 s: protective_stop" in out
    assert "close" not in out


@pytest.mark.parametrize(
    ("fault", "word"), [("protectivestop@1", "did you mean 'protective_stop'"), ("close@soon", "not a time")]
)
def test_a_fault_that_is_none_is_exit_code_2(ur: Path, capsys: pytest.CaptureFixture[str], fault: str, word: str) -> None:
    assert main(["emulate", str(ur), "--fault", fault]) == 2
    assert word in " ".join(capsys.readouterr().err.split())


def test_a_cell_without_a_controller_to_emulate_is_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["emulate", "mock-ur10e"]) == 2
    assert "has no emulated controller" in capsys.readouterr().err


def test_check_turns_the_joints_where_that_is_requested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slow.toml"
    text = 'schema = "cell/1"\nname = "slow"\narm = "ur10e"\ndriver = "mock"\nhome = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]\n'
    path.write_text(text + "[options]\nrate = 100.0\n")
    assert main(["check", str(path), "--seconds", "0.1", "--move", "--yes", "--json"]) == 0
    names = [check["name"] for check in json.loads(capsys.readouterr().out)["checks"]]
    assert names[-7:] == [*(f"move {joint}" for joint in load_arm("ur10e").joint_names), "gravity torque"]


def test_the_joints_of_a_cell_with_an_arm_turn_only_after_the_typed_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ur_cell(tmp_path / "real.toml", "192.0.2.1")
    assert main(["check", str(path), "--move", "--yes"]) == 3
    monkeypatch.setattr("sys.stdin", io.StringIO("real is empty\n"))
    assert main(["check", str(path), "--move"]) == 3
    assert "a person must confirm at a terminal" in capsys.readouterr().err
    person, terminal = os.openpty()
    with open(terminal, encoding="utf-8") as stream:
        monkeypatch.setattr(stream, "readline", lambda: "yes\n")
        monkeypatch.setattr("sys.stdin", stream)
        assert main(["check", str(path), "--move"]) == 1
    os.close(person)
    assert "nothing was moved" in capsys.readouterr().err
