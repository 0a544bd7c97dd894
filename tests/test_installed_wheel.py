"""The wheel works when installed outside the checkout, and contains the shipped arms and cells."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    home = tmp_path_factory.mktemp("wheel")
    run([sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(home / "dist"), str(CHECKOUT)], home)
    (wheel,) = (home / "dist").glob("*.whl")
    venv.create(home / "venv", with_pip=False)
    python = home / "venv" / "bin" / "python"
    site = next((home / "venv" / "lib").glob("python*")) / "site-packages"
    run([sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(site), str(wheel)], home)
    # adds the dependencies of this environment; the wheel comes before a checkout that is installed there
    (site / "dependencies.pth").write_text(f"import site; site.addsitedir({sysconfig.get_paths()['purelib']!r})\n")
    return home, python


def run(command, cwd):
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_an_installed_wheel_works_outside_the_checkout(installed):
    home, python = installed
    places = run(
        [
            str(python),
            "-c",
            "import calib, safety, drivers, logs, sim; print(*(m.__file__ for m in (calib, safety, drivers, logs, sim)))",
        ],
        home,
    )
    assert all(str(home) in place for place in places.split())
    reply = json.loads(run([str(python), "-m", "calib", "export", "ur10e", "--json", "--out", "out"], home))
    assert reply["arm"] == "ur10e"
    names = run(
        [
            str(python),
            "-c",
            "from sim.resources import shipped_configs as s; print(*sorted(p.parent.name for p in s().glob('arms/*/arm.toml')))",
        ],
        home,
    )
    family = "ur10 ur10e ur12e ur15 ur16e ur18 ur20 ur3 ur30 ur3e ur5 ur5e ur7e ur8l"
    assert names.split() == ["servo6", *family.split()]
    assert "mock-ur10e" in run([str(python), "-c", "from sim.cell import load_cell; print(load_cell('mock-ur10e').name)"], home)
