"""`make real`: what the tool leaves of real recordings, arm by arm, as its user would see it.

Every arm is made with `calib arm new` or `calib arm drive`, its recordings are imported with `calib import`, identified, diagnosed
without any recording kept apart, and both arms predict recordings that neither has seen with `calib validate`. Measured and predicted
torque then pass one zero-phase low-pass (Butterworth, fourth order) and are compared on all samples in motion, reversals included.
Reference: what plain weighted least squares (base parameters, rotor, viscous, sign, offset) leaves on the same split.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.results import write
from sim.arm import load_arm

COMMAND = "make real"
BARS = {("ur10e", "diagnosed"): "1 s <= 30 mrad"}
EDGE, MOVING = 0.3, 0.02  # s left out before the first and after the last motion; rad/s


@dataclass(frozen=True)
class Set:
    """Recordings of one arm.

    new: words after `calib`, with DATA for the folder of the recordings; train and test: (file, from s, to s); cutoff Hz; reference N m
    per joint, empty where nobody has published one; columns: what the tables' columns mean where their names do not say it; assume: words for `--assume`;
    identify: further words of `calib identify`.
    """

    new: tuple[str, ...]
    train: tuple[tuple[str, float, float], ...]
    test: tuple[tuple[str, float, float], ...]
    cutoff: float
    reference: tuple[float, ...] = ()
    columns: tuple[str, ...] = ()
    assume: tuple[str, ...] = ()
    identify: tuple[str, ...] = ()


ALL = (0.0, 1e9)
UR10E = load_arm("ur10e").torque_constant
GEOMETRY = ("arm", "new", "--geometry-only")
DRIVE = ("arm", "drive")
DAMIAO = "damiao/20260425_{}_identify-all__group_01__motor_0{}.csv"
SETS: dict[str, Set] = {
    "ur10e": Set(
        (),
        tuple((f"ur10e/excitation_{x}.csv", *ALL) for x in ("20s_8h", "20s_10h", "30s_12h", "40s_12h")),
        tuple((f"ur10e/excitation_{x}.csv", *ALL) for x in ("20s_5h", "50s_12h", "free_b")),
        8.0,
        tuple(a * k for a, k in zip((0.352, 0.338, 0.195, 0.063, 0.079, 0.054), UR10E, strict=True)),
    ),
    "panda": Set(
        ("arm", "new", "DATA/panda/panda.urdf", "--tool", "panda_hand", "--numbers", "cad", "--torque-at", "joint",
         "--limit", "ddq_max=15,7.5,10,12.5,15,20,20", "--limit", "jerk_max=7500,3750,5000,6250,7500,10000,10000"),
        (("panda/excitation_0_15s.csv", 0.0, 10.0),),
        (("panda/excitation_0_15s.csv", 10.0, 1e9),),
        15.0,
        (0.268, 0.270, 0.246, 0.189, 0.072, 0.051, 0.056),
    ),
    "rokae": Set(
        (*GEOMETRY, "DATA/rokae/kinematics.urdf", "--torque-at", "joint", "--limit", "q_min=-3.05", "--limit", "q_max=3.05",
         "--limit", "dq_max=2.1,2.1,2.1,2.1,3.1,3.1,3.1", "--limit", "tau_max=85,85,85,85,36,36,36"),
        (("rokae/rokae1.csv", 0.0, 14.0),),
        (("rokae/rokae1.csv", 14.0, 1e9),),
        10.0,
        (0.410, 1.453, 0.245, 0.550, 0.133, 0.207, 0.221),
    ),
    "sh_electric": Set(
        (*GEOMETRY, "DATA/sh_electric/kinematics.urdf", "--limit", "q_min=-6.28", "--limit", "q_max=6.28", "--limit", "dq_max=3.14",
         "--limit", "tau_max=200,200,120,60,60,40"),
        (("sh_electric/traj1.csv", 0.0, 16.0), ("sh_electric/traj2.csv", 0.0, 16.0)),
        (("sh_electric/traj1.csv", 16.0, 1e9), ("sh_electric/traj2.csv", 16.0, 1e9)),
        6.0,
        (2.18, 5.61, 3.38, 1.90, 1.20, 0.545),
    ),
    "ur5e_joint": Set(
        (*DRIVE, "ur5e_joint5", "--load", "unknown", "--limit", "q_min=-6.28", "--limit", "q_max=6.28", "--limit", "dq_max=3.14",
         "--limit", "tau_max=28"),
        (("ur5e_joint/joint_5.csv", 0.0, 0.6),),
        (("ur5e_joint/joint_5.csv", 0.6, 1.0),),
        8.0,
    ),
    **{
        f"damiao_{motor}": Set(
            (*DRIVE, name, "--limit", "q_min=-12.5", "--limit", "q_max=12.5", "--limit", f"dq_max={speed}", "--limit", f"tau_max={torque}"),
            ((DAMIAO.format("085915", motor), *ALL),),
            ((DAMIAO.format("155213", motor), *ALL),),
            8.0,
        )
        for motor, name, speed, torque in ((1, "dm8009", 16, 40), (3, "dm4340", 5.4, 27), (5, "dm4310", 20, 7))
    },
    "servo_pendulum": Set(
        (*DRIVE, "xl330", "--load", "0.49,0.1", "--limit", "q_min=-3.14", "--limit", "q_max=3.14", "--limit", "dq_max=6",
         "--limit", "tau_max=0.5"),
        (("servo_pendulum/xl330__sin_sin__m0.49_l0.1_kp400__2026-01-15_10h29m14.csv", *ALL),
         ("servo_pendulum/xl330__sin_time_square__m0.49_l0.1_kp400__2026-01-15_10h29m37.csv", *ALL)),
        (("servo_pendulum/xl330__up_and_down__m0.49_l0.1_kp400__2026-01-15_10h29m29.csv", *ALL),),
        8.0,
        (),
        ("time=t:s", "q=q1:rad", "dq=dq1:rad/s", "current=load_raw:mA"),
        ("current=int16",),
        ("--known-mass", "0.49"),
    ),
}  # fmt: skip


class Failed(RuntimeError):
    """A command that ended with an error."""


def calib(*words: str) -> None:
    """One command; the last line of what it says, if it fails."""
    done = subprocess.run([sys.executable, "-m", "calib", *words], capture_output=True, text=True, check=False)
    if done.returncode > 1:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no word"]
        raise Failed(f"calib {words[0]}: exit {done.returncode}: {lines[-1][:300]}")


def part(data: Path, name: str, since: float, until: float, folder: Path) -> Path:
    """A recording between two times, s from its start; up to 1 they are shares of it, where `until` is."""
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
    """Samples in motion (N, n) of error and of measured torque, both filtered."""
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
    """RMSE (n,) N m over the recordings kept apart, the standard deviation of the torque there, and `moved` of their validations."""
    found, validations = [], []
    for k, (log, recording) in enumerate(tests):
        out = folder / f"predicted_{stage}_{k}"
        calib("validate", str(arm), str(log), "--out", str(out))
        found.append(errors(out / "prediction.csv", recording, s.cutoff))
        validations.append(json.loads((out / "validation.json").read_text()))
    e, tau = (np.concatenate(x) for x in zip(*found, strict=True))
    return np.sqrt(np.mean(e**2, axis=0)), tau.std(axis=0), moved(validations)


def moved(validations: list[dict[str, Any]]) -> str:
    """By horizon how far the simulated arm is from the recordings: RMS over joints and recordings in mrad, and of the flange in mm."""
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
    """Rows of one set: after identify and after diagnose, over the reference or over the torque's standard deviation."""
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
        # A diagnosis that refused every correction writes no arm: the arm as it was is its answer.
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
    """Every set of ARM_CALIB_DATA, or those that are named; results/real.json unless --only is given."""
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
        print(write("real", rows, command=COMMAND, load_before=round(load, 2)))


if __name__ == "__main__":
    main()
