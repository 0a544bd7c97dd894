"""Checked in the source: `Guard` is the only caller of `Driver.send`, and only `clear` makes a ClearedTrajectory."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def calls(package: str, name: str) -> set[str]:
    """Files of a package that use `name` as an attribute, as a variable or as a string."""
    found = set()
    for file in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(parsed(file)):
            called = isinstance(node, ast.Attribute) and node.attr == name
            named = isinstance(node, ast.Name) and node.id == name and isinstance(node.ctx, ast.Load)
            spelled = isinstance(node, ast.Constant) and node.value == name
            if called or named or spelled:
                found.add(file.relative_to(ROOT).as_posix())
    return found


def test_only_the_guard_sends() -> None:
    assert calls("safety", "send") == {"safety/guard.py"}
    # the driver contract tests run on drivers without an arm; nothing that moves an arm imports them
    assert calls("calib", "send") <= {"calib/testing/driver.py"}
    assert not any(
        "calib.testing" in file.read_text() for package in ("safety", "drivers") for file in (ROOT / package).rglob("*.py")
    )


def test_nobody_reaches_for_methods_by_computed_names_where_motion_is_commanded() -> None:
    """The test above would not notice `getattr(driver, "se" + "nd")`."""
    for name in (
        "guard",
        "coming_to_rest",
        "execution",
        "legs",
        "control",
        "control_process",
        "monitor",
        "stopping",
        "monitor_link",
        "watching",
        "second_look",
    ):
        tree = parsed(ROOT / "safety" / f"{name}.py")
        names = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
        assert not names & {"getattr", "eval", "exec", "__import__"}


def test_only_clear_seals() -> None:
    assert calls("safety", "_SEAL") == {"safety/clear.py"}
    assert calls("calib", "_SEAL") == set()
    assert calls("calib", "_CLEARED") == set()
