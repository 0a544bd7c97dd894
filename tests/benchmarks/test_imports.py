"""A figure depends on what its benchmark imports, and on that alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import imports


@pytest.mark.parametrize("module", ["benchmarks.gate", "calib.commands.diagnose", "calib.commands.servo"])
def test_all_that_python_imports_is_among_them(module: str) -> None:
    program = f"import sys, {module}; print(*(m.__file__ for m in sys.modules.values() if getattr(m, '__file__', None)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=imports.ROOT)
    loaded = {Path(f) for f in done.stdout.split()}
    ours = {str(f.relative_to(imports.ROOT)) for f in loaded if f.is_relative_to(imports.ROOT)} & set(
        imports.modules().values()
    )
    assert len(ours) > 15
    assert ours - {imports.modules()[name] for name in imports.ASIDE} <= set(imports.files(module))


def test_imports_inside_functions_count_and_other_commands_do_not() -> None:
    diagnose = imports.files("calib.commands.diagnose")
    assert "calib/diagnosis/diagnose.py" in diagnose  # imported when the command is called
    assert "sim/effects/payload.py" in diagnose
    assert "calib/commands/servo.py" not in diagnose
    assert not [f for f in diagnose if f.startswith("drivers/ur_rtde/")]


def test_arms_count_for_those_that_read_them() -> None:
    assert "configs/arms/ur10e/arm.toml" in imports.files("benchmarks.gate")
    assert not [f for f in imports.files("benchmarks.install") if f.startswith("configs/")]


def test_a_module_that_is_gone_is_named() -> None:
    with pytest.raises(ValueError, match=r"calib\.gone: no file"):
        imports.files("calib.gone")
