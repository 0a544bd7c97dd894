"""From one arm to a fleet: an hour in seconds, cost over length, arms a minute on two engines, a worker killed in the middle.

The recordings are made here: Fourier motion, torque by `sim.prediction` of arms that vary about their model, encoder and torque noise.
Workers and scheduler share this computer with everything else that runs on it, so CPU time stands beside wall time.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks import ONE_THREAD
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.fleet.fleet import Fleet, Progress, Settings, run_fleet
from logs.convert import write_log
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
MODEL = "ur10e"
PERIOD = 20.0
HIDDEN = (
    ArmEffect("payload", None, {"mass": 3.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05}),
    ArmEffect("joint_spring", "elbow_joint", {"stiffness": 20.0, "rest_angle": 0.0}),
    ArmEffect("torque_offset", "shoulder_lift_joint", {"offset": 9.0}),
)
HIDDEN_EVERY = 10
START = 1_750_000_000
DAY = 86_400
LENGTHS = (1.0, 3.0, 10.0, 30.0, 60.0)  # minutes; 600 takes a quarter of an hour to make, and 5 GB of disk
FILE_MINUTES = 60.0
ENVIRONMENT = os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parent.parent), os.environ.get("PYTHONPATH", "")])}  # fmt: skip


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {
        "what": what,
        "value": value,
        "unit": unit,
        "bar": bar,
        "note": f"{note}; load {os.getloadavg()[0]:.1f}".strip("; "),
    }


def motion(arm: Arm, seed: int, seconds: float, rate: float) -> Trajectory:
    """A Fourier motion of PERIOD s again and again, within the arm's speed and acceleration."""
    basis = Basis(6, PERIOD)
    chosen = random_fourier(basis, HOME, np.random.default_rng(seed))
    t = np.linspace(0, PERIOD, 400)
    speed = np.abs(basis.matrix(t, 1) @ chosen.x.T).max(axis=0)
    push = np.abs(basis.matrix(t, 2) @ chosen.x.T).max(axis=0)
    factor = np.minimum(0.7 * arm.dq_max / speed, 0.9 * arm.ddq_max / push)
    once = Fourier(basis, HOME, chosen.x * factor[:, None]).sampled(rate)
    count = round(seconds * rate)
    turn = np.arange(count) % round(PERIOD * rate)
    return Trajectory(np.arange(count) / rate, once.q[turn], once.dq[turn], once.ddq[turn])


def recorded(arm: Arm, path: Trajectory, seed: int) -> Log:
    """What the arm's sensors say of the motion."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(path.q.shape) * np.array(arm.sensors.torque_noise)
    step = arm.sensors.encoder_resolution
    q = np.round((path.q + step * rng.uniform(-0.5, 0.5, path.q.shape)) / step) * step
    nan = np.full(path.q.shape, np.nan)
    return Log(arm.joint_names, path.t, path.t, q, path.dq, predict(arm, path) + noise, nan, nan, path.q, path.dq, nan)


def individual(arm: Arm, seed: int, spread: float = 0.05) -> Arm:
    """An arm that differs from its model as arms of one make do: friction, rotors and masses off by about `spread`."""
    rng = np.random.default_rng(seed)
    mass = arm.tree.mass * (1 + 0.3 * spread * rng.standard_normal(arm.n))
    tree = replace(arm.tree, mass=mass, inertia=arm.tree.inertia * (mass / arm.tree.mass)[:, None, None])
    effects = [
        ArmEffect(e.effect, e.joint, {k: v * (1 + spread * rng.standard_normal()) for k, v in e.parameters.items()})
        for e in arm.effects
    ]
    return replace(arm, tree=tree, effects=tuple(effects))


def write_recording(file: Path, arm: Arm, log: Log, cell: str, serial: str, kind: str, day: int) -> None:
    """A recording as `calib record` would leave it: finished, and saying whose it is."""
    words = {
        "arm": arm.name, "arm_sha256": arm.sha256, "cell": cell, "serial": serial, "motion": kind, "end_reason": "completed",
        "wall_clock_start_ns": str((START + day * DAY) * 10**9),
    }  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, file, "clean", words)


def plant(folder: Path, arms: int, seconds: float, rate: float = 125.0) -> dict[str, ArmEffect]:
    """A folder of recordings of that many arms; every HIDDEN_EVERY-th has an effect that its model lacks: cell -> effect."""
    model = load_arm(MODEL)
    hidden = {}
    for k in range(arms):
        cell = f"cell-{k:03d}"
        truth = individual(model, k)
        if k % HIDDEN_EVERY == 3:
            hidden[cell] = HIDDEN[k // HIDDEN_EVERY % len(HIDDEN)]
            truth = with_effect(truth, hidden[cell])
        log = recorded(truth, motion(model, k % 7, seconds * 0.8, rate), k)
        write_recording(folder / cell / "excitation.mcap", model, log, cell, f"S{k:05d}", "excitation", 0)
        log = recorded(truth, motion(model, 7 + k % 5, seconds * 0.2, rate), 10_000 + k)
        write_recording(folder / cell / "validation.mcap", model, log, cell, f"S{k:05d}", "validation", 0)
    return hidden


# VmHWM is this process's own peak; ru_maxrss would begin at that of the process that started it
HOUR = """
import json, re, sys, tempfile, time
from pathlib import Path
from calib.identification.identify import identify
from logs import Pieces, open_pieces
from sim.arm import load_arm
arm = load_arm("ur10e")
wall, cpu = time.perf_counter(), time.process_time()
with tempfile.TemporaryDirectory() as scratch:
    pieces = Pieces.joined(open_pieces(Path(f), arm.joint_names, Path(scratch) / str(k)) for k, f in enumerate(sys.argv[1:]))
    read = time.process_time() - cpu
    found = identify(arm, pieces)
spent = time.process_time() - cpu
peak = int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
print(json.dumps([time.perf_counter() - wall, spent, read, peak, float(found.result.training.after.mean())]))
"""


def length(minutes: tuple[float, ...] = LENGTHS) -> list[dict[str, Any]]:
    """Reading and identifying recordings of several lengths at 500 Hz: CPU time, memory, and the power of length that fits the cost."""
    arm = load_arm(MODEL)
    truth = individual(arm, 0)
    rows, found = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for m in minutes:
            # ten hours are a shift of recordings of an hour each, with the same motion and fresh noise
            files = [Path(scratch) / f"{m:g}-{k}.mcap" for k in range(math.ceil(m / FILE_MINUTES))]
            for k, file in enumerate(files):
                _long(file, truth, arm, min(m, FILE_MINUTES), k)
            answer = subprocess.run(
                [sys.executable, "-c", HOUR, *map(str, files)], env=ENVIRONMENT, check=True, capture_output=True, text=True
            ).stdout
            wall, spent, read, peak, _ = json.loads(answer)
            found.append((m, spent, peak))
            hour = m == 60
            rows.append(
                row(
                    f"{m:g} min at 500 Hz: read and identify, CPU",
                    f"{spent:.1f}",
                    "s",
                    "<= 20" if hour else "",
                    f"of it reading {read:.1f}, wall {wall:.1f}",
                )
            )
            rows.append(row(f"{m:g} min at 500 Hz: resident memory", f"{peak:.0f}", "MB", "< 1000" if hour else ""))
            for file in files:
                file.unlink()
    m, spent, peak = np.array(found).T
    slope, fixed = np.polyfit(m, spent, 1)
    off = np.abs(fixed + slope * m - spent).max() / spent.max()
    rows.append(
        row(
            "cost over length, CPU",
            f"{fixed:.2f} s + {slope:.3f} s/min",
            "",
            "linear",
            f"farthest from the line {off:.1%} of the longest",
        )
    )
    longest = m >= 10
    if longest.sum() > 1:
        rows.append(row("memory from 10 min to the longest", f"{peak[longest].max() / peak[longest].min():.2f}", "times", "1"))
    return rows


NAMES = """
import json, re, sys, tempfile, time
from pathlib import Path
from calib.diagnosis.whole import diagnose_pieces
from logs import open_pieces, read_log
from sim.arm import load_arm
arm = load_arm("ur10e")
wall, cpu = time.perf_counter(), time.process_time()
with tempfile.TemporaryDirectory() as scratch:
    pieces = open_pieces(Path(sys.argv[1]), arm.joint_names, Path(scratch))
    found, whole = diagnose_pieces(arm, pieces, [read_log(Path(sys.argv[2]), arm.joint_names)])
names = [(e["effect"], e["joint"], [(p["value"], p["std"]) for p in e["parameters"].values()][0]) for e in found.answer["effects"]]
peak = int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu, peak, whole.searched, whole.weighed, names]))
"""


def names(minutes: tuple[float, ...]) -> list[dict[str, Any]]:
    """Diagnosis of recordings of several lengths: CPU time, memory, and how well the hidden spring is known."""
    arm = load_arm(MODEL)
    truth = with_effect(individual(arm, 0), HIDDEN[1])
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        apart = Path(scratch) / "apart.mcap"
        write_recording(apart, arm, recorded(truth, motion(arm, 8, 60.0, 500.0), 99), "long", "S1", "validation", 0)
        for m in minutes:
            file = Path(scratch) / "long.mcap"
            _long(file, truth, arm, m, 0)
            answer = subprocess.run(
                [sys.executable, "-c", NAMES, str(file), str(apart)],
                env=ENVIRONMENT,
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            wall, spent, peak, searched, weighed, found = json.loads(answer)
            told = (
                ", ".join(f"{effect} {joint} {value:.4g} ± {2 * std:.2g}" for effect, joint, (value, std) in found) or "nothing"
            )
            note = f"searched {searched:.0f} s, summed {weighed:.0f} s; {told}; wall {wall:.1f}"
            rows.append(row(f"{m:g} min at 500 Hz: diagnose, CPU", f"{spent:.1f}", "s", "", note))
            rows.append(row(f"{m:g} min at 500 Hz: diagnose, resident memory", f"{peak:.0f}", "MB", "< 1000"))
    return rows


def _long(file: Path, truth: Arm, arm: Arm, minutes: float, seed: int) -> None:
    path = motion(arm, 1, minutes * 60, 500.0)
    parts = [slice(k, k + 100_000) for k in range(0, len(path.t), 100_000)]
    rng = np.random.default_rng(seed)
    tau = np.concatenate([predict(truth, Trajectory(path.t[s], path.q[s], path.dq[s], path.ddq[s])) for s in parts])
    tau += rng.standard_normal(tau.shape) * np.array(arm.sensors.torque_noise)
    q = path.q + 1e-5 * rng.standard_normal(path.q.shape)
    nan = np.broadcast_to(np.float64(np.nan), q.shape)
    log = Log(arm.joint_names, path.t, path.t, q, path.dq, tau, nan, nan, nan, nan, nan)
    write_recording(file, arm, log, "long", "S1", "work", 0)


def engines(arms: int = 200, seconds: float = 300.0, diagnose: bool = True, few: int = 8) -> list[dict[str, Any]]:
    """The pace of two local workers, and for the first `few` arms whether every way gives the same."""
    return pace(arms, seconds, diagnose) + same(few, seconds, diagnose)


def pace(arms: int, seconds: float, diagnose: bool = True) -> list[dict[str, Any]]:
    """Arms a minute on two local workers, and how many were told rightly."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        hidden = plant(root / "logs", arms, seconds)
        local, wall, spent = _timed(root, "local", Settings(workers=2, diagnose=diagnose))
    named = sum(_named(r, hidden.get(r["cell"])) for r in local.rows)
    far = {r["cell"] for r in local.rows if abs(r.get("outlier_score") or 0) > 4}
    done = sum(r["status"] == "done" for r in local.rows)
    return [
        row(f"{_what(arms, seconds, diagnose)}: two local workers", f"{arms / wall * 60:.2f}", "arms/min", "",
            f"{spent / arms:.1f} s CPU an arm, wall {wall:.0f} s"),
        row("arms done", f"{done}/{arms}", "", f"{arms}"),
        row("arms whose diagnosis is the hidden effect alone, or none where none is hidden", f"{named}/{arms}", "", "",
            f"{len(hidden)} have one; told otherwise: {_otherwise(local, hidden)}"),
        row("arms told to be unlike their siblings, with an effect / without", f"{len(far & set(hidden))}/{len(far - set(hidden))}"),
    ]  # fmt: skip


def same(arms: int, seconds: float, diagnose: bool = True) -> list[dict[str, Any]]:
    """The same arms on two local workers, on a two-worker cluster on loopback, with a worker killed in the middle, and once more."""
    what = _what(arms, seconds, diagnose)
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        plant(root / "logs", arms, seconds)
        local, wall, _ = _timed(root, "local", Settings(workers=2, diagnose=diagnose))
        rows = [row(f"{what}: two local workers", f"{arms / wall * 60:.2f}", "arms/min", "", f"wall {wall:.0f} s")]
        with _loopback() as address:
            other, wall, _ = _timed(root, "cluster", Settings(scheduler=address, diagnose=diagnose))
        rows += [
            row(f"{what}: two-worker cluster on loopback", f"{arms / wall * 60:.2f}", "arms/min", "", f"wall {wall:.0f} s"),
            row("largest relative difference of any number, cluster against local", f"{difference(local, other):.1e}", "", "<= 1e-9"),
        ]  # fmt: skip
        rows += killed(root, local, arms, diagnose)
        begin = time.perf_counter()
        again = run_fleet(str(root / "logs"), root / "local", Settings(workers=2, diagnose=diagnose))
        rows.append(row("second call: arms done again", len(again.done), "", "0", f"{time.perf_counter() - begin:.1f} s"))
    return rows


def _what(arms: int, seconds: float, diagnose: bool) -> str:
    return f"{arms} arms x {seconds / 60:g} min" + ("" if diagnose else ", without diagnosis")


def _otherwise(fleet: Fleet, hidden: dict[str, ArmEffect]) -> str:
    wrong = [r for r in fleet.rows if not _named(r, hidden.get(r["cell"]))]
    told = [
        "+".join(f"{e['effect']} {e['joint'] or ''}".strip() for e in r.get("effects") or ()) or r.get("verdict", "")
        for r in wrong
    ]
    return "; ".join(f"{r['cell']} {t}" for r, t in zip(wrong, told, strict=True)) or "none"


def killed(root: Path, reference: Fleet, arms: int, diagnose: bool) -> list[dict[str, Any]]:
    """A worker killed once a third of the arms is done: rows lost, rows twice, difference from the undisturbed run."""
    seen: list[str] = []
    deaths: list[int] = []

    def told(progress: Progress) -> None:
        if progress.arm_id:
            seen.append(progress.arm_id)
        if len(seen) >= max(1, arms // 3) and not deaths:
            deaths.append(kill_a_worker())

    found = run_fleet(str(root / "logs"), root / "killed", Settings(workers=2, diagnose=diagnose), told)
    names = [r["arm"] for r in found.rows]
    return [
        row(
            "worker killed in the middle: arms lost",
            arms - sum(r["status"] == "done" for r in found.rows),
            "",
            "0",
            f"process {deaths[0]}",
        ),
        row("worker killed in the middle: arms twice", len(names) - len(set(names)) + len(seen) - len(set(seen)), "", "0"),
        row("largest relative difference after the kill", f"{difference(reference, found):.1e}", "", "<= 1e-9"),
    ]


def kill_a_worker() -> int:
    """SIGKILL for one worker process below this one; returns its number."""
    for process in psutil.Process().children(recursive=True):
        with_nanny = "spawn_main" in " ".join(process.cmdline())
        if with_nanny and not process.children():
            process.send_signal(signal.SIGKILL)
            return process.pid
    raise AssertionError("there is no worker to kill")


def difference(a: Fleet, b: Fleet) -> float:
    """Largest relative difference between the numbers of two fleets; infinite where anything else differs."""
    worst = 0.0
    ours = {r["arm"]: r for r in a.rows}
    if ours.keys() != {r["arm"] for r in b.rows}:
        return math.inf
    for other in b.rows:
        mine = ours[other["arm"]]
        for key in mine.keys() - {"cpu_seconds", "logs"}:
            worst = max(worst, _apart(mine[key], other[key]))
    return worst


def _apart(a: Any, b: Any) -> float:
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return max((_apart(a[k], b[k]) for k in a), default=0.0)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        if a and all(isinstance(x, float) for x in (*a, *b)):
            x, y = np.array(a), np.array(b)
            return float(np.abs(x - y).max() / max(np.abs(x).max(), 1e-300))
        return max((_apart(x, y) for x, y in zip(a, b, strict=True)), default=0.0)
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) / max(abs(a), 1e-300) if a != b else 0.0
    return 0.0 if a == b else math.inf


def _named(r: dict[str, Any], hidden: ArmEffect | None) -> bool:
    found = [(e["effect"], e["joint"]) for e in r.get("effects") or ()]
    return found == ([] if hidden is None else [(hidden.effect, hidden.joint)])


def _timed(root: Path, name: str, settings: Settings) -> tuple[Fleet, float, float]:
    begin = time.perf_counter()
    found = run_fleet(str(root / "logs"), root / name, settings)
    return found, time.perf_counter() - begin, sum(r.get("cpu_seconds") or 0.0 for r in found.rows)


@contextmanager
def _loopback() -> Iterator[str]:
    """A scheduler and two workers of its own processes, as an existing cluster would be."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "scheduler.json"
        dask = [sys.executable, "-m", "dask"]
        quiet: dict[str, Any] = {"env": ENVIRONMENT, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": scratch}
        started = [
            subprocess.Popen(
                [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)],
                **quiet,
            )
        ]
        try:
            while not file.exists():
                time.sleep(0.2)
            for _ in range(2):
                options = [
                    "--nthreads",
                    "1",
                    "--nworkers",
                    "1",
                    "--no-dashboard",
                    "--scheduler-file",
                    str(file),
                    "--host",
                    "127.0.0.1",
                ]
                started.append(subprocess.Popen([*dask, "worker", *options], **quiet))
            yield json.loads(file.read_text())["address"]
        finally:
            for process in reversed(started):
                process.terminate()
            for process in started:
                process.wait()


def run(arms: int = 12, seconds: float = 300.0, minutes: tuple[float, ...] = LENGTHS) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return length(minutes) + engines(arms, seconds)


if __name__ == "__main__":
    given = sys.argv[1:]
    if given[:1] == ["length"]:
        table = length(tuple(map(float, given[1:])) or LENGTHS)
    elif given[:1] == ["names"]:
        table = names(tuple(map(float, given[1:])) or (4, 20, 60))
    elif given[:1] in (["engines"], ["pace"], ["same"]):
        make = {"engines": engines, "pace": pace, "same": same}[given[0]]
        table = make(int(given[1]), float(given[2]), given[3:] != ["identify"])
    else:
        table = run()
    for line in table:
        print(f"{line['what']:76} {line['value']!s:>24} {line['unit']:9} bar {line['bar']:8} {line['note']}")
