"""How hard are these cases? Residual statistics of the nominal model, for any folder of cases with truth.json.

    python -m benchmarks.exam.residuals CASES [--truth DIR]

For clean cases, per arm and motion, medians over cases: per joint the RMS of the residual while the joint moves, its fast part,
and the AR(1) coefficient of that part. For single effects: the largest residual of a joint over the clean median, by severity.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from benchmarks.exam.dynamics import torque_along
from benchmarks.exam.true_arm import chain_of
from logs import read_log
from sim.arm import load_arm

MOTIONS = ("friction", "excitation", "validation")


def residual(case: Path, motion: str) -> tuple[float, np.ndarray, np.ndarray]:
    """(step s, residual (N, n) N m, moving (N, n)) of the nominal arm on one log, resampled at the log's own mean rate."""
    arm = load_arm(case / "arm.xml")
    log = read_log(case / f"{motion}.mcap", arm.joint_names)
    step = log.period
    t = np.arange(log.t[0], log.t[-1], step)
    q, tau = (np.stack([np.interp(t, log.t, x) for x in y.T], axis=1) for y in (log.q, log.tau))
    window = int(0.1 / step) // 2 * 2 + 1
    q, dq, ddq = (savgol_filter(q, window, 4, deriv=k, delta=step, axis=0) for k in range(3))
    tree = arm.tree
    expected = torque_along(chain_of(tree), tree.gravity, q, dq, ddq) + tree.armature * ddq + tree.damping * dq
    expected += tree.frictionloss * np.tanh(dq / 5e-3)
    return step, tau - expected, np.abs(dq) > 0.02


def statistics(case: Path, motion: str) -> np.ndarray:
    """RMS while moving, standard deviation of the part faster than 4 Hz, and its AR(1) coefficient, (3, n)."""
    step, r, moving = residual(case, motion)
    fast = r - savgol_filter(r, int(0.25 / step) // 2 * 2 + 1, 2, axis=0)
    out = np.empty((3, r.shape[1]))
    for j in range(r.shape[1]):
        part = fast[moving[:, j], j]
        out[:, j] = np.sqrt(np.mean(r[moving[:, j], j] ** 2)), part.std(), np.corrcoef(part[1:], part[:-1])[0, 1]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path)
    parser.add_argument("--truth", type=Path, help="folder with the truths, where they are not beside the cases")
    options = parser.parse_args()
    clean, single = defaultdict(list), []
    for case in sorted(p.parent for p in options.cases.glob("*/arm.xml")):
        truth = json.loads(((options.truth or options.cases) / case.name / "truth.json").read_text(encoding="utf-8"))
        found = {m: statistics(case, m) for m in MOTIONS}
        if not truth["effects"]:
            for m in MOTIONS:
                clean[truth["arm"], m].append(found[m])
        elif len(truth["effects"]) == 1:
            single.append((truth, found))
    middle = {key: np.median(values, axis=0) for key, values in clean.items()}
    np.set_printoptions(precision=3, suppress=True, linewidth=160)
    for (arm, motion), value in sorted(middle.items()):
        print(f"{arm:7s} {motion:10s} {len(clean[arm, motion]):3d} clean  rms {value[0]}  fast {value[1]}  AR(1) {value[2]}")
    raised = defaultdict(list)
    for truth, found in single:
        if (truth["arm"], MOTIONS[0]) in middle:
            over = [float(np.max(found[m][0] / middle[truth["arm"], m][0])) for m in MOTIONS]
            raised[truth["severity"]].append(max(over))
    for severity, values in sorted(raised.items()):
        print(
            f"severity {severity}: largest residual over clean, quartiles {np.quantile(values, [0.25, 0.5, 0.75])} of {len(values)}"
        )


if __name__ == "__main__":
    main()
