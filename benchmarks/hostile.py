"""Hostile files: mutants of every kind of file that is read, and names that would leave the export folder.

A mutant must either load as sound content or end in one error message. Anything else (a traceback, a crash, a hang, excessive
memory) is counted.
"""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from benchmarks.forked import forked
from calib.past_runs import read_run
from logs import Recorder, read_log
from safety.plan import Motion, load_plan, write_plan
from safety.seal import sealed
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import CalibError
from sim.export import export
from sim.joint_state import JointState
from sim.resources import shipped_configs
from sim.trajectory import Trajectory

KINDS = ("arm.toml", "model.xml", "arm.urdf", "cell.toml", "plan.toml", "run.toml", "journal.mcap", "finished.mcap", "log.csv")
ARM = "servo6"
SLOW, LARGE = 2.0, 1000.0  # s, MB
LONGEST = 3600.0  # s, for all mutants of a kind
BINARY = [bytes(4), b"\xff" * 8, b"\x7f", b"\x80", (1 << 40).to_bytes(8, "little"), np.float64("nan").tobytes()]
TEXT = [
    b"9" * 5000, b"[" * 3000, b"{a=" * 2000, b"a." * 3000, b"\x00", b"\x1b]0;x\x07\x1b[2J", b"../../x", b"nan", b"1e999", b"-",
    b'"', b"'''", b"\n", b"=", b"<a>" * 500, b"<!DOCTYPE a>", b"\xff\xfe", "\u202e".encode(), b"0x" + b"f" * 3000, b" " * 5000,
]  # fmt: skip


def sound(kind: str, folder: Path) -> tuple[Path, Callable[[], object]]:
    """A sound file of this kind in `folder`, and a function that reads it."""
    if kind in ("arm.toml", "model.xml"):
        shutil.copytree(shipped_configs() / "arms" / ARM, folder / "arm")
        return folder / "arm" / kind, lambda: load_arm(folder / "arm")
    file = folder / kind
    if kind == "arm.urdf":
        export(load_arm(ARM), folder / "urdf", ["urdf"])
        return folder / "urdf" / f"{ARM}.urdf", lambda: load_arm(folder / "urdf" / f"{ARM}.urdf")
    if kind == "cell.toml":
        file.write_bytes(load_cell("mock-ur10e").path.read_bytes())
        return file, lambda: load_cell(file)
    if kind == "plan.toml":
        arm = load_arm(ARM)
        still = np.zeros((3, arm.n))
        write_plan(folder / "plan", arm, [Motion("friction", "friction", Trajectory(np.arange(3.0), still, still, still))])
        return folder / "plan" / kind, lambda: load_plan(folder / "plan")
    if kind == "run.toml":
        end = {"exit_code": 0, "sentence": "done", "ended": "2026-01-01T00:00:00+00:00"}
        words = {
            "verb": "plan",
            "arm": ARM,
            "started": "2026-01-01T00:00:00+00:00",
            "directory": "/",
            "arguments": ["plan", ARM],
        }
        file.write_text(tomli_w.dumps({"schema": "run/1", **words, "end": end}))
        return file, lambda: read_run(folder)
    if kind == "log.csv":
        names = ["timestamp", *(f"{stem}_{j}" for stem in ("actual_q", "actual_qd", "actual_current") for j in range(6))]
        rows = [",".join(f"{x:.4f}" for x in (0.01 * k, *np.full(18, 0.001 * k))) for k in range(40)]
        file.write_text("\n".join([",".join(names), *rows]) + "\n")
        return file, lambda: read_log(file)
    recorder = Recorder(file, ("a", "b"), {"arm": ARM})
    for k in range(40):
        x = np.full(2, 0.001 * k)
        recorder.write(JointState(5 + 0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
    journal = file.read_bytes()
    recorder.close()
    if kind == "journal.mcap":
        file.write_bytes(journal)
    return file, lambda: read_log(file, accept_partial=kind == "finished.mcap")


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The file with one to three changes: bits flipped, bytes overwritten, text inserted, parts deleted, copied or cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        at, other = rng.randrange(len(out) + 1), rng.randrange(len(out) + 1)
        change = rng.randrange(7)
        if change == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif change == 1:
            word = rng.choice(BINARY + TEXT)
            out[at : at + len(word)] = word
        elif change in (2, 3):
            out[at:at] = rng.choice(TEXT)
        elif change == 4:
            del out[at : at + rng.choice((1, 2, 8, 31, 400))]
        elif change == 5:
            out[at:at] = out[other : other + rng.choice((1, 9, 60, 400))]
        else:
            del out[at:]
    return bytes(out)


def attack(kind: str, seed: int, count: int) -> dict[str, Any]:
    """Read `count` mutants of one kind in this process: unexpected errors, the slowest read, s, and the peak memory, MB."""
    rng = random.Random(f"{kind} {seed}")
    faults, slowest, refused = [], 0.0, 0
    with tempfile.TemporaryDirectory() as place:
        file, read = sound(kind, Path(place))
        data = file.read_bytes()
        read()
        for _ in range(count):
            bad = mutated(data, rng)
            file.write_bytes(sealed(bad.partition(b"\n")[2].decode("utf-8", "surrogateescape")) if kind == "plan.toml" and
                             _is_text(bad) else bad)  # fmt: skip
            begin = time.perf_counter()
            try:
                read()
            except CalibError:
                refused += 1
            except Exception as error:
                faults.append(f"{kind}: {type(error).__name__}: {str(error)[:200]}")
            slowest = max(slowest, time.perf_counter() - begin)
    status = Path("/proc/self/status").read_text()
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    return {"faults": faults, "slowest": slowest, "peak": peak, "refused": refused, "count": count}


def _is_text(data: bytes) -> bool:
    try:
        data.decode("utf-8")
        return True
    except UnicodeDecodeError:
        return False


def attacked(seed: int, count: int) -> dict[str, dict[str, Any]]:
    """Run `attack` on every kind, each in a forked child of a fresh process; a crash counts as a fault too."""
    program = [sys.executable, "-m", "benchmarks.hostile", str(seed), str(count)]
    done = subprocess.run(program, capture_output=True, text=True, cwd=Path(__file__).resolve().parent.parent, check=True)
    return dict(json.loads(done.stdout))


def _each(seed: int, count: int) -> dict[str, dict[str, Any]]:
    jobs = [(kind, partial(attack, kind, seed, count)) for kind in KINDS]
    none = {"slowest": 0.0, "peak": 0.0, "refused": 0, "count": count}
    return {
        done.key: none | {"faults": [f"{done.key}: {done.fault}"]} if done.fault else done.value
        for done in forked(jobs, LONGEST, workers=1)
    }


def hostile_name(rng: random.Random) -> str:
    """A name that would leave a folder, control a terminal, or is no valid file name."""
    parts = [
        "..",
        "/",
        "../",
        "~",
        "\x1b[2J",
        "\x00",
        "-",
        ".",
        "a",
        "x" * 70,
        "\u202e",
        "\\",
        " ",
        "model",
        "$(x)",
        "\n",
        "ur5e",
        ":",
    ]
    return "".join(rng.choice(parts) for _ in range(rng.randrange(1, 6)))


def names_that_leave(count: int, seed: int = 0) -> tuple[int, int]:
    """Export `count` arms with hostile names and meshes: (files written outside the output folder, names accepted)."""
    rng = random.Random(seed)
    outside = accepted = 0
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        shutil.copytree(shipped_configs() / "arms" / ARM, root / "arm")
        table = tomllib.loads((root / "arm" / "arm.toml").read_text())
        model = (root / "arm" / "model.xml").read_text()
        for k in range(count):
            name = hostile_name(rng)
            (root / "arm" / "arm.toml").write_text(tomli_w.dumps(table | {"name": name}))
            mesh = name.replace("\x00", "").replace("\x1b", "").replace("<", "")
            (root / "arm" / "model.xml").write_text(
                model.replace("<worldbody>", f'<asset><mesh name="m" file="{mesh}.stl"/></asset><worldbody>', 1)
                if k % 2
                else model
            )
            before = {p for p in root.rglob("*") if root / "out" not in p.parents}
            try:
                export(load_arm(root / "arm"), root / "out" / str(k))
                accepted += 1
            except CalibError:
                pass
            outside += len({p for p in root.rglob("*") if root / "out" not in p.parents} - before - {root / "out"})
    return outside, accepted


def run(count: int = 20_000, names: int = 1000) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    each = -(-count // len(KINDS))
    found = attacked(0, each)
    faults = [fault for f in found.values() for fault in f["faults"]]
    slowest, peak = max(found, key=lambda k: found[k]["slowest"]), max(found, key=lambda k: found[k]["peak"])
    outside, accepted = names_that_leave(names)
    total = each * len(KINDS)
    refused = sum(f["refused"] for f in found.values())

    def row(what: str, value: Any, unit: str, bar: str, note: str) -> dict[str, Any]:
        return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}

    return [
        row(f"tracebacks and crashes in {total} mutants", len(faults), "", "0", "; ".join(faults[:3]) or f"{refused} refused"),
        row("slowest of them", f"{found[slowest]['slowest']:.2f}", "s", f"<= {SLOW:g}", slowest),
        row("peak memory, the program itself in it", f"{found[peak]['peak']:.0f}", "MB", f"<= {LARGE:g}", peak),
        row(f"files outside the folder in {names} exports of hostile names", outside, "", "0", f"{accepted} names were sound"),
    ]


if __name__ == "__main__":
    print(json.dumps(_each(int(sys.argv[1]), int(sys.argv[2]))))
