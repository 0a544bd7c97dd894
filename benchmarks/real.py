"""`make real`: the residual that the tool leaves on real recordings, arm by arm, as a user would see it.

Every arm is made with `calib arm new` or `calib arm drive`. Its recordings are imported with `calib import`, identified, and
diagnosed without any held-out recording. Both arms then predict unseen recordings with `calib validate`. Measured and predicted
torque pass one zero-phase low-pass filter (Butterworth, fourth order) and are compared on all samples in motion, reversals
included. Reference: the residual of plain weighted least squares (base parameters, reflected inertia, viscous, sign, offset) on
the same split.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.imports import commands
from benchmarks.real_sets import ALL, SETS, Set
from benchmarks.results import write

COMMAND = "make real"
MEASURES = ("benchmarks.real", *commands("arm", "import_", "identify", "validate", "diagnose"))
BARS = {("ur10e", "diagnosed"): "1 s <= 30 mrad"}
EDGE, MOVING = 0.3, 0.02  # s, left out after the start and before the end of motion; rad/s


class Failed(RuntimeError):
    """A command that ended with an error."""


def calib(*words: str) -> None:
    """Run one command. Failed with the last line of its output if the exit code is above 1."""
    done = subprocess.run([sys.executable, "-m", "calib", *words], capture_output=True, text=True, check=False)
    if done.returncode > 1:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no word"]
        raise Failed(f"calib {words[0]}: exit {done.returncode}: {lines[-1][:300]}")


def part(data: Path, name: str, since: float, until: float, folder: Path) -> Path:
    """The part of a recording between `since` and `until`, s from its start; shares of its length if `until` is at most 1."""
    source = data / name
    if (since, until) == ALL:
        return source
    out = folder / f"{source.stem}_{since:g}_{min(until, 999):g}.csv"
    with source.open() as file:
        head, *lines = file.readlines()
    t = np.array([float(line.split(",", 1)[0]) for line in lines])
    t -= t[0]
    if until <= 1.0:
        since, until = since * t[-1], until * t[-1] if until < 1 else 1e9
    out.write_text(head + "".join(line for line, at in zip(lines, t, strict=True) if since <= at < until))
    return out


def errors(prediction: Path, recording: Path, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Error and measured torque at the samples in motion, (N, n) each, both filtered."""
    with prediction.open() as file:
        rows = list(csv.DictReader(file))
    joints = [c.removeprefix("tau_hat_") for c in rows[0] if c.startswith("tau_hat_")]
    t = np.array([float(r["t"]) for r in rows])
    measured, predicted = (np.array([[float(r[p + j]) for j in joints] for r in rows]) for p in ("tau_", "tau_hat_"))
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    sos = butter(4, cutoff * 2 * step, output="sos")
    even = [np.column_stack([np.interp(grid, t, column) for column in x.T]) for x in (measured, predicted)]
    measured, predicted = (sosfiltfilt(sos, x, axis=0) for x in even)
    with recording.open() as file:
        head = next(file).strip().split(",")
        speeds = [i for i, c in enumerate(head) if c.startswith("actual_qd_") or (c[:2] == "dq" and c[2:].isdigit())]
        d = np.array([[float(row[i]) for i in (0, *speeds)] for row in csv.reader(file)])
    moving = d[np.abs(d[:, 1:]).max(axis=1) > MOVING, 0] - d[0, 0]
    keep = (grid > moving[0] + EDGE) & (grid < moving[-1] - EDGE)
    return (measured - predicted)[keep], measured[keep]


def score(arm: Path, s: Set, tests: list[tuple[Path, Path]], folder: Path, stage: str) -> tuple[np.ndarray, np.ndarray, str]:
    """RMSE (n,) N m over the held-out recordings, the standard deviation of their torque, and `moved` of their validations."""
    found, validations = [], []
    for k, (log, recording) in enumerate(tests):
        out = folder / f"predicted_{stage}_{k}"
        calib("validate", str(arm), str(log), "--out", str(out))
        found.append(errors(out / "prediction.csv", recording, s.cutoff))
        validations.append(json.loads((out / "validation.json").read_text()))
    e, tau = (np.concatenate(x) for x in zip(*found, strict=True))
    return np.sqrt(np.mean(e**2, axis=0)), tau.std(axis=0), moved(validations)


def moved(validations: list[dict[str, Any]]) -> str:
    """Simulated arm against the recordings by horizon: RMS over joints and recordings, mrad, and of the flange, mm."""
    entries = [entry for v in validations for log in v["logs"] for entry in log["motion"]]
    parts = []
    for seconds in sorted({entry["horizon_s"] for entry in entries}):
        own = [entry for entry in entries if entry["horizon_s"] == seconds]
        angles = [x for entry in own for x in entry["angle_rad"]]
        flange = [entry["flange_m"] for entry in own]
        if None in (*angles, *flange):
            parts.append(f"{seconds:g} s unstable")
            continue
        mrad, mm = (1e3 * float(np.sqrt(np.mean(np.square(x)))) for x in (angles, flange))
        parts.append(f"{seconds:g} s {own[0]['loop']} {mrad:.1f} mrad, {mm:.1f} mm")
    return "; ".join(parts) or "no window in which every joint moves"


def measure(name: str, s: Set, data: Path, folder: Path) -> list[dict[str, object]]:
    """Rows of one set: error after identify and after diagnose, over the reference or over the torque's standard deviation."""
    arm = name
    if s.new:
        arm = str(folder / "arm_made")
        calib(*(w.replace("DATA", str(data)) for w in s.new), "--out", arm)
    logs: list[list[tuple[Path, Path]]] = [[], []]
    for kind, files in enumerate((s.train, s.test)):
        for k, (file, since, until) in enumerate(files):
            recording = part(data, file, since, until, folder)
            log = recording
            if s.new:
                out = folder / f"import_{kind}_{k}"
                words = [w for c in s.columns for w in ("--column", c)] + [w for a in s.assume for w in ("--assume", a)]
                calib("import", str(recording), "--arm", arm, "--yes", *words, "--out", str(out))
                log = next(out.glob("*.mcap"))
            logs[kind].append((log, recording))
    train = [str(log) for log, _ in logs[0]]
    rows: list[dict[str, object]] = []
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    calib("identify", arm, *train, *s.identify, "--out", str(folder / "identified"))
    middle = resource.getrusage(resource.RUSAGE_CHILDREN)
    calib("diagnose", str(folder / "identified" / "arm"), *train, "--out", str(folder / "diagnosed"))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer = json.loads((folder / "diagnosed" / "diagnosis.json").read_text())
    for stage in ("identified", "diagnosed"):
        # A diagnosis that rejects every correction writes no arm; its result is then the identified arm.
        where = folder / stage if (folder / stage / "arm").is_dir() else folder / "identified"
        rmse, spread, motion = score(where / "arm", s, logs[1], folder, stage)
        ratio = rmse / np.array(s.reference) if s.reference else rmse / spread
        unit = "of plain least squares" if s.reference else "of the torque's standard deviation"
        rows.append({
            "what": f"{name}, {stage}", "value": round(float(ratio.mean()), 3), "unit": unit,
            "note": "joints " + " ".join(f"{x:.2f}" for x in ratio),
        })  # fmt: skip
        rows.append({"what": f"{name}, {stage}, motion", "value": motion, "bar": BARS.get((name, stage), "")})
    names = "; ".join(f"{e['effect']} at {e['joint'] or 'the arm'}" for e in answer["effects"]) or "none"
    rows.append({"what": f"{name}, named", "value": names, "note": f"{len(answer.get('laws', []))} friction laws"})
    seconds = [b.ru_utime + b.ru_stime - a.ru_utime - a.ru_stime for a, b in ((before, middle), (middle, after))]
    rows.append({"what": f"{name}, time", "value": f"{seconds[0]:.0f} + {seconds[1]:.0f}", "unit": "s of processor time"})
    return rows


def main() -> None:
    """Measure all sets of ARM_CALIB_DATA, or those given with --only. Writes results/real.json unless --only is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(SETS))
    parser.add_argument("--keep", type=Path, help="folder for everything that is written on the way")
    given = parser.parse_args()
    if "ARM_CALIB_DATA" not in os.environ:
        sys.exit("ARM_CALIB_DATA is not set: the real recordings are not part of this project")
    data, load, rows = Path(os.environ["ARM_CALIB_DATA"]), os.getloadavg()[0], []
    with tempfile.TemporaryDirectory(prefix="calib-real-") as scratch:
        for name in given.only or SETS:
            folder = (given.keep or Path(scratch)) / name
            folder.mkdir(parents=True)
            try:
                rows += measure(name, SETS[name], data, folder)
            except Failed as error:
                rows.append({"what": f"{name}, failed", "value": str(error).replace(f"{data}/", "")})
            for row in rows[-6:]:
                print(f"{row['what']:28} {row['value']} {row.get('unit', '')} {row.get('note', '')}", flush=True)
    if not given.only:
        print(write("real", rows, command=COMMAND, measures=MEASURES, load_before=round(load, 2)))


if __name__ == "__main__":
    main()
