"""Stand-in for the commands of a guided session, and helpers that start a session with it."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib import main as program
from calib.guided_session import GuidedSession, read_session

NOTHING = {"arm": "ur10e", "verdict": "no_missing_effect", "arm_out": None, "effects": []}
ROUND = ["check", "plan", "record", "identify", "validate", "diagnose"]


class Commands:
    """Stand-in for the program: writes each command's files and records its arguments. `fail` may return an exit code first."""

    def __init__(self, answers: list[dict[str, Any]], fail: Callable[[int, str], int] = lambda count, verb: 0) -> None:
        self.answers, self.fail, self.lines = answers, fail, list[list[str]]()

    def __call__(self, arguments: list[str]) -> tuple[int, str]:
        verb = arguments[0]
        self.lines.append(arguments)
        if code := self.fail(len(self.lines), verb):
            return code, f"{verb} failed"
        if "--out" not in arguments:
            return 0, f"{verb} done"
        folder = Path(arguments[arguments.index("--out") + 1])
        folder.mkdir(parents=True)
        if verb == "plan":
            (folder / "plan.html").write_text("")
            (folder / "plan.toml").write_text('[[motions]]\nname = "excitation"\n')
            (folder / "excitation.npy").write_bytes(b"")
        if verb == "record":
            for name in ("friction", "excitation", "validation"):
                (folder / f"{name}.mcap").write_bytes(b"")
        if verb == "diagnose":
            (folder / "diagnosis.json").write_text(json.dumps(self.answers.pop(0)))
            return 1, "effects were identified"
        return 0, f"{verb} done"

    @property
    def verbs(self) -> list[str]:
        return [line[0] for line in self.lines]


def go(commands: Commands, monkeypatch: pytest.MonkeyPatch, *more: str, answers: str = "", cell: str = "mock-ur10e") -> int:
    """Run `calib go CELL` with its commands replaced by `commands` and its questions answered from `answers`."""
    real = program.start
    monkeypatch.setattr(program, "start", commands)
    monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
    try:
        return real(["go", cell, *more])[0]
    finally:
        monkeypatch.setattr(program, "start", real)


def session(desk: Path) -> GuidedSession:
    (folder,) = (desk / "runs").glob("*-go")
    return read_session(folder)
