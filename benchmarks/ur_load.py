"""A UR on a busy computer, used as an operator does: a long recording, and whether each fault is named correctly.

`calib record` runs as a command with its control and monitor processes. From the moment it takes control, BUSY processes that
never wait run beside it. One robot at a time: two with their controllers occupy both cores at real-time priority. A run
continues where the last one stopped (build/ur_load.jsonl), for `minutes` at a time: `make ur-load`. A recording begins only if
it fits into the remaining time, so the longest needs a run of twelve minutes. The emulated controller shares the computer too.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.forked import forked
from benchmarks.imports import commands
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import digest
from benchmarks.ur_cell import ur_cell
from logs.read import read_log
from safety.plan import Motion, write_plan
from sim.cell import load_arm_of, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.trajectory import Trajectory

BUSY = 2
PRIORITY = 50
# emulator fault -> pattern that its message must match, with alternatives where the wire shows the same for two causes
NAMES = {
    "protective_stop": "protective stop", "emergency_stop": "emergency stop", "slider_moved": "speed slider|scales the speed",
    "program_stopped": "control program is (stopped|stopping)", "second_client": "control program is|program .* plays",
    "cable_pulled": "no new reading", "close": "closed|no new reading|connection", "freeze": "stands still|no new reading",
    "reduced_mode": "reduced mode",
}  # fmt: skip
MOTION = 6.0  # s; a fault comes at about 2 s, while the arm moves fast
WAIT = 240.0  # s, for everything before and after a motion
MEASURES = ("benchmarks.ur_load", "drivers/ur_rtde", *commands("record"))
OPTIONS: dict[str, object] = {"serial": "20230000000", "frame_timeout": 0.1, "watchdog": 4.0}
SERVO: dict[str, object] = {"lookahead": 0.03, "gain": 1200.0}
AHEAD: dict[str, object] = SERVO | {"ahead": 0.05}
# name, s, driver options: the longest, which needs a slice of its own, then streamed and sent ahead with the same servoj
# settings
RECORDINGS = (("sent ahead", 600.0, AHEAD), ("streamed", 60.0, SERVO), ("sent ahead", 60.0, AHEAD))
Wanted = tuple[str, float, str | None, dict[str, object]]
DELAYS = np.arange(0.0, 0.2, 0.002)  # s, delays tried between commands and arm
LIMITS: dict[str, object] = {"latency": 0.1, "following_error": 0.025}


@contextlib.contextmanager
def busy() -> Iterator[None]:
    """BUSY processes that never wait, beside whatever else this computer does."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def motion(home: np.ndarray, seconds: float) -> Trajectory:
    """Sines about home under a sin^4 window, whose velocity and acceleration are zero at both ends."""
    t = np.linspace(0, seconds, round(100 * seconds) + 1)[:, None]
    p, w, size = np.pi / seconds, 2 * np.pi / 5.0, np.array([0.2, 0.1, 0.15, 0.2, 0.2, 0.2])
    s, c = np.sin(p * t), np.cos(p * t)
    a, da, dda = s**4, 4 * p * s**3 * c, 4 * p**2 * (3 * s**2 * c**2 - s**4)
    x, dx, ddx = size * np.sin(w * t), size * w * np.cos(w * t), -size * w**2 * np.sin(w * t)
    return Trajectory(t[:, 0], home + a * x, da * x + a * dx, dda * x + 2 * da * dx + a * ddx)


def controlled(path: str, fault: str | None, talk: Connection) -> None:
    """Run the controller in its own process, ahead of all others in priority: a real one has its own computer."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    cell = load_cell(path)
    emulator = open_emulator(cell, load_arm_of(cell))
    assert isinstance(emulator, UrEmulator)
    emulator.start()
    talk.send("ready")
    began, plays, injected = 0.0, False, False
    while not talk.poll(0.05):
        if emulator.robot.program_running and not plays:
            plays = True
            talk.send("control is taken")
        if not began and float(np.max(np.abs(emulator.robot.target_qd))) > 0.01:
            began = time.monotonic()
        if fault and not injected and began and time.monotonic() - began > 1.0:
            emulator.inject(fault)
            injected = True
    emulator.stop()
    talk.send(injected)


def loaded(line: list[str], folder: Path, longest: float, talk: Connection) -> tuple[int, str]:
    """Exit code and output of a command; from the message that control is taken, BUSY processes run beside it."""
    with contextlib.ExitStack() as load, (folder / "words").open("w+b") as words:
        command = subprocess.Popen(line, stdout=words, stderr=subprocess.STDOUT, cwd=folder)
        end = time.monotonic() + longest
        while command.poll() is None and time.monotonic() < end:
            if talk.poll(0.05):
                talk.recv()
                load.enter_context(busy())
        if command.poll() is None:
            command.kill()
        code = command.wait()
        words.seek(0)
        return code, words.read().decode("utf-8", "replace")


def off_the_plan(t: np.ndarray, q: np.ndarray, planned: Trajectory) -> tuple[float, float, float]:
    """Delay, s, of the measured motion, and its deviation from the plan with that delay: RMS and largest over joints, mrad."""
    best = (np.inf, 0.0, 0.0)
    for delay in DELAYS:
        there = np.stack([np.interp(t - t[0] - delay, planned.t, x) for x in planned.q.T], axis=1)
        off = q - there
        best = min(best, (float(np.sqrt(np.mean(off**2))), float(np.max(np.abs(off))), float(delay)))
    return best[2], 1e3 * best[0], 1e3 * best[1]


def recorded(
    folder: Path, last: int, seconds: float, fault: str | None, options: dict[str, object] | None = None
) -> dict[str, Any]:
    """One `calib record` of a motion of `seconds`; the fault comes one second after the arm begins to move."""
    path = ur_cell(folder / "busy.toml", f"127.0.0.{last}", options=OPTIONS | (options or {}), motion=LIMITS)
    cell = load_cell(path)
    arm = load_arm_of(cell)
    plan = Motion("excitation", "excitation", motion(np.array(cell.table.home), seconds))
    write_plan(folder / "plan", arm, [plan], cell)
    talk, theirs = multiprocessing.Pipe()
    controller = multiprocessing.get_context("fork").Process(target=controlled, args=(str(path), fault, theirs))
    controller.start()
    talk.recv()
    line = [sys.executable, "-m", "calib", "record", str(path), str(folder / "plan"), "--yes", "--out", str(folder / "logs")]
    try:
        code, printed = loaded(line, folder, WAIT + 1.2 * seconds, talk)
    finally:
        talk.send("end")
        while not isinstance(injected := talk.recv(), bool):
            pass  # the message that control was taken, sent as the command ended
        controller.join()
    words = " ".join(printed.split())
    out: dict[str, Any] = {"exit": code, "injected": injected, "load": os.getloadavg()[0]}
    if fault:
        out["named"] = bool(re.search(NAMES[fault], words.rpartition("calib: ")[2]))  # in the final message
    if not (fault and out["named"]):
        out["said"] = words[-400:]
    logs = sorted((folder / "logs").glob("**/*.mcap"))
    if not fault and logs:
        log = read_log(logs[0], accept_partial=True)
        steps = np.diff(log.t)
        marks = [e.message for e in log.events if e.name == "gap"]
        gaps = np.rint(steps * 500.0) - 1
        out |= {
            "seconds": float(log.t[-1] - log.t[0]),
            "samples": len(log.t),
            "lost": int(gaps.sum()),
            "gaps": int(np.sum(gaps > 0)),
        }
        out |= {"longest": 1e3 * float(steps.max()), "marks": len(marks), "off": off_the_plan(log.t, log.q, plan.trajectory)}
    return out


def in_a_folder(last: int, seconds: float, fault: str | None, options: dict[str, object]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        return recorded(Path(folder), last, seconds, fault, options)


def run(minutes: float = 12.0, repeats: int = 50) -> list[dict[str, Any]]:
    """Measure for `minutes`; return rows (what, value, unit, bar, note) over everything found so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "ur_load.jsonl", " ".join(digest(path) for path in MEASURES))

    long, *short = [(f"recording of {seconds:g} s, {how}", seconds, None, options) for how, seconds, options in RECORDINGS]
    injected: list[Wanted] = [(f"{fault} {k}", MOTION, fault, {}) for k in range(repeats) for fault in NAMES]
    wanted: list[Wanted] = [long, *injected[: len(NAMES)], *short, *injected[len(NAMES) :]]

    def jobs() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
        for number, (what, seconds, fault, options) in enumerate(wanted):
            if what not in kept.found and time.monotonic() + (0.0 if fault else seconds) < end:
                yield what, partial(in_a_folder, 40 + number % 100 if fault else 30 + number, seconds, fault, options)

    for done in forked(jobs(), 2 * WAIT + 1.2 * RECORDINGS[0][1], end, workers=1):
        failed = {"exit": None, "injected": True, "load": os.getloadavg()[0], "named": False, "said": done.fault}
        kept.keep(done.key, done.value or failed)
    rows = []
    for what, found in kept.found.items():
        if what.startswith("recording"):
            value = (
                f"{found['samples']} samples, {found['lost']} lost in {found['gaps']} gaps" if "samples" in found else "no log"
            )
            note = f"exit code {found['exit']}, load {found['load']:.1f}, longest step {found.get('longest', 0):.0f} ms; {found.get('said', '') if found['exit'] else ''}"
            if "off" in found:
                delay, middle, most = found["off"]
                value_off = f"{middle:.2f} / {most:.2f}"
                rows.append(
                    {
                        "what": f"{what}: off the plan, rms / largest",
                        "value": value_off,
                        "unit": "mrad",
                        "bar": "",
                        "note": f"after a delay of {1e3 * delay:.0f} ms",
                    }
                )
            rows.append(
                {
                    "what": f"{what}: finished with gaps marked",
                    "value": value,
                    "bar": "every gap marked",
                    "note": f"{found.get('marks', 0)} marks; {note}",
                }
            )
    for fault in NAMES:
        runs = [found for what, found in kept.found.items() if what.rpartition(" ")[0] == fault]
        met = [found for found in runs if found["injected"]]
        early = [found for found in runs if not found["injected"]]
        wrong = [found["said"] for found in met if not found["named"]]
        note = f"{len(runs)} of {repeats} runs, {len(early)} ended before the fault" + (
            f"; first unnamed: {wrong[0][-200:]}" if wrong else ""
        )
        if runs:
            rows.append(
                {
                    "what": f"{fault}: named by its own name",
                    "value": f"{sum(f['named'] for f in met)} of {len(met)}",
                    "bar": "all",
                    "note": note,
                }
            )
    return rows
