"""Mutated files, readings and arguments through every command: each call must end in a result or one error message.

A run continues where the last one stopped (build/hostile_commands.jsonl), for `minutes` at a time: `make hostile`. Commands are
called through the program's entry function, a chunk of mutants in turn per child, forked from a process with all modules
loaded. Output that is not the command's own (a library's warning) counts as a fault. Left out: init and arm read, which would
query a mutated address, and `servo scan`.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import re
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import calib
import drivers
import logs
import safety
import sim
from benchmarks.forked import Done, forked, warm
from benchmarks.hostile_inputs import CASES
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import CODE, digest
from calib.main import main as program
from calib.terminal.unexpected import EXIT_CODE

MEASURES = (*CODE, "benchmarks.hostile_commands")  # every command
CHUNK = 40  # mutants per process
# mutants per process for pairs of command and input that take seconds per mutant
FEW = {
    "identify, csv": 4, "identify, readings": 6, "validate, readings": 8, "diagnose, readings": 3, "watch, readings": 6, "fleet, readings": 6,
    "identify, held out": 4, "identify, loaded": 6, "diagnose, held out": 2, "identify, words": 12, "validate, csv": 12, "validate, words": 12, "diagnose, csv": 12, "diagnose, words": 20, "fleet, mcap": 12,
    "fleet, words": 20, "plan, arm.toml": 8, "plan, words": 20,
}  # fmt: skip
LONGEST = 120.0  # s, after which a call counts as hanging
LEAKED = re.compile(r"Traceback|[A-Za-z]Warning\b")


def attack(name: str, seed: int, count: int) -> dict[str, Any]:
    """Run `count` mutants through one command in this process: faults, refusals, and the slowest call, s."""
    rng = random.Random(f"{name} {seed}")
    faults, codes, slowest = [], [], 0.0
    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / "case"
        folder.mkdir()
        os.chdir(folder)
        mutant, beside, began = CASES[name](folder), set(folder.rglob("*")), time.perf_counter()
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
    return {
        "faults": faults,
        "refused": sum(c == 2 for c in codes),
        "count": count,
        "slowest": slowest,
        "seconds": time.perf_counter() - began,
    }


def with_faults(name: str, seed: int, count: int, done: Done) -> dict[str, Any]:
    """Findings of a child. A crash, a call that does not end, and output of a library each count as a fault."""
    if done.fault:
        return {"refused": 0, "count": count, "slowest": 0.0, "faults": [f"{name}: seed {seed}: {done.fault}"]}
    found = dict(done.value)
    if done.leaked:
        found["faults"].append(f"{name}: seed {seed}: a library wrote {' '.join(done.leaked.split())[-200:]}")
    return found


def run(minutes: float = 10.0, count: int = 10_000, names: Sequence[str] = tuple(CASES)) -> list[dict[str, Any]]:
    """Try mutants for `minutes`; return rows (what, value, unit, bar, note) over all tried so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "hostile_commands.jsonl", " ".join(digest(path) for path in MEASURES))
    rounds = -(-count // sum(FEW.get(name, CHUNK) for name in names))
    warm(sim, logs, drivers, safety, calib)
    each_once = [(name, seed, FEW.get(name, CHUNK)) for seed in range(rounds) for name in names]
    todo = {f"{name} {seed}": (name, seed, few) for name, seed, few in each_once if f"{name} {seed}" not in kept.found}
    for done in forked(((key, partial(attack, *what)) for key, what in todo.items()), LONGEST * 8, end):
        kept.keep(done.key, with_faults(*todo[done.key], done))
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
