"""The exam on real recordings: the torque of a hidden effect is added to the currents of a real UR10e's motors.

An arm is identified from some runs. Other runs get the effect and are diagnosed against that arm. A name given on the untouched
runs belongs to the real arm or is a mistake; it is listed, and only names beyond those count as wrong. The recordings are under
ARM_CALIB_DATA; everything made from them goes to a build folder and nowhere else.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.exam import motions
from benchmarks.exam.arms import HARDWARE
from benchmarks.exam.effects import EFFECTS
from benchmarks.exam.figures import Share
from benchmarks.exam.hidden import Hidden
from benchmarks.exam.injected import Recorded, recorded, rows, with_hidden, write
from benchmarks.exam.run import Exam, effects_text, run_calib
from benchmarks.exam.scoring import Key, Row, compared
from benchmarks.exam.severity import Balance, hide
from benchmarks.exam.true_arm import TrueArm, build
from benchmarks.exam.unknowns import UNKNOWNS
from sim.arm import Arm, load_arm

IDENTIFIED = ("excitation_20s_5h.csv", "excitation_30s_12h.csv", "excitation_40s_12h.csv")
DIAGNOSED = ("excitation_20s_8h.csv", "excitation_50s_12h.csv")
HELD_OUT = "excitation_20s_10h.csv"
# N m, residual of 40 base parameters, viscous, sign and offset on such runs (0.339 0.382 0.201 0.062 0.078 0.051 A); nothing
# smaller can be expected to be visible
REST = np.array([4.0, 4.6, 2.0, 0.67, 0.85, 0.54])
NOT_AFTERWARDS = ("joint_elasticity", "backlash")  # these would have changed the motion


def sit(data: Path, exam: Exam, count: int) -> None:
    """Identify, hide, ask, compare; print a line per case, then the shares, and write real.json."""
    folder = data / "ur10e" if (data / "ur10e").is_dir() else data
    base = exam.out / "real" / "identified"
    if not (base / "arm").is_dir():
        base.mkdir(parents=True, exist_ok=True)
        run_calib(exam, base / "exam.log", "identify", "ur10e", *(folder / f for f in IDENTIFIED), "--out", base)
    arm = load_arm(base / "arm")
    if arm.torque_constant is None:
        raise ValueError("the identified arm has no torque constant; current cannot become torque")
    runs = {name: recorded(folder / name) for name in (*DIAGNOSED, HELD_OUT)}
    clean = bare(exam.seed, arm)
    own = ask(exam, base / "arm", "untouched", runs, {"arm": "ur10e", "kind": "clean", "severity": 0, "effects": []})
    print(f"untouched: {own.verdict}: {effects_text(own.answer)}", flush=True)
    balance = Balance(clean.copy(), [runs[name] for name in DIAGNOSED], rows)
    rows_found = []
    for number in range(count):
        changed, truth = hidden(number, exam.seed, clean, balance, arm.torque_constant, runs)
        row = ask(exam, base / "arm", f"case_{number:03d}", changed, truth)
        rows_found.append(row)
        beyond = [k for k in row.answer if k not in own.answer]
        mark = "ok" if right(row, own.answer) else "  "
        print(
            f"{mark} {row.case} severity {row.severity}  {effects_text(row.truth)} {row.form} -> {row.verdict}: new {effects_text(beyond)}",
            flush=True,
        )
    report(rows_found, own, exam)


def bare(seed: int, arm: Arm) -> TrueArm:
    """The true arm with nothing hidden: the identified one with bristles, without warming, gear mesh and torque delay."""
    rng = np.random.default_rng([seed, 1])
    out = build("ur10e", arm.tree, arm.tau_max, HARDWARE["ur10e"], motions.HOME, rng, False)
    out.chain = out.nominal
    for name in ("coulomb", "viscous", "rotor"):
        out.joints[name] = out.nominal_joints[name]
    out.joints["warm_drop"] = out.joints["mesh"] = 0.0
    out.sensors.delay, out.sensors.noise = 0.0, REST
    return out


def hidden(
    number: int, seed: int, clean: TrueArm, balance: Balance[Recorded], constant: np.ndarray, runs: dict[str, Recorded]
) -> tuple[dict[str, Recorded], dict]:
    """Recordings with the effect, and truth, of case `number`: effects in turn, every fifth one unknown."""
    rng = np.random.default_rng([seed, 2, number])
    known = [e for e in EFFECTS if e.name not in NOT_AFTERWARDS]
    unknown = number % 5 == 4
    effect: Hidden = UNKNOWNS[number // 5 % len(UNKNOWNS)] if unknown else known[(number - number // 5) % len(known)]
    joint = int(rng.choice(effect.joints)) if effect.joints else -1
    severity, dose_seed = 2 + number % 2, int(rng.integers(2**31))
    clean.peak = np.max([np.abs(m.table[:, m.block("actual_current")] * constant).max(axis=0) for m in runs.values()], axis=0)
    balance.clean.peak = clean.peak
    dose, seen = balance.dose(effect, joint, severity, 0, dose_seed, 1.0)
    changed = clean.copy()
    parameters = hide(effect, changed, joint, dose, 0, dose_seed)
    untouched = changed.copy()
    untouched.force["touch"] = 0.0
    out = {}
    for name, motion in runs.items():
        # the arm is touched once, in the first of the runs
        here = changed if name == DIAGNOSED[0] else untouched
        out[name] = with_hidden(motion, clean, here, constant, rng)
    item = {
        "effect": "unknown" if unknown else effect.name,
        "joint": clean.joint_names[joint] if joint >= 0 else None,
        "parameters": {"form": effect.name} if unknown else parameters,
        "rho": round(seen, 3),
    }
    return out, {"arm": "ur10e", "kind": "unknown" if unknown else "single", "severity": severity, "effects": [item]}


def ask(exam: Exam, arm: Path, case: str, runs: dict[str, Recorded], truth: dict) -> Row:
    """Write the recordings, have them diagnosed, and compare with the truth."""
    folder, answer = exam.out / "real" / case, exam.out / "real-answers" / case
    folder.mkdir(parents=True, exist_ok=True)
    answer.mkdir(parents=True, exist_ok=True)
    for name, motion in runs.items():
        write(folder / name, motion)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    if not (exam.keep and (answer / "diagnosis.json").exists()):
        (answer / "diagnosis.json").unlink(missing_ok=True)
        logs = [folder / name for name in DIAGNOSED]
        run_calib(exam, answer / "exam.log", "diagnose", arm, *logs, "--holdout", folder / HELD_OUT, "--out", answer)
    return compared(case, truth, answer / "diagnosis.json")


def right(row: Row, own: list[Key]) -> bool:
    """Whether an answer adds exactly the hidden effect to those of the untouched runs; for an unknown its joint, no name."""
    beyond = set(row.answer) - set(own)
    if row.unknown:
        return {joint for _, joint in row.truth} <= set(row.unexplained) and not beyond
    return set(row.truth) <= set(row.answer) and beyond <= set(row.truth)


def report(found: list[Row], own: Row, exam: Exam) -> None:
    """Print the shares and write real.json."""
    known, unknown = [r for r in found if not r.unknown], [r for r in found if r.unknown]
    names = [k for r in found for k in r.answer if k not in own.answer]
    wrong = sum(k not in r.truth and k not in own.answer for r in found for k in r.answer)
    shares = {
        "injected: name and joint right": Share(sum(set(r.truth) <= set(r.answer) for r in known), len(known)),
        "injected: exactly it, beyond what the untouched runs have": Share(
            sum(right(r, own.answer) for r in known), len(known)
        ),
        "injected unknown: unexplained at its joint, no new name": Share(
            sum(right(r, own.answer) for r in unknown), len(unknown)
        ),
        "wrong among the new names": Share(wrong, len(names)),
    }
    for what, share in shares.items():
        print(f"{what}: {share}")
    result = {
        "schema": "exam-real/1",
        "seed": exam.seed,
        "untouched": {"verdict": own.verdict, "effects": own.answer, "unexplained": own.unexplained},
        "figures": {what: [s.right, s.total] for what, s in shares.items()},
        "cases": [{"case": r.case, "truth": r.truth, "form": r.form, "answer": r.answer, "verdict": r.verdict} for r in found],
    }
    (exam.out / "real.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
