"""The first day on a UR, against the emulated controller: running programs, wrong arms, and every model with every PolyScope.

A run continues where the last one stopped (build/first_day.jsonl), for `minutes` at a time. Commands run in forked children.
The controller runs in its own process and counts programs that an upload has ended.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
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
from benchmarks.results import digest
from benchmarks.ur_cell import ur_cell
from benchmarks.ur_load import motion
from calib.main import main as program
from drivers import open_driver
from drivers.ur_rtde import family
from safety.plan import Motion, write_plan
from sim.arm import load_arm
from sim.cell import load_arm_of, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.robot import PAUSED, PLAYING
from sim.errors import CalibError

MEASURES = ("benchmarks.first_day", "drivers/ur_rtde", *commands("check", "record", "capture", "watch"))
OPTIONS = {"serial": "20230000000", "frame_timeout": 0.5, "setpoint_timeout": 0.5, "watchdog": 4.0}
LONGEST = 60.0  # s, time limit of a command
# commands as a person types them; CELL, PLAN and OUT are replaced by paths. `calib go` runs these commands in turn
COMMANDS = {
    "check": ["check", "CELL", "--seconds", "0.5"],
    "check --move": ["check", "CELL", "--seconds", "0.5", "--move", "--yes"],
    "record": ["record", "CELL", "PLAN", "--yes", "--out", "OUT"],
    "capture": ["capture", "CELL", "--seconds", "0.5", "--out", "OUT"],
    "watch": ["watch", "CELL", "--seconds", "0.5", "--out", "OUT"],
}
STATES = {"program_played": PLAYING, "program_paused": PAUSED}
# PolyScope versions tried: CB3, e-Series and PolyScope X
VERSIONS = ("3.15.4", *(f"5.{minor}.0" for minor in range(4, 27)), *(f"10.{minor}.0" for minor in range(7, 13)))
EACH = 10  # tries of each command per controller
STREAMED = 0.3  # s


def controller(path: str, fault: str, talk: Connection) -> None:
    """Run the controller with somebody else's program. Reply to each message with its state and what an upload has ended."""
    cell = load_cell(path)
    emulator = open_emulator(cell, load_arm_of(cell))
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    emulator.inject(fault)
    robot = emulator.robot
    end = time.monotonic() + 10.0
    while robot.runtime_state != STATES[fault] and time.monotonic() < end:
        time.sleep(0.01)
    talk.send("ready")
    while talk.recv() != "end":
        talk.send((int(robot.runtime_state), list(robot.ended)))
    emulator.stop()


@contextlib.contextmanager
def playing(folder: Path, number: int, fault: str) -> Iterator[tuple[Path, Connection]]:
    """A cell file whose controller plays a program or has paused one, and the pipe to it."""
    path = ur_cell(folder / "cell.toml", f"127.0.0.{130 + number % 100}", options=OPTIONS)
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=controller, args=(str(path), fault, theirs))
    process.start()
    theirs.close()
    ours.recv()
    try:
        yield path, ours
    finally:
        ours.send("end")
        process.join()


def tried(words: list[str], places: dict[str, str]) -> int:
    """Run one command; return its exit code."""
    return program([places.get(word, word) for word in words])


def programs(number: int, tries: int) -> dict[str, Any]:
    """Try every command `tries` times beside a program: exit codes, and how often the program did not continue unchanged."""
    fault = tuple(STATES)[number % len(STATES)]
    out: dict[str, Any] = {"ended": [], "codes": {}, "faults": []}
    with tempfile.TemporaryDirectory(prefix="calib-") as name, playing(Path(name), number, fault) as (path, talk):
        folder = Path(name)
        cell = load_cell(path)
        arm = load_arm_of(cell)
        write_plan(folder / "plan", arm, [Motion("motion", "excitation", motion(np.array(cell.table.home), 4.0))], cell)
        for what, words in COMMANDS.items():
            for k in range(tries):
                places = {"CELL": str(path), "PLAN": str(folder / "plan"), "OUT": str(folder / f"{what.replace(' ', '')}{k}")}
                (done,) = forked([(what, partial(tried, words, places))], LONGEST, workers=1)
                if done.fault:
                    out["faults"].append(f"{what}: {done.fault[-200:]}")
                else:
                    out["codes"].setdefault(what, []).append(done.value)
                talk.send("look")
                state, ended = talk.recv()
                if state != STATES[fault] or ended:
                    out["ended"].append(f"{what}: {fault} became {state}, {ended}")
    return out


def met(name: str, polyscope: str, number: int, real: str | None = None) -> str:
    """`works` if the driver connects and streams to the arm, else its error message. real: arm present (default `name`)."""
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        path = ur_cell(
            Path(folder) / "cell.toml", f"127.0.{1 + number // 200}.{1 + number % 200}", options=OPTIONS,
            **{"emulation.options": {"polyscope": polyscope}},
        )  # fmt: skip
        path.write_text(path.read_text(encoding="utf-8").replace('arm = "ur10e"', f'arm = "{name}"'), encoding="utf-8")
        cell = load_cell(path)
        arm = load_arm(name)
        emulator, driver = open_emulator(cell, load_arm(real or name)), open_driver(cell, arm)
        emulator.start()
        try:
            driver.connect()
            state = driver.read()
            for _ in range(round(STREAMED * driver.rate)):
                driver.send(state.q, np.zeros(arm.n), np.zeros(arm.n))
                driver.read()
            return "works"
        except CalibError as error:
            return str(error)
        finally:
            driver.close()
            emulator.stop()


def pairs() -> list[tuple[str, str]]:
    """Every shipped arm with every PolyScope version of its controller type."""
    return [(name, v) for name, (_, cb3) in family.FAMILY.items() for v in VERSIONS if cb3 == v.startswith("3.")]


def wrong_arms() -> list[str]:
    """Arms that are wrong in the cell of a UR10e. The UR12e is not: it is a UR10e with a higher rating."""
    return [name for name in family.FAMILY if name not in ("ur10e", "ur12e")]


def run(minutes: float = 10.0, tries: int = 100) -> list[dict[str, Any]]:
    """Measure for `minutes`; return rows (what, value, unit, bar, note) over everything found so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "first_day.jsonl", " ".join(digest(path) for path in MEASURES))
    warm(sim, logs, drivers, safety, calib)
    jobs: list[tuple[str, Callable[[], Any]]] = []
    for number, name in enumerate(wrong_arms()):
        version = "3.15.4" if family.FAMILY[name][1] else "5.25.1"
        jobs.append((f"wrong {name}", partial(met, "ur10e", version, number, name)))
    jobs += [(f"model {name} {v}", partial(met, name, v, 100 + number)) for number, (name, v) in enumerate(pairs())]
    for number in range(tries // EACH):
        if (what := f"programs {number}") not in kept.found and time.monotonic() < end:
            kept.keep(what, programs(number, EACH))
    for what, job in jobs:
        if what not in kept.found and time.monotonic() < end:
            (done,) = forked([(what, job)], LONGEST, workers=1)
            kept.keep(what, {"sentence": done.value if not done.fault else f"fault: {done.fault[-300:]}"})
    return rows(kept.found, tries)


def rows(found: dict[str, Any], tries: int) -> list[dict[str, Any]]:
    """Rows on programs, wrong arms and versions."""
    out = []
    rounds = [value for what, value in found.items() if what.startswith("programs")]
    if rounds:
        ended = [sentence for value in rounds for sentence in value["ended"]]
        faults = [sentence for value in rounds for sentence in value["faults"]]
        codes = {what: sorted({c for value in rounds for c in value["codes"].get(what, [])}) for what in COMMANDS}
        note = f"{EACH * len(rounds)} of {tries} tries of each of {', '.join(COMMANDS)}; playing and paused in turn; exit codes {codes}"
        note += f"; {len(faults)} ended otherwise: {faults[0]}" if faults else ""
        first = f"; first: {ended[0]}" if ended else ""
        out.append(
            {"what": "UR: programs of others that a command ended", "value": len(ended), "bar": "0", "note": note + first}
        )
    wrong = {what.split()[1]: value["sentence"] for what, value in found.items() if what.startswith("wrong")}
    if wrong:
        named = [name for name, sentence in wrong.items() if re.search(rf"this looks like a .*\b{name}\b", sentence)]
        others = [f"{name}: {sentence[:150]}" for name, sentence in wrong.items() if name not in named]
        note = f"in the cell of a ur10e answers a {', '.join(wrong)}" + (f"; not: {'; '.join(others)}" if others else "")
        out.append(
            {
                "what": "UR: wrong arms that are refused and named",
                "value": len(named),
                "bar": str(len(wrong_arms())),
                "note": note,
            }
        )
    models = {what.removeprefix("model "): value["sentence"] for what, value in found.items() if what.startswith("model")}
    if models:
        works = [what for what, sentence in models.items() if sentence == "works"]
        says = {what: s for what, s in models.items() if re.search("PolyScope|update|older", s)}
        neither = {what: s for what, s in models.items() if s != "works" and what not in says}
        refused = sorted({what.split()[1] for what in says})
        note = (
            f"{len(works)} connect and stream; {len(says)} say that {', '.join(refused)} is older than the driver was made for"
            if says
            else f"{len(works)} connect and stream"
        )
        note += f"; neither: {next(iter(neither.items()))}" if neither else ""
        out.append(
            {
                "what": "UR: models x PolyScope 3.15, 5.4 to 5.26, 10.7 to 10.12 that work or say what is missing",
                "value": len(works) + len(says),
                "bar": str(len(pairs())),
                "note": f"{len(models)} tried; {note}",
            }
        )
    return out
