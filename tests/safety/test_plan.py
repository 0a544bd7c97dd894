"""A plan reads back as it was written, and nothing else is read as a plan."""

from __future__ import annotations

import hashlib
import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety.approval import approval_of, approve, check_approval
from safety.hashes import hashes_of
from safety.plan import Motion, Plan, check_plan, load_plan, write_plan
from safety.seal import sealed
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, ConfigError, SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import NOON


def test_a_plan_reads_back_bit_for_bit(plan: Plan, motion: Trajectory) -> None:
    again = load_plan(plan.folder)
    for name in ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(again.motion("friction").trajectory, name), getattr(motion, name))
    assert [(m.name, m.kind) for m in again.motions] == [("friction", "friction"), ("excitation", "excitation")]
    assert again.sha256 == plan.sha256
    assert again.summary == {"condition_number": 31.5, "seed": 4}
    assert again.duration == pytest.approx(4 + 8)


def test_every_single_byte_change_is_refused(plan: Plan, arm: Arm, cell: Cell) -> None:
    approve(plan, arm, cell, "operator", NOON)
    rng = np.random.default_rng(1)
    for file in sorted(plan.folder.iterdir()):
        good = file.read_bytes()
        places = range(len(good)) if len(good) < 3000 else rng.choice(len(good), 300, replace=False)
        for place in places:
            bad = bytearray(good)
            bad[place] ^= 1 << int(rng.integers(8))
            file.write_bytes(bad)
            with pytest.raises((ConfigError, SafetyStop)):
                approval_of(load_plan(plan.folder))
        file.write_bytes(good)
    assert approval_of(load_plan(plan.folder)) is not None


@pytest.mark.parametrize("damage", ["cut", "longer", "missing", "link", "extra", "huge", "folder"])
def test_damaged_folders_are_refused(plan: Plan, damage: str) -> None:
    file = plan.folder / "friction.npy"
    raw = file.read_bytes()
    if damage == "cut":
        file.write_bytes(raw[:-8])
    elif damage == "longer":
        file.write_bytes(raw + b"\0" * 8)
    elif damage == "missing":
        file.unlink()
    elif damage == "link":
        file.rename(plan.folder.parent / "elsewhere.npy")
        file.symlink_to(plan.folder.parent / "elsewhere.npy")
    elif damage == "extra":
        shutil.copy(file, plan.folder / "other.npy")
    elif damage == "huge":
        (plan.folder / "plan.toml").write_bytes(b"#" * 1_000_001)
    else:
        shutil.rmtree(plan.folder)
    with pytest.raises(CalibError, match=r"plan"):
        load_plan(plan.folder)


def resealed(plan: Plan, old: str, new: str) -> None:
    file = plan.folder / "plan.toml"
    body = file.read_text().split("\n", 1)[1]
    assert old in body
    file.write_bytes(sealed(body.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "friction"', 'name = "../friction"', "pattern"),
        ('name = "excitation"', 'name = "friction"', "twice"),
        ('kind = "friction"', 'kind = "dance"', "kind"),
        ("samples = 401", "samples = 400", "plan.toml says"),
        ("samples = 401", "samples = 4000000000", "less than or equal"),
        ("duration = 4.0", "duration = nan", "finite"),
        ("duration = 4.0", "duration = 5.0", "lasts"),
        ('schema = "plan/1"', 'schema = "plan/2"', "plan/1"),
        ('schema = "plan/1"', 'schema = "plan/1"\nsurprise = 1', "unknown key surprise"),
        ('schema = "plan/1"', "schema =", "TOML"),
        ("2026-11-21 12:00:00+00:00", "2026-11-21 12:00:00", "time zone"),
        ('"j1",', "", "at most"),
    ],
)
def test_a_well_sealed_plan_that_breaks_a_rule_is_refused(plan: Plan, old: str, new: str, message: str) -> None:
    resealed(plan, old, new)
    with pytest.raises(ConfigError, match=message):
        load_plan(plan.folder)


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY\x02\x00garbage", b"\x93NUMPY\x01\x00\x05\x00hello"])
def test_a_motion_file_that_is_no_array_is_refused(plan: Plan, content: bytes) -> None:
    refused(plan, content, "not a NumPy file")


@pytest.mark.parametrize(
    "header",
    ["", "{'descr': '<f8', 'shape': (", "{'a': 1, 2: 3}", "(" * 900, "-" * 900 + "1", "{" * 2000, "{'descr': '<f8', 'fortran_order': 0, 'shape': 3}",
     "if 1:\n  2\n 3"],
    ids=["empty", "open bracket", "mixed keys", "nested", "signs", "long", "wrong types", "unindent"],
)  # fmt: skip
def test_a_motion_file_with_a_crafted_header_is_refused(plan: Plan, header: str) -> None:
    refused(plan, b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode(), "not a NumPy file")


@pytest.mark.parametrize("shape", ["(-401, 19)", "(10**20, 19)", "(99999999999999999999, 19)", "(401, 19, 0)", "()"])
def test_a_motion_file_of_another_shape_is_refused(plan: Plan, shape: str) -> None:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}"
    refused(plan, b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode(), "plan.toml says|not a NumPy file")


def refused(plan: Plan, content: bytes, message: str) -> None:
    file = plan.folder / "friction.npy"
    resealed(plan, hashlib.sha256(file.read_bytes()).hexdigest(), hashlib.sha256(content).hexdigest())
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        load_plan(plan.folder)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_motion_file_with_a_number_that_is_not_finite_is_refused(plan: Plan, value: float) -> None:
    columns = np.load(plan.folder / "friction.npy")
    columns[7, 3] = value
    data = io.BytesIO()
    np.save(data, columns)
    refused(plan, data.getvalue(), "finite")


def test_a_plan_is_never_overwritten(plan: Plan, arm: Arm) -> None:
    with pytest.raises(ConfigError, match="not an empty folder"):
        write_plan(plan.folder, arm, plan.motions)


def test_motions_are_checked_before_anything_is_written(tmp_path: Path, arm: Arm, motion: Trajectory) -> None:
    short = Trajectory(motion.t, motion.q[:, :5], motion.dq[:, :5], motion.ddq[:, :5])
    with pytest.raises(ConfigError, match="5 joints"):
        write_plan(tmp_path / "a", arm, [Motion("friction", "friction", short)])
    with pytest.raises(ConfigError, match="different names"):
        write_plan(tmp_path / "b", arm, [])
    with pytest.raises(ConfigError, match="lower-case letter"):
        Motion("../x", "friction", motion)
    with pytest.raises(ConfigError, match="kind"):
        Motion("x", "dance", motion)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="Trajectory"):
        Motion("x", "friction", motion.q)  # type: ignore[arg-type]


def test_an_unknown_motion_names_those_there_are(plan: Plan) -> None:
    with pytest.raises(ConfigError, match="friction, excitation"):
        plan.motion("validation")


def changed_arm(folder: Path, tmp_path: Path, file: str, old: str, new: str) -> Arm:
    copy = tmp_path / f"arm-{abs(hash((file, old, new)))}"
    shutil.copytree(folder, copy)
    text = (copy / file).read_text()
    assert old in text
    (copy / file).write_text(text.replace(old, new, 1))
    return load_arm(copy)


@pytest.mark.parametrize(
    ("file", "old", "new", "key"),
    [
        ("arm.toml", "dq_max = [2.0", "dq_max = [2.1", r"arm\.dq_max"),
        ("model.xml", 'mass="7"', 'mass="7.1"', r"arm\.model\.mass"),
        ("model.xml", 'size="0.08"', 'size="0.07"', r"arm\.model\.shapes"),
        ("arm.toml", 'name = "test6"', 'name = "test7"', r"arm\.name"),
    ],
)
def test_another_arm_is_refused(
    plan: Plan, arm: Arm, arm_folder: Path, cell: Cell, tmp_path: Path, file: str, old: str, new: str, key: str
) -> None:
    other = changed_arm(arm_folder, tmp_path, file, old, new)
    check_plan(plan, arm, cell)
    with pytest.raises(SafetyStop):
        check_plan(plan, other, cell)
    with pytest.raises(SafetyStop, match=key):
        check_approval(approve(plan, arm, cell, "operator", NOON), plan, other, cell, NOON)


def test_another_cell_is_refused(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(cell.path.read_text() + "\n")
    other = load_cell(file)
    with pytest.raises(SafetyStop, match="another cell"):
        check_plan(plan, arm, other)
    with pytest.raises(SafetyStop, match=r"cell\.file"):
        check_approval(approve(plan, arm, cell, "operator", NOON), plan, arm, other, NOON)


def test_a_mesh_of_the_cell_that_was_changed_is_another_cell(plan: Plan, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    file, mesh = tmp_path / "cell.toml", tmp_path / "wall.stl"
    file.write_text(cell.path.read_text() + '[[obstacles]]\nkind = "mesh"\nname = "wall"\nfile = "wall.stl"\n')
    mesh.write_bytes(b"a mesh")
    walled = load_cell(file)
    before = hashes_of(arm, walled)
    mesh.write_bytes(b"b mesh")
    assert hashes_of(arm, walled) == before  # the bytes that were read with the cell count
    assert hashes_of(arm, load_cell(file)).cell != before.cell
    mesh.unlink()
    with pytest.raises(ConfigError, match="obstacle wall"):
        load_cell(file)
    with pytest.raises(ConfigError, match="was not read with the cell file"):
        hashes_of(arm, replace(walled, files={}))


def test_a_place_that_no_file_system_has_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_plan(tmp_path / ("x" * 300))


def test_a_plan_without_a_cell_fits_every_cell_of_its_arm(tmp_path: Path, arm: Arm, cell: Cell, motion: Trajectory) -> None:
    check_plan(write_plan(tmp_path / "p", arm, [Motion("probe", "probe", motion)]), arm, cell)
