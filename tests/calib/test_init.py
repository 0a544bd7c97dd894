"""`calib init` finds an emulated robot by its dashboard server, a model file and adapters; its cell can be checked at once."""

from __future__ import annotations

import io
import ipaddress
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib import first_cell
from calib.main import main
from drivers import finding
from safety.collision import Clearance
from safety.plausible import check_plausible
from sim.arm import load_arm
from sim.cell import load_cell
from sim.emulated import open_emulator
from sim.urdf import urdf_text

HOST = f"127.{1 + os.getpid() % 250}.9.1"
NOBODY = f"127.{1 + os.getpid() % 250}.9.2"


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    monkeypatch.setattr(finding, "can_adapters", list)
    monkeypatch.setattr(finding, "own_networks", list)
    return tmp_path


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[str]:
    file = tmp_path / "hidden.toml"
    shipped = load_cell("emulated-ur10e").path.read_text(encoding="utf-8")
    file.write_text(shipped.replace("127.0.0.2", HOST), encoding="utf-8")
    emulator = open_emulator(load_cell(file), load_arm("ur10e"))
    emulator.start()
    yield HOST
    emulator.stop()


def test_a_robot_becomes_a_cell_that_can_be_checked(
    robot: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("ur10e\n"))
    assert main(["init", "--host", NOBODY, "--host", robot]) == 0
    printed = capsys.readouterr().out
    assert "UR10" in printed
    assert "calib go my-ur10e" in printed
    cell = load_cell("my-ur10e")
    assert (cell.table.arm, cell.table.driver) == ("ur10e", "ur_rtde")
    assert cell.table.options == {"host": robot, "serial": "20230000000"}
    assert cell.table.obstacles
    main(["check", "my-ur10e", "--seconds", "0.5", "--json"])
    checks = {c["name"]: c["ok"] for c in json.loads(capsys.readouterr().out)["checks"]}
    assert (checks["model"], checks["remote control"], checks["torque at rest"]) == (True, True, True)


def test_the_payload_of_the_first_cell_has_the_shape_that_a_plan_needs(tmp_path: Path) -> None:
    robot = finding.Robot("192.168.1.10", "5.11", "UR10e", "20230000000", ("ur10e",))
    text = first_cell.of_robot("my-ur", robot, "ur10e")
    file = tmp_path / "my-ur.toml"
    shown = re.sub(r"^# ?(?=[a-z\[]|$)", "", text[text.index("# [payload]") : text.index("# TODO list")], flags=re.MULTILINE)
    file.write_text(text + "\n" + shown.replace("mass = 0.0", "mass = 1.2"), encoding="utf-8")
    cell, arm = load_cell(file), load_arm("ur10e")
    assert cell.table.payload is not None
    check_plausible(cell=cell, arm=arm)
    clearance = Clearance(arm, cell)
    near = clearance.distances(np.array(first_cell.HOME)) - clearance.margin
    assert all(x > 0 for pair, x in zip(clearance.pairs, near, strict=True) if any("gripper" in name for name in pair))


def test_a_network_is_queried_only_where_it_was_given(robot: str, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    around = ipaddress.IPv4Network(f"{robot}/30", strict=False)
    assert main(["init", "--json"]) == 1
    monkeypatch.setattr(finding, "own_networks", lambda: [around])
    assert main(["init"]) == 1, "nobody agreed"
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\nur10e\n"))
    assert main(["init", "--name", "agreed"]) == 0
    assert main(["init", "--network", str(around), "--name", "given", "--arm", "ur10e"]) == 0
    assert load_cell("agreed").table.options == load_cell("given").table.options


@pytest.mark.parametrize("more", [[], ["--json"], ["--arm", "ur5e"]])
def test_an_arm_that_the_controller_leaves_open_is_chosen_by_nobody_else(
    more: list[str], robot: str, desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", "--host", robot, *more]) == 2
    assert re.search(r"which may be .*ur10e.*choose with --arm ARM", capsys.readouterr().err)
    assert not (desk / "configs").exists()
    assert main(["init", "--host", robot, "--arm", "ur10e", "--json"]) == 0


def test_nobody_there_is_reported_with_what_to_do(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", "--host", NOBODY]) == 1
    assert "dashboard server is enabled" in capsys.readouterr().err
    assert not (desk / "configs").exists()


def test_a_cell_is_never_overwritten(robot: str, desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", "--host", robot, "--arm", "ur10e"]) == 0
    before = (desk / "configs/cells/my-ur10e.toml").read_bytes()
    assert main(["init", "--host", robot, "--arm", "ur10e"]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert (desk / "configs/cells/my-ur10e.toml").read_bytes() == before


def test_a_model_file_becomes_a_mock_cell_that_can_be_checked(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (desk / "own.urdf").write_text(urdf_text(load_arm("ur5e")), encoding="utf-8")
    assert main(["init", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["next"] == ["calib", "check", "my-own"]
    assert "needed before any motion: ddq_max" in printed.err
    assert load_cell("my-own").table.driver == "mock"
    assert main(["check", "my-own", "--seconds", "0.1"]) == 0
    assert "not stated: ddq_max, jerk_max" in " ".join(capsys.readouterr().out.split())
    assert main(["plan", "own", "--cell", "my-own", "--quick"]) == 2
    assert "ddq_max of shoulder_pan_joint" in " ".join(capsys.readouterr().err.split())


def test_an_adapter_is_followed_by_the_scan_of_its_bus(
    desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(finding, "can_adapters", lambda: [finding.Adapter("socketcan", "can0", "CAN interface of the system")])
    assert main(["init"]) == 0
    assert "$ calib servo scan --interface socketcan --channel can0 --arm ARM --out" in capsys.readouterr().out


def test_nothing_there_names_the_mock(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (desk / "folder.xml").mkdir()
    (desk / "folder.urdf").mkdir()
    assert main(["init"]) == 1
    assert "calib go mock-ur10e" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong",
    [["--network", "10.0.0.0/8"], ["--network", "8.8.8.0/24"], ["--network", "robot"], ["--name", "../up", "--host", NOBODY]],
)
def test_wrong_options_are_refused(wrong: list[str], desk: Path) -> None:
    assert main(["init", *wrong]) == 2


def test_own_networks_are_private_and_narrow() -> None:
    for network in finding.own_networks():
        assert network.is_private
        assert network.num_addresses <= 256
