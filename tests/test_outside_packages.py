"""Third-party packages installed by pip: commands find their driver, effect and arm, and report one that is broken."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sim.resources import shipped_configs

PROJECT = """[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "{name}"
version = "{version}"
[project.entry-points."arm_calib.{group}"]
{entry}
[tool.hatch.build.targets.wheel]
packages = ["{package}"]
"""
DRIVER = '''"""A bus of one's own; here with the mock behind it."""
from drivers.mock import MockDriver


class BusDriver(MockDriver):
    """The mock under another name."""
'''
EFFECT = '''"""A cable that stiffens."""
from typing import ClassVar

from sim.effects import Effect, Parameter, PathState, Stage
from sim.effects.effect import Values


class CablePull(Effect):
    """tau_pull = -stiffness q^3 on the link.

    A cable loop that stiffens as the joint leaves its middle.
    """

    name = "cable_pull"
    summary = "a cable that stiffens"
    looks = "torque that grows with the cube of the angle"
    reference = "the makers of the cable"
    stage = Stage.JOINT
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("stiffness", "N*m/rad^3", "pull at one rad", lower=0.0, upper=1e3, grid=(2.0,)),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        state.load[:, joint] += p["stiffness"] * state.q[:, joint] ** 3
'''
BROKEN = "import a_module_that_is_not_there\n"
CHECK = "from calib.testing import assert_kept, check_effect; assert_kept(check_effect('cable_pull'))"


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """Return a function that runs Python in an environment in which the packages are installed."""
    home, site = tmp_path_factory.mktemp("outside"), tmp_path_factory.mktemp("site")
    servo = shipped_configs() / "arms" / "servo6"
    arm = {f.name: f.read_text().replace('name = "servo6"', 'name = "their_arm"') for f in servo.iterdir() if f.is_file()}
    packages = [
        ("their-bus", "1.2", "drivers", 'their_bus = "their_bus:BusDriver"', {"__init__.py": DRIVER}),
        ("their-cable", "0.3", "effects", 'cable_pull = "their_cable:CablePull"', {"__init__.py": EFFECT}),
        ("their-arm", "2.0", "arms", 'their_arm = "their_arm"\nur18 = "their_arm"', {"__init__.py": "", **arm}),
        ("their-mistake", "0.1", "effects", 'mistake = "their_mistake:Mistake"', {"__init__.py": BROKEN}),
    ]
    for name, version, group, entry, files in packages:
        package = name.replace("-", "_")
        (home / name / package).mkdir(parents=True)
        (home / name / "pyproject.toml").write_text(
            PROJECT.format(name=name, version=version, group=group, entry=entry, package=package)
        )
        for file, text in files.items():
            (home / name / package / file).write_text(text)
    where = [str(home / name) for name, *_ in packages]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--no-build-isolation", "--target", str(site), *where], check=True, capture_output=True, timeout=300)
    cell = Path(home, "their-cell.toml")
    cell.write_text('schema = "cell/1"\nname = "their-cell"\narm = "their_arm"\ndriver = "their_bus"\n')

    def run(*arguments, code=0):
        done = subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, timeout=300, cwd=home,
            env=os.environ | {"PYTHONPATH": str(site), "COLUMNS": "200"},
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout, " ".join(done.stderr.split())

    return run


def test_the_catalogue_says_where_each_effect_comes_from(outside):
    listed, warnings = outside("-m", "calib", "effects", "--json")
    effects = {e["name"]: e["from"] for e in json.loads(listed)["effects"]}
    assert effects["cable_pull"] == "their-cable 0.3"
    assert effects["payload"] == "arm-calib"
    listed, warnings = outside("-m", "calib", "effects")
    assert "their-cable 0.3" in listed
    assert "effects 'mistake' of their-mistake 0.1: cannot be imported (ModuleNotFoundError" in warnings
    assert "cannot be imported" in outside("-m", "calib", "effects", "mistake", code=2)[1]


def test_the_effect_keeps_the_promises_of_effects(outside):
    outside("-c", CHECK)


def test_a_cell_of_their_driver_and_their_arm_is_checked(outside):
    printed, _ = outside("-m", "calib", "check", "their-cell.toml")
    assert "driver their_bus comes from their-bus 1.2" in printed
    assert "arm their_arm comes from their-arm 2.0" in printed


def test_their_arm_goes_where_an_arm_goes(outside):
    outside("-m", "calib", "export", "their_arm", "--out", "exported")
    assert "known: " in outside("-m", "calib", "export", "their_ram", "--out", "no", code=2)[1]


def test_the_name_of_a_shipped_arm_is_refused(outside):
    refused = outside("-m", "calib", "export", "ur18", "--out", "no", code=2)[1]
    assert "their-arm 2.0 adds arm 'ur18', which arm-calib already has; uninstall that package" in refused


def test_a_folder_of_the_user_comes_first_and_is_not_reported_as_theirs(outside):
    copy = "from pathlib import Path; from sim.arm import load_arm; from sim.arm_folder import write_arm; "
    outside("-c", copy + "write_arm(Path('own/arms/their_arm'), load_arm('servo6'))")
    printed, _ = outside("-m", "calib", "check", "their-cell.toml", "--configs", "own")
    assert "driver their_bus comes from" in printed
    assert "arm their_arm comes from" not in printed
