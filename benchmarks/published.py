"""Published recordings of real arms, unmodified: does any command refuse one, and what do jittered stamps cost?

A run continues where the last one stopped (build/published.jsonl). Every recording is imported if it is a table, then given to
identify, to validate (with the arm identified from the first recordings of its set) and to diagnose. It counts as refused if it
is reported as wrong data or ends in a fault. A standing arm, nothing to identify or compare, and a poor fit are valid results.

The Panda's stamps come from a host that was late, and one sample in fourteen repeats the previous one. Its repaired copy has
whole control periods of 1 ms between samples, as dq demands, and no repeated ones. `repaired` does not use `logs.sampling`.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import calib
import drivers
import logs
import safety
import sim
from benchmarks.forked import forked, warm
from benchmarks.imports import commands
from benchmarks.kept import FOLDER, Kept
from benchmarks.real import score
from benchmarks.real_sets import SETS
from benchmarks.results import digest
from calib.main import main as program

MEASURES = ("benchmarks.published", *commands("arm", "import_", "identify", "validate", "diagnose"))
COMMANDS = ("identify", "validate", "diagnose")
BROKEN = "broken_values.csv"
STANDS = ("the motion is too short", "Nothing compared", "nothing can be identified of a joint that hardly moves")
LONGEST = 900.0  # s, time limit of one recording
PERIOD, UNTIL, MOST_DIFFERENCE = 1e-3, 10.0, 0.10  # s, the Panda's control period; s, end of the fitted part; bar
DRIVES = {"dm8009": (1, 2), "dm4340": (3, 4), "dm4310": (5, 6, 7)}


@dataclass(frozen=True)
class Arm:
    """Words that make the arm (none: it is shipped), its recordings, and words for their import (none: not needed)."""

    new: tuple[str, ...]
    files: tuple[str, ...]
    words: tuple[str, ...] = ()


def arms(data: Path) -> dict[str, Arm]:
    """Every recording of the folder, by arm."""

    def files(pattern: str) -> tuple[str, ...]:
        return tuple(str(f.relative_to(data)) for f in sorted(data.glob(pattern)) if f.name != BROKEN)

    out = {"ur10e": Arm((), (*files("ur10e/excitation*.csv"), *files("ur10e/[!e]*.csv"), *files("ur10e_more/*.csv")))}
    for name in ("panda", "rokae", "sh_electric", "ur5e_joint"):
        out[name] = Arm(SETS[name].new, files(f"{name}/*.csv"))
    for name, motors in DRIVES.items():
        new = next(s.new for s in SETS.values() if name in s.new)
        out[name] = Arm(new, tuple(f for m in motors for f in files(f"damiao/*motor_0{m}.csv")))
    # the load is a raw number: the gate reports how many of them make a newton metre at the pendulum
    words = ("--column", "time=t:s", "--column", "q=q1:rad", "--column", "dq=dq1:rad/s", "--column", "tau=load_raw:N m",
             "--assume", "tau=int16", "--assume", "scale:tau=1670")  # fmt: skip
    out["servo_pendulum"] = Arm(SETS["servo_pendulum"].new, files("servo_pendulum/*.csv"), words)
    return out


def called(*words: str) -> tuple[int, str]:
    """Exit code of a command and its output."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = program(list(words))
    return code, " ".join(printed.getvalue().split())


def made(arm: Arm, name: str, data: Path, folder: Path) -> str:
    """The arm's name, or the arm folder made for it."""
    if not arm.new:
        return name
    if not (folder / name).is_dir():
        _need(*(w.replace("DATA", str(data)) for w in arm.new), "--out", str(folder / name))
    return str(folder / name)


def imported(file: Path, arm: str, words: tuple[str, ...], out: Path) -> Path:
    """The recording as a file with declared columns and units. A ur_rtde file is one already."""
    if file.read_text().startswith("timestamp,"):
        return file
    if not out.is_dir():
        _need("import", str(file), "--arm", arm, "--yes", *words, "--out", str(out))
    return next(out.glob("*.mcap"))


def _need(*words: str) -> None:
    code, printed = called(*words)
    if code:
        raise RuntimeError(f"calib {words[0]}: exit {code}: {printed[-300:]}")


def identified(name: str, arm: Arm, data: Path, folder: Path) -> None:
    """Identify the arm from its first recordings, once."""
    if (out := folder / f"identified_{name}").is_dir():
        return
    where = made(arm, name, data, folder)
    first = [imported(data / f, where, arm.words, folder / f"first_{name}_{k}") for k, f in enumerate(arm.files[:2])]
    called("identify", where, *map(str, first), "--out", str(out))


def accepted(name: str, arm: Arm, file: str, data: Path, folder: Path) -> dict[str, str]:
    """Output of each command that refused the recording."""
    where, identified = made(arm, name, data, folder), folder / f"identified_{name}"
    out: dict[str, str] = {}
    stem = file.replace("/", "_").removesuffix(".csv")
    try:
        log = imported(data / file, where, arm.words, folder / f"import_{stem}")
    except RuntimeError as error:
        return {"import": str(error)}
    for command in COMMANDS:
        of = where if command == "identify" else str(identified / "arm")
        extra = ("--no-forward",) if command == "validate" else ()
        code, printed = called(command, of, str(log), *extra, "--out", str(folder / f"{command}_{stem}"))
        if code not in (0, 1) and not any(words in printed for words in STANDS):
            out[command] = f"exit {code}: {printed[-300:]}"
    return out


def repaired(source: Path, target: Path) -> int:
    """Write the Panda's recording without repeated samples and with whole control periods between samples, as dq demands.

    Returns the number of repeats.
    """
    head, *lines = source.read_text().splitlines()
    names, table = head.split(","), np.array([line.split(",") for line in lines], dtype=float)
    q = table[:, [k for k, c in enumerate(names) if c[0] == "q" and c[1:].isdigit()]]
    dq = table[:, [k for k, c in enumerate(names) if c[:2] == "dq"]]
    fresh = np.r_[True, np.any(np.diff(q, axis=0) != 0, axis=1)]
    table, q, dq = table[fresh], q[fresh], dq[fresh]
    speed = 0.5 * (dq[1:] + dq[:-1])
    passed = (speed * np.diff(q, axis=0)).sum(axis=1) / np.maximum((speed**2).sum(axis=1), 1e-12)
    slow = (speed**2).sum(axis=1) < 0.01  # too slow to judge by dq: use the stamps
    periods = np.where(slow, np.diff(table[:, 0]) / PERIOD, passed / PERIOD)
    table[:, 0] = table[0, 0] + np.r_[0.0, np.cumsum(np.maximum(np.rint(periods), 1))] * PERIOD
    np.savetxt(target, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return int((~fresh).sum())


def panda(data: Path, folder: Path) -> list[float]:
    """Error on unfitted samples of the recording as published, over that of its repaired copy.

    Values: one per joint, their mean, and the mean if each arm is tested on its own recording.
    """
    source = data / "panda" / "excitation_0_15s.csv"
    copy = folder / "repaired.csv"
    repaired(source, copy)
    arm = made(Arm(SETS["panda"].new, ()), "panda", data, folder)
    found = []
    for name, file in (("published", source), ("repaired", copy)):
        head, *lines = file.read_text().splitlines(keepends=True)
        t = np.array([float(line.split(",", 1)[0]) for line in lines])
        pieces = []
        for part, keep in (("fit", t - t[0] < UNTIL), ("test", t - t[0] >= UNTIL)):
            table = folder / f"{name}_{part}.csv"
            table.write_text(head + "".join(line for line, k in zip(lines, keep, strict=True) if k))
            pieces.append((imported(table, arm, (), folder / f"import_{name}_{part}"), table))
        called("identify", arm, str(pieces[0][0]), "--out", str(folder / f"of_{name}"))
        found.append((folder / f"of_{name}" / "arm", pieces[1]))
    # both arms predict the last seconds of the repaired copy, so that they share one truth
    rmse = [score(where, SETS["panda"], [found[1][1]], folder, where.parent.name)[0] for where, _ in found]
    own = score(found[0][0], SETS["panda"], [found[0][1]], folder, "as_published")[0]
    return [*(rmse[0] / rmse[1]).tolist(), float((rmse[0] / rmse[1]).mean()), float((own / rmse[1]).mean())]


def run(minutes: float = 10.0) -> list[dict[str, Any]]:
    """Try recordings for `minutes`; return rows (what, value, unit, bar, note) over all tried so far."""
    if "ARM_CALIB_DATA" not in os.environ:
        raise RuntimeError("ARM_CALIB_DATA is not set: the real recordings are not part of this project")
    data, end = Path(os.environ["ARM_CALIB_DATA"]), time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "published.jsonl", " ".join(digest(path) for path in MEASURES))
    everything = [(name, arm, file) for name, arm in arms(data).items() for file in arm.files]
    with tempfile.TemporaryDirectory(prefix="calib-published-") as place:
        warm(sim, logs, drivers, safety, calib)

        def jobs() -> Iterator[tuple[str, Callable[[], Any]]]:
            if "panda" not in kept.found:
                made(Arm(SETS["panda"].new, ()), "panda", data, Path(place))
                yield "panda", partial(panda, data, Path(place))
            for name, arm, file in everything:
                if file not in kept.found:
                    identified(name, arm, data, Path(place))
                    yield file, partial(accepted, name, arm, file, data, Path(place))

        for done in forked(jobs(), LONGEST, end):
            if done.fault and done.key == "panda":
                raise RuntimeError(f"the Panda as published and repaired: {done.fault}")
            kept.keep(done.key, {"fault": done.fault} if done.fault else done.value)
    tried = {file: kept.found[file] for _, _, file in everything if file in kept.found}
    refused = {file: found for file, found in tried.items() if found}
    *joints, mean, own = kept.found["panda"]
    first = "; ".join(f"{file}: {json.dumps(found)[:200]}" for file, found in list(refused.items())[:3])
    return [
        {"what": "recordings given to identify, validate and diagnose", "value": len(tried), "bar": str(len(everything)),
         "note": f"all of seven sets but {BROKEN}"},
        {"what": "of them refused by any command", "value": len(refused), "bar": "0", "note": first},
        {"what": "Panda: error of the arm identified as published, over that of its repaired copy", "value": round(mean, 3),
         "bar": f"<= {1 + MOST_DIFFERENCE:.2f}", "note": f"joints {' '.join(f'{x:.2f}' for x in joints)}; each on its own recording {own:.3f}"},
    ]  # fmt: skip
