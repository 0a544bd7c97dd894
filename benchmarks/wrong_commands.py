"""Wrong recordings as files through the commands: none may be accepted, and each refusal should name its cause first.

A run continues where the last one stopped (build/wrong_commands.jsonl), for `minutes` at a time: `make wrong`. A gripper's
column is dropped when a log is read for an arm, so it is no wrong recording here. The same recording given twice does not apply
to a command that takes one, nor to a fleet, which counts a copy once (tests/calib/fleet/test_fleet.py).
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
NO_COPY = ("identify", "validate", "diagnose")  # commands that get the same recording twice
MEASURES = ("benchmarks.wrong_commands", *commands("identify", "validate", "diagnose", "watch", "import_", "fleet"))
AT_ONCE, IN_A_CHILD = 25, 10  # cases per fleet; cases in turn per child for any other command
LONGEST = 600.0  # s, time limit of one child
FAULT = -1  # code of a call whose process crashed or did not end


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
    """The same for a fleet with every case as one arm; 2 if the arm's recordings cannot be used."""
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
    """The likeliest cause with the options that undo it, without the other causes."""
    at = printed.find(LIKELIEST)
    remedy = printed[at:].partition(CONVERT)
    return printed[at:].split(OTHERS)[0] + remedy[1] + remedy[2] if at >= 0 else f"no cause: {printed[-300:]}"


def run(minutes: float = 10.0, count: int = COUNT, commands: Sequence[str] = COMMANDS) -> list[dict[str, Any]]:
    """Try cases for `minutes`; return rows (what, value, unit, bar, note) over all tried so far."""
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
    for command in commands:  # load here what a command loads on its first call, so that no child has to
        tried(command, everything[:1])
    # all commands progress in a slice, not only the first
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
    """Exit code and cause of each case. Only a fleet takes several cases at once."""
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
