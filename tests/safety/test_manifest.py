"""What was approved is what runs: any single setting that is edited afterwards is refused, and named."""

from __future__ import annotations

import re
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from drivers.driver import DeviceInfo
from safety.approval import Approval, approve, check_approval
from safety.manifest import device_facts, manifest_of, require_same
from safety.plan import Motion, Plan, write_plan
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import ARM, CELL, MODEL

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
MORE = """torque_constant = [9.0, 9.0, 9.0, 9.0, 9.0, 9.0]
[prior]
mass = 0.02
[[effects]]
effect = "coulomb_friction"
joint = "j2"
parameters = { coulomb = 3.5 }
"""
CUBE = (
    "".join(f"v {x} {y} {z}\n" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)) + "f 1 3 4\nf 5 6 8\nf 1 2 6\nf 3 7 8\n"
)


def edits(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Path and changed value of every number and text of a table."""
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from edits(part, (*path, key))
    elif isinstance(value, bool):
        yield path, not value
    elif isinstance(value, int | float):
        yield path, value * (1 + 1e-9) + 1e-12
    else:
        yield path, f"{value}x"


def edited(table: dict[str, Any], path: tuple[Any, ...], value: Any) -> bytes:
    changed = tomllib.loads(tomli_w.dumps(table))
    part: Any = changed
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return tomli_w.dumps(changed).encode()


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "model.xml").write_text(MODEL.replace(' armature="0.4"/>', ' armature="0.4" frictionloss="3.5"/>', 2))
    head, rest = ARM.split("[limits]", 1)
    torque, tail = MORE.split("[prior]", 1)
    (tmp_path / "arm" / "arm.toml").write_text(f"{head}{torque}[limits]{rest}[prior]{tail}")
    (tmp_path / "wall.obj").write_text(CUBE)
    more = '[payload]\nmass = 1.0\ncom = [0.0, 0.0, 0.1]\n[motion]\nlatency = 0.01\n[[obstacles]]\nkind = "mesh"\nname = "wall"\nfile = "wall.obj"\n'
    (tmp_path / "cell.toml").write_text(CELL + more)
    return tmp_path


def world(place: Path, motion: Trajectory) -> tuple[Plan, Arm, Cell, Approval]:
    arm, cell = load_arm(place / "arm"), load_cell(place / "cell.toml")
    plan = write_plan(place / "plan", arm, [Motion("probe", "probe", motion)], cell)
    return plan, arm, cell, approve(plan, arm, cell, "operator", NOON)


def refusal_of(approval: Approval, plan: Plan, arm: Arm, cell: Cell) -> str:
    try:
        check_approval(approval, plan, arm, cell, NOON)
    except CalibError as refusal:
        return str(refusal)
    return ""


@pytest.mark.parametrize("file", ["arm/arm.toml", "cell.toml"])
def test_every_setting_that_is_edited_after_the_approval_is_refused(place: Path, motion: Trajectory, file: str) -> None:
    plan, arm, cell, approval = world(place, motion)
    check_approval(approval, plan, arm, cell, NOON)
    table, accepted, count = tomllib.loads((place / file).read_text()), [], 0
    for path, value in edits(table):
        (place / file).write_bytes(edited(table, path, value))
        try:
            changed = load_arm(place / "arm"), load_cell(place / "cell.toml")
        except CalibError:
            continue  # the file does not load at all
        count += 1
        refusal = refusal_of(approval, plan, *changed)
        if not re.search(r"another (arm|cell)\.|cannot be read", refusal):
            accepted.append((path, refusal))
    assert count > 15
    assert accepted == []


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        ("torque_noise = [0.5", "arm.sensors.torque_noise"), ("mass = 0.02", "arm.prior.mass"), ("torque_constant = [9.0", "arm.torque_constant"),
        ("rate = 500.0", "arm.sensors.rate"), ("dq_max = [2.0", "arm.dq_max"),
    ],
)  # fmt: skip
def test_the_field_is_named(place: Path, motion: Trajectory, edit: str, named: str) -> None:
    plan, _, cell, approval = world(place, motion)
    file = place / "arm" / "arm.toml"
    text = file.read_text()
    assert edit in text
    file.write_text(text.replace(edit, edit[:-1] + "1" if edit[-1] != "0" else edit[:-1] + "3", 1))
    with pytest.raises(SafetyStop, match=re.escape(f"another {named} ")):
        check_approval(approval, plan, load_arm(place / "arm"), cell, NOON)


def test_another_mesh_and_another_model_file_are_refused(place: Path, motion: Trajectory) -> None:
    plan, arm, cell, approval = world(place, motion)
    (place / "wall.obj").write_text(CUBE.replace("0.1", "0.2", 1))
    with pytest.raises(SafetyStop, match=r"another cell\.mesh wall\.obj"):
        check_approval(approval, plan, arm, load_cell(place / "cell.toml"), NOON)
    (place / "wall.obj").write_text(CUBE)
    other = place / "other"
    shutil.copytree(place / "arm", other)
    (other / "model.xml").write_text((other / "model.xml").read_text().replace('mass="12"', 'mass="12.1"'))
    with pytest.raises(SafetyStop, match=r"arm\.model\.mass"):
        check_approval(approval, plan, load_arm(other), cell, NOON)


def test_another_software_or_another_plan_is_refused(place: Path, motion: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, arm, cell, approval = world(place, motion)
    with pytest.raises(SafetyStop, match="another plan"):
        check_approval(approval, replace(plan, sha256="0" * 64), arm, cell, NOON)
    monkeypatch.setattr("safety.manifest.software_version", lambda: "9.9")
    with pytest.raises(SafetyStop, match="another software"):
        check_approval(approval, plan, arm, cell, NOON)


def test_a_field_that_is_new_or_gone_is_a_difference(place: Path, motion: Trajectory) -> None:
    plan, arm, cell, _ = world(place, motion)
    now = manifest_of(plan, arm, cell)
    for before in ({**now, "cell.motion.spare": "1"}, {k: v for k, v in now.items() if k != "cell.motion.latency"}):
        with pytest.raises(SafetyStop, match=r"cell\.motion\."):
            require_same(before, now, "approved")


def test_effects_that_are_gone_are_counted(place: Path, motion: Trajectory) -> None:
    plan, arm, cell, _ = world(place, motion)
    now = manifest_of(plan, arm, cell)
    effects = [{"effect": "payload", "joint": None, "parameters": {"mass": 1.0}}] * 2
    table = type(cell.table).model_validate(cell.table.model_dump(by_alias=True) | {"emulation": {"effects": effects}})
    none = cell.table.model_copy(update={"emulation": table.emulation.model_copy(update={"effects": []})})
    before, now = (manifest_of(plan, arm, replace(cell, table=t)) for t in (table, none))
    with pytest.raises(
        SafetyStop, match=r"another cell\.emulation\.effects \(2 in all\), now it is none.*`calib record --approve`"
    ):
        require_same(before, now, "approved")


def test_the_device_is_pinned_but_for_where_it_is_plugged_in() -> None:
    one = DeviceInfo("UR10e", "2024", "5.9", 500.0, extra={"calibration": "a", "bus": "/dev/ttyACM0"})
    require_same(device_facts(one), device_facts(replace(one, extra={"calibration": "a", "bus": "/dev/ttyACM1"})), "x")
    for changed, named in (
        (replace(one, serial="2025"), "serial"), (replace(one, firmware="5.10"), "firmware"),
        (replace(one, extra={"calibration": "b"}), "calibration"),
    ):  # fmt: skip
        with pytest.raises(SafetyStop, match=f"another {named} "):
            require_same(device_facts(one), device_facts(changed), "x")
