"""A whole plant with `calib fleet` on local workers, killed and resumed: arms per minute, and correct diagnoses."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq

from benchmarks.fleet.recordings import plant
from benchmarks.fleet.workers import ENVIRONMENT, kill_a_worker, row
from calib.fleet.fleet import ANSWER, ARMS
from sim.arm import ArmEffect

MEASURED, MOST = (200, 300.0), 25  # arms and seconds that the bar applies to; the bar in minutes


def pace(folder: Path, arms: int, seconds: float, diagnose: bool = True, workers: int = 2) -> list[dict[str, Any]]:
    """Kill the command with all its workers after a third of the arms, call it again, and kill one worker after two thirds."""
    place = folder / f"pace-{arms}x{seconds:g}"
    hidden, out = plant(place / "logs", arms, seconds), place / "out"
    shutil.rmtree(out, ignore_errors=True)
    third = max(1, arms // 3)
    before, wall = _processors(), 0.0
    wall += _called(place, workers, diagnose, third, whole=True)
    kept = {file: file.stat().st_mtime_ns for file in answers(out)}
    wall += _called(place, workers, diagnose, 2 * third, whole=False)
    busy, passed = (b - a for a, b in zip(before, _processors(), strict=True))
    rows = pq.read_table(out / "fleet.parquet").to_pylist()
    twice = sum(file.stat().st_mtime_ns != when for file, when in kept.items())
    spent = sum(r["cpu_seconds"] or 0.0 for r in rows)
    named = sum(is_named(r, hidden.get(r["cell"])) for r in rows)
    far = {r["cell"] for r in rows if abs(r["outlier_score"] or 0) > 4}
    return [
        row(f"{what(arms, seconds, diagnose)}: {workers} local workers, killed and resumed", f"{wall / 60:.1f}", "min",
            f"<= {MOST}" if (arms, seconds) == MEASURED else "",
            f"{arms / wall * 60:.2f} arms/min, {spent / arms:.1f} s CPU an arm; of the processors' time {busy / passed:.0%} was used, "
            f"{spent / passed:.0%} by the arms"),
        row("arms done", sum(r["status"] == "done" for r in rows), "", f"{arms}",
            f"{len(kept)} when the command was killed, one worker killed later"),
        row("arms lost or done twice", arms - len({r["arm"] for r in rows}) + twice, "", "0"),
        row("arms whose diagnosis is the hidden effect alone, or none where none is hidden", f"{named}/{arms}", "", "",
            f"{len(hidden)} have one; named otherwise: {_otherwise(rows, hidden)}"),
        row("arms reported as unlike their siblings, with an effect / without", f"{len(far & set(hidden))}/{len(far - set(hidden))}"),
    ]  # fmt: skip


def what(arms: int, seconds: float, diagnose: bool) -> str:
    """Description of the plant."""
    return f"{arms} arms x {seconds / 60:g} min" + ("" if diagnose else ", without diagnosis")


def answers(out: Path) -> list[Path]:
    """Files that mark an arm as done."""
    return sorted((out / ARMS).glob(f"*/{ANSWER}"))


def _called(place: Path, workers: int, diagnose: bool, kill_at: int, whole: bool) -> float:
    """Call the command; once `kill_at` arms are done, kill everything (`whole`) or one worker. Wall time, s."""
    words = ["fleet", str(place / "logs"), "--out", str(place / "out"), "--workers", str(workers)]
    command = [sys.executable, "-m", "calib", *words, *([] if diagnose else ["--no-diagnose"])]
    begin = time.perf_counter()
    with (place / "calls.txt").open("ab") as said:
        call = subprocess.Popen(command, env=ENVIRONMENT, stdout=said, stderr=said, start_new_session=True)
        killed = False
        while call.poll() is None:
            time.sleep(0.2)
            if not killed and len(answers(place / "out")) >= kill_at:
                killed = True
                if whole:
                    own = psutil.Process(call.pid).children(recursive=True)
                    os.killpg(call.pid, signal.SIGKILL)
                    psutil.wait_procs(own)
                else:
                    kill_a_worker()
    if not killed or call.returncode not in ((-signal.SIGKILL,) if whole else (0, 1)):
        raise RuntimeError(f"calib fleet ended with {call.returncode}; what it said is in {place / 'calls.txt'}")
    return time.perf_counter() - begin


def _processors() -> tuple[float, float]:
    """Busy time and total time of this computer's processors, s."""
    now = psutil.cpu_times()
    whole = now.user + now.nice + now.system + now.idle + now.iowait + now.irq + now.softirq + now.steal
    return whole - now.idle - now.iowait, whole


def is_named(r: dict[str, Any], hidden: ArmEffect | None) -> bool:
    """Whether a row names the hidden effect and no other."""
    found = [(e["effect"], e["joint"]) for e in r.get("effects") or ()]
    return found == ([] if hidden is None else [(hidden.effect, hidden.joint)])


def _otherwise(rows: list[dict[str, Any]], hidden: dict[str, ArmEffect]) -> str:
    wrong = [r for r in rows if not is_named(r, hidden.get(r["cell"]))]
    texts = [
        "+".join(f"{e['effect']} {e['joint'] or ''}".strip() for e in r["effects"] or ()) or r["verdict"] or "" for r in wrong
    ]
    return "; ".join(f"{r['cell']} {t}" for r, t in zip(wrong, texts, strict=True)) or "none"
