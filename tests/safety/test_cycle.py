"""The cache never supplies a compiled cycle of outdated rules, and the cycle checks every rule."""

from __future__ import annotations

import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import safety
from safety import cycle
from safety.monitor_rules import RULES

AGED = """import numpy as np
from safety.cycle import cycle
from safety.rows import NUMBERS, ROWS, Of, Row
x = np.zeros(NUMBERS)
x[Of.T_DEVICE], x[Of.LATE], x[Of.T], x[Of.NOW] = 0.002, 0.01, 0.002, 0.1
print(cycle(np.zeros((ROWS, 1)), x, np.zeros((2, 3)), np.zeros((5, 2)), np.zeros((5, 1)), np.zeros((4, 4)), np.zeros(3))[0])
"""


def test_every_rule_that_has_a_name_is_looked_at() -> None:
    text = inspect.getsource(cycle)
    assert [int(k) for k in re.findall(r"if rule == (\d+)", text)] == list(range(len(RULES)))
    assert f"range({len(RULES)})" in text


@pytest.mark.slow
def test_a_changed_rule_is_compiled_again(tmp_path: Path) -> None:
    package = tmp_path / "safety"
    package.mkdir()
    (package / "__init__.py").touch()
    for name in ("cycle", "rows", "rules", "lies"):
        shutil.copy(Path(str(safety.__file__)).with_name(f"{name}.py"), package)
    rules = package / "rules.py"

    def broken() -> str:
        environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_OPT": "0"}
        return subprocess.run([sys.executable, "-c", AGED], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stdout  # fmt: skip

    assert broken().strip() == "2"
    text = rules.read_text()
    changed = text.replace("old = x[Of.NOW] - x[Of.T]", "old = 0.0 * x[Of.NOW]")
    assert changed != text
    rules.write_text(changed)
    assert broken().strip() != "2"
