"""Mutated files through the commands that read them: each call ends in an answer or in one sentence, never in a fault of the program.

A run goes on where the last one ended (build/hostile_commands.jsonl), for `minutes` at a time: `make hostile`. Commands that would open
a connection to an address which was mutated (capture, servo, arm read, emulate, init) are left out; demo, help and effects read no file.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import tomli_w

from benchmarks import ONE_THREAD
from benchmarks.hostile import ARM, mutated, sound
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import ROOT
from calib.main import main as program
from calib.unexpected import EXIT_CODE
from sim.resources import shipped_configs

SAMPLES = ROOT / "logs" / "samples"
CHUNK = 20  # mutants of one process
LONGEST = 120.0  # s that one call may take before it counts as hanging
Case = tuple[Path, list[str]]


def _sample(name: str) -> Callable[[Path], Path]:
    return lambda folder: Path(shutil.copy(SAMPLES / name, folder / ("log" + Path(name).suffix)))


MCAP, CSV = _sample("servo6_excitation.mcap"), _sample("ur10e_ur_rtde.csv")


def _short(folder: Path) -> Path:
    """The first second and a half of a recording: read and checked whole, and too short for the search that would follow."""
    lines = (SAMPLES / "ur10e_ur_rtde.csv").read_text().splitlines(keepends=True)
    (folder / "log.csv").write_text("".join(lines[:150]))
    return folder / "log.csv"


def _table(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        a = np.genfromtxt(SAMPLES / "ur10e_ur_rtde.csv", delimiter=",", names=True)
        columns = {name: np.asarray(a[name]) for name in a.dtype.names or ()}
        file = folder / f"table.{kind}"
        if kind == "npz":
            np.savez(file, **columns)  # type: ignore[arg-type]
        else:
            scipy.io.savemat(file, columns)
        return file

    return write


def _session(folder: Path) -> Case:
    done = {"name": "record", "arguments": ["record"], "folder": "x", "exit_code": 0, "sentence": "done", "seconds": 1.0}
    table = {
        "schema": "session/1",
        "cell": "mock-ur10e",
        "cell_sha256": "of another cell",
        "arm": "ur10e",
        "quick": True,
        "rounds": 2,
    }
    (folder / "session.toml").write_text(tomli_w.dumps(table | {"done": [done]}))
    return folder / "session.toml", ["go", "mock-ur10e", "--session", str(folder)]


def _map(folder: Path) -> Case:
    """A column map beside a table."""
    file = _table("npz")(folder)
    table = {"joints": ["a"], "time": {"column": "timestamp"}, "q": {"columns": ["actual_q_0"], "unit": "rad"}}
    (folder / "map.toml").write_text(tomli_w.dumps(table))
    return folder / "map.toml", ["import", str(file), "--map", str(folder / "map.toml"), "--out", str(folder / "out")]


def _arm(kind: str, *words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file, _ = sound(kind, folder)
        return file, [words[0], str(file if kind == "arm.urdf" else file.parent), *words[1:], "--out", str(folder / "out")]

    return make


def _new(folder: Path) -> Case:
    file, _ = sound("arm.urdf", folder)
    limits = [w for x in ("ddq_max=5", "jerk_max=100") for w in ("--limit", x)]
    return file, ["arm", "new", str(file), *limits, "--numbers", "cad", "--out", str(folder / "out")]


def _cell(*words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file = Path(shutil.copy(shipped_configs() / "cells" / "mock-ur10e.toml", folder / "cell.toml"))
        return file, [str(file) if word == "CELL" else word for word in words]

    return make


def _plan(folder: Path) -> Case:
    file, _ = sound("plan.toml", folder)
    cell = (shipped_configs() / "cells" / "mock-ur10e.toml").read_text().replace("ur10e", ARM)
    (folder / "cell.toml").write_text(cell)
    return file, ["record", str(folder / "cell.toml"), str(file.parent), "--yes", "--out", str(folder / "out")]


def _run(*words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file, _ = sound("run.toml", folder)
        return file, [*words, str(folder)]

    return make


def _log(write: Callable[[Path], Path], *words: str) -> Callable[[Path], Case]:
    """A command on a recording; LOG and OUT stand for their paths."""

    def make(folder: Path) -> Case:
        file = write(folder)
        places = {"LOG": str(file), "OUT": str(folder / "out"), "FOLDER": str(folder), "DB": str(folder / "trend.sqlite")}
        return file, [places.get(word, word) for word in words]

    return make


# command and kind of file -> a sound file of that kind in a folder, and the words after `calib`
CASES: dict[str, Callable[[Path], Case]] = {
    "identify, mcap": _log(MCAP, "identify", ARM, "LOG", "--out", "OUT"),
    "identify, csv": _log(CSV, "identify", "ur10e", "LOG", "--accept-partial", "--out", "OUT"),
    "validate, mcap": _log(MCAP, "validate", ARM, "LOG", "--no-forward", "--accept-partial", "--out", "OUT"),
    "validate, csv": _log(CSV, "validate", "ur10e", "LOG", "--no-forward", "--out", "OUT"),
    "diagnose, csv": _log(_short, "diagnose", "ur10e", "LOG", "--accept-partial", "--out", "OUT"),
    "watch, mcap": _log(MCAP, "watch", "LOG", "--arm", ARM, "--database", "DB", "--accept-partial", "--out", "OUT"),
    "fleet, mcap": _log(MCAP, "fleet", "FOLDER", "--workers", "0", "--no-diagnose", "--out", "OUT"),
    "import, mcap": _log(MCAP, "import", "LOG", "--out", "OUT"),
    "import, csv": _log(CSV, "import", "LOG", "--arm", "ur10e", "--out", "OUT"),
    "import, npz": _log(_table("npz"), "import", "LOG", "--arm", "ur10e", "--yes", "--out", "OUT"),
    "import, mat": _log(_table("mat"), "import", "LOG", "--arm", "ur10e", "--yes", "--out", "OUT"),
    "import, map": _map,
    "replay, mcap": _log(MCAP, "replay", "LOG", "--arm", ARM, "--speed", "1000"),
    "export, arm.toml": _arm("arm.toml", "export"),
    "export, model.xml": _arm("model.xml", "export"),
    "export, urdf": _arm("arm.urdf", "export"),
    "plan, arm.toml": _arm("arm.toml", "plan", "--period", "0.1"),
    "plan, cell.toml": _cell("plan", "ur10e", "--cell", "CELL", "--period", "0.1", "--out", "never-written"),
    "arm new, urdf": _new,
    "check, cell.toml": _cell("check", "CELL", "--seconds", "0.1"),
    "record, plan.toml": _plan,
    "go, session.toml": _session,
    "runs, run.toml": _run("runs"),
    "report, run.toml": _run("report"),
}


def attack(name: str, seed: int, count: int) -> dict[str, Any]:
    """`count` mutants through one command in this process: what was a fault, how many were refused, and the slowest call, s."""
    rng = random.Random(f"{name} {seed}")
    faults, codes, slowest = [], [], 0.0
    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / "case"
        folder.mkdir()
        os.chdir(folder)
        file, words = CASES[name](folder)
        data, beside = file.read_bytes(), set(folder.rglob("*"))
        for _ in range(count):
            file.write_bytes(mutated(data, rng))
            begin, printed = time.perf_counter(), io.StringIO()
            try:
                with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                    code = program(list(words))
            except (Exception, SystemExit) as error:
                code = EXIT_CODE
                printed.write(f"left the command: {type(error).__name__}: {error}")
            if code not in (0, 1, 2, 3, 4) or "Traceback" in printed.getvalue():
                faults.append(f"{name}: exit code {code}: {' '.join(printed.getvalue().split())[-200:]}")
            codes.append(code)
            slowest = max(slowest, time.perf_counter() - begin)
            for new in sorted(set(folder.rglob("*")) - beside, reverse=True):
                new.rmdir() if new.is_dir() and not new.is_symlink() else new.unlink()
    return {"faults": faults, "refused": sum(c == 2 for c in codes), "count": count, "slowest": slowest}


def attacked(name: str, seed: int, count: int) -> dict[str, Any]:
    """`attack` in a process of its own: a crash is a fault, and so is a call that does not end."""
    command = [sys.executable, "-m", "benchmarks.hostile_commands", name, str(seed), str(count)]
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT)}
    nothing = {"refused": 0, "count": count, "slowest": 0.0}
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL,
                              timeout=LONGEST * 5)  # fmt: skip
    except subprocess.TimeoutExpired:
        return nothing | {"faults": [f"{name}: seed {seed}: not within {LONGEST * 5:g} s"]}
    if done.returncode:
        return nothing | {"faults": [f"{name}: seed {seed}: ended with {done.returncode}: {done.stderr[-300:]}"]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


def run(minutes: float = 10.0, count: int = 10_000, names: Sequence[str] = tuple(CASES)) -> list[dict[str, Any]]:
    """A slice of the mutants, then the rows of all that were tried so far: what, value, unit, bar, note."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "hostile_commands.jsonl", "1")  # a fault that was seen stays one until the file is removed
    rounds = -(-count // (CHUNK * len(names)))
    for seed in range(rounds):
        for name in names:
            if f"{name} {seed}" not in kept.found and time.monotonic() < end:
                kept.keep(f"{name} {seed}", attacked(name, seed, CHUNK))
    found = kept.found
    faults = [fault for f in found.values() for fault in f["faults"]]
    tried = sum(f["count"] for f in found.values())
    slowest = max(found, key=lambda k: found[k]["slowest"], default="")
    return [
        {"what": "mutated files through commands", "value": tried, "bar": str(count), "note": f"{len(names)} pairs of command and file"},
        {"what": "tracebacks, crashes and hangs", "value": len(faults), "bar": "0", "note": "; ".join(faults[:3])},
        {"what": "refused in a sentence", "value": sum(f["refused"] for f in found.values()),
         "note": f"slowest call {found[slowest]['slowest']:.1f} s, {slowest}" if slowest else ""},
    ]  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(attack(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
