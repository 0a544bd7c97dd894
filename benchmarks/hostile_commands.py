"""Mutated files, readings and arguments through every command: each call ends in an answer or in one sentence, never in a fault.

A run goes on where the last one ended (build/hostile_commands.jsonl), for `minutes` at a time: `make hostile`. Commands are called by the
program's entry function, a chunk of mutants one after the other in a process of its own; what that process printed beside the commands' own
words (a library's warning) is a fault too. Left out: init and arm read, which would ask a mutated address, and `servo scan`.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import ONE_THREAD
from benchmarks.hostile_inputs import CASES
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import ROOT
from calib.main import main as program
from calib.unexpected import EXIT_CODE

CHUNK = 40  # mutants of one process
# of pairs that compute for seconds on a mutant
FEW = {
    "identify, csv": 4, "identify, readings": 6, "validate, readings": 8, "diagnose, readings": 3, "watch, readings": 6, "fleet, readings": 6,
    "identify, words": 12, "validate, csv": 12, "validate, words": 12, "diagnose, csv": 12, "diagnose, words": 20, "fleet, mcap": 12,
    "fleet, words": 20, "plan, arm.toml": 8, "plan, words": 20,
}  # fmt: skip
LONGEST = 120.0  # s that one call may take before it counts as hanging
LEAKED = re.compile(r"Traceback|[A-Za-z]Warning\b")


def attack(name: str, seed: int, count: int) -> dict[str, Any]:
    """`count` mutants through one command in this process: what was a fault, how many were refused, and the slowest call, s."""
    rng = random.Random(f"{name} {seed}")
    faults, codes, slowest = [], [], 0.0
    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / "case"
        folder.mkdir()
        os.chdir(folder)
        mutant, beside = CASES[name](folder), set(folder.rglob("*"))
        for _ in range(count):
            words = mutant(rng)
            begin, printed = time.perf_counter(), io.StringIO()
            try:
                with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                    code = program(list(words))
            except (Exception, SystemExit) as error:
                code = EXIT_CODE
                printed.write(f"left the command: {type(error).__name__}: {error}")
            if code not in (0, 1, 2, 3, 4) or LEAKED.search(printed.getvalue()):
                faults.append(f"{name}: exit code {code}: {' '.join(printed.getvalue().split())[-200:]}")
            elif (took := time.perf_counter() - begin) > LONGEST:
                faults.append(f"{name}: {took:.0f} s")
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
                              timeout=LONGEST * 8)  # fmt: skip
    except subprocess.TimeoutExpired:
        return nothing | {"faults": [f"{name}: seed {seed}: not within {LONGEST * 8:g} s"]}
    if done.returncode:
        return nothing | {"faults": [f"{name}: seed {seed}: ended with {done.returncode}: {done.stderr[-300:]}"]}
    *leaked, answer = done.stdout.splitlines()
    found = dict(json.loads(answer))
    if leaked or done.stderr.strip():
        found["faults"].append(f"{name}: seed {seed}: a library wrote {' '.join([*leaked, done.stderr])[-200:]}")
    return found


def run(minutes: float = 10.0, count: int = 10_000, names: Sequence[str] = tuple(CASES)) -> list[dict[str, Any]]:
    """A slice of the mutants, then the rows of all that were tried so far: what, value, unit, bar, note."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "hostile_commands.jsonl", "2")  # a fault that was seen stays one until the file is removed
    rounds = -(-count // sum(FEW.get(name, CHUNK) for name in names))
    for seed in range(rounds):
        for name in names:
            if f"{name} {seed}" not in kept.found and time.monotonic() < end:
                kept.keep(f"{name} {seed}", attacked(name, seed, FEW.get(name, CHUNK)))
    found = kept.found
    faults = [fault for f in found.values() for fault in f["faults"]]
    tried = sum(f["count"] for f in found.values())
    slowest = max(found, key=lambda k: found[k]["slowest"], default="")
    each = [sum(f["count"] for what, f in found.items() if what.rpartition(" ")[0] == name) for name in names]
    return [
        {"what": "mutated inputs through commands", "value": tried, "bar": str(count), "note": f"{len(names)} pairs of command and input, {min(each)} to {max(each)} through each"},
        {"what": "tracebacks, crashes, hangs and warnings of libraries", "value": len(faults), "bar": "0", "note": "; ".join(faults[:3])},
        {"what": "refused in a sentence", "value": sum(f["refused"] for f in found.values()),
         "note": f"slowest call {found[slowest]['slowest']:.1f} s, {slowest}" if slowest else ""},
    ]  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(attack(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
