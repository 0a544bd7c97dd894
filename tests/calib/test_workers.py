"""Parallel processes, also from a script that does not guard its entry point."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
from calib.excitation.workers import workers
with workers(2) as pool:
    print(pool.run(abs, [-1, 2, -3], lambda share: None))
print(__file__)
"""


def test_a_script_without_a_guard_starts_its_processes_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["[1, 2, 3]", str(script)]
    assert not done.stderr
