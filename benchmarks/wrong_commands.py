"""The corpus of wrong recordings as files, through the commands: none may take one for good, and each should name its cause first.

A run goes on where the last one ended (build/wrong_commands.jsonl), for `minutes` at a time: `make wrong`. A gripper's column is left
out by whoever reads a log for an arm, so it is no wrong recording here; the same recording twice is none for a command that
takes one, nor for a fleet, which counts a copy once (tests/calib/fleet/test_fleet.py).
"""

from __future__ import annotations

import contextlib
import io
import json
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
from benchmarks.forked import forked, warm
from benchmarks.imports import commands
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest
from benchmarks.wrong_data import COUNT, Case, cases
from calib.gate.check import CONVERT, LIKELIEST, OTHERS
from calib.main import main as program
from logs.convert import write_log

COMMANDS = ("identify", "validate", "diagnose", "watch", "import", "fleet")
ONE_LOG = ("watch", "import")
NO_COPY = ("identify", "validate", "diagnose")  # that the same recording twice is given to
MEASURES = ("benchmarks.wrong_commands", *commands("identify", "validate", "diagnose", "watch", "import_", "fleet"))
AT_ONCE, IN_A_CHILD = 25, 10  # cases of a fleet, and of any other command one after the other
LONGEST = 600.0  # s that one call may take
FAULT = -1  # code of a call whose process ended with a fault, or not at all


def through(command: str, case: Case, folder: Path) -> tuple[int, str]:
    """Exit code of `calib COMMAND` for the case's recordings as files, and the likeliest cause that it printed."""
    files = []
    for k, log in enumerate(case.logs):
        files.append(folder / f"log-{k}.mcap")
        write_log(log, files[-1], "clean", {})
    words = [case.arm.name, *map(str, files)]
    if command in ONE_LOG:
        words = [*map(str, files), "--arm", case.arm.name]
    extra = {"validate": ["--no-forward"], "watch": ["--database", str(folder / "trend.sqlite")]}.get(command, [])
    code, printed = _called([command, *words, *extra, "--out", str(folder / "out")])
    return code, _cause(printed)


def fleet(some: Sequence[Case], folder: Path) -> list[tuple[int, str]]:
    """The same for a fleet of which every case is an arm: 2 where the arm's recordings cannot be used."""
    for number, case in enumerate(some):
        for k, log in enumerate(case.logs):
            place = folder / "plant" / f"{number}-{k}.mcap"
            place.parent.mkdir(exist_ok=True)
            write_log(log, place, "clean", {"arm": case.arm.name, "serial": str(number), "motion": "excitation"})
    _, printed = _called(
        ["fleet", str(folder / "plant"), "--workers", "0", "--no-diagnose", "--json", "--out", str(folder / "out")]
    )
    rows = {str(row["serial"]): row for row in json.loads(printed[printed.index("{") :])["arms"]}
    return [(2 if rows[str(k)]["status"] == "bad_logs" else 0, _cause(str(rows[str(k)]["sentence"]))) for k in range(len(some))]


def _called(words: Sequence[str]) -> tuple[int, str]:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO() if "--json" in words else printed):
        code = program(list(words))
    return code, " ".join(printed.getvalue().split())


def _cause(printed: str) -> str:
    """The likeliest cause with the options that undo it, without the others."""
    at = printed.find(LIKELIEST)
    remedy = printed[at:].partition(CONVERT)
    return printed[at:].split(OTHERS)[0] + remedy[1] + remedy[2] if at >= 0 else f"no cause: {printed[-300:]}"


def run(minutes: float = 10.0, count: int = COUNT, commands: Sequence[str] = COMMANDS) -> list[dict[str, Any]]:
    """A slice of the corpus through every command, then the rows of all that was tried so far: what, value, unit, bar, note."""
    kept, end = (
        Kept(FOLDER / "wrong_commands.jsonl", " ".join(digest(path) for path in MEASURES)),
        time.monotonic() + 60 * minutes,
    )
    everything = [case for case in cases(count) if case.done != ("a gripper's joint",)]
    mine = {c: [k for k, case in enumerate(everything) if c in NO_COPY or len(case.logs) == 1] for c in commands}
    todo = {
        f"{c} {some[0]}": (c, some)
        for c in commands
        for some in _batches(c, [k for k in mine[c] if f"{c} {k}" not in kept.found])
    }
    warm(sim, logs, drivers, safety, calib)
    for command in commands:  # what a command loads when it is first called is then there for every child
        tried(command, everything[:1])
    # all commands make progress in a slice, not the first one alone
    order = sorted(todo, key=lambda key: (int(key.split()[1]), key))
    jobs = ((key, partial(tried, todo[key][0], [everything[k] for k in todo[key][1]])) for key in order)
    for done in forked(jobs, LONGEST, end):
        command, some = todo[done.key]
        for k, (code, cause) in zip(some, done.value or [(FAULT, done.fault)] * len(some), strict=True):
            named = any(w in cause for w in everything[k].right)
            kept.keep(f"{command} {k}", {"code": code, "named": named, "said": cause[:300]})
    rows = []
    for c in commands:
        rows += _rows(c, [(everything[k], kept.found[f"{c} {k}"]) for k in mine[c] if f"{c} {k}" in kept.found], len(mine[c]))
    return rows


def tried(command: str, some: Sequence[Case]) -> list[tuple[int, str]]:
    """Exit code and cause of each of the cases, of which only a fleet takes several."""
    if command == "fleet":
        with tempfile.TemporaryDirectory(prefix="calib-") as folder:
            return fleet(some, Path(folder))
    out = []
    for case in some:
        with tempfile.TemporaryDirectory(prefix="calib-") as folder:
            out.append(through(command, case, Path(folder)))
    return out


def _batches(command: str, cases: Sequence[int]) -> list[Sequence[int]]:
    size = AT_ONCE if command == "fleet" else IN_A_CHILD
    return [cases[at : at + size] for at in range(0, len(cases), size)]


def _rows(command: str, tried: Sequence[tuple[Case, dict[str, Any]]], wanted: int) -> list[dict[str, Any]]:
    if not tried:
        return []
    good = [case.name for case, f in tried if f["code"] != 2]
    named = sum(f["code"] == 2 and f["named"] for _, f in tried)
    other = next((f"{case.name}: {f['said'][:120]}" for case, f in tried if not f["named"]), "")
    of = f"{len(tried)} of {wanted} tried"
    return [
        {"what": f"{command}: wrong recordings not refused", "value": len(good), "bar": "0", "note": "; ".join([of, *good[:3]])},
        {"what": f"{command}: cause named first", "value": round(100 * named / len(tried), 1), "unit": "%", "bar": ">= 90", "note": other},
    ]  # fmt: skip
