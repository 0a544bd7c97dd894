"""How well an arm predicts logs: torque along the measured motion, and motion under the measured torque.

Torque: tau_hat = sim.prediction along the measured motion, filtered like the measured torque. Forward: windows of HORIZON s start at the
measured state; MuJoCo gets the measured torque and nothing else, and the angle at the end is compared with the measured one. How far it may be
off is stated beforehand (calib.forward_bound), from what is known of the arm's numbers and nothing of this log's torque.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.forward_bound import forward_bound
from calib.identification.known import Known
from calib.preprocessing import Measurement, prepare
from logs.log import Log
from sim.arm import Arm
from sim.plant import Plant
from sim.prediction import predict

HORIZON = 0.25
MOST_WINDOWS = 60
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class LogCheck:
    """One log: RMS torque residual per joint (n,) N m, filtered as the fit's rows are and unfiltered, over usable rows and samples.

    signal: standard deviation of the filtered torque; forward: RMS (n,) rad of the angle after HORIZON s under the measured torque, None
    where it was not asked for; travel: RMS (n,) rad that the joints really moved in such a window; windows: how many.
    t (N,) s, tau and tau_hat (N, n) N m: every sample that has derivatives.
    """

    log: str
    residual: np.ndarray
    unfiltered: np.ndarray
    signal: np.ndarray
    rows: np.ndarray
    forward: np.ndarray | None
    travel: np.ndarray | None
    windows: int
    measurement: Measurement
    tau_hat: np.ndarray
    bound: np.ndarray | None = None

    @property
    def within_bound(self) -> np.ndarray | None:
        """(n,) whether the forward simulation stayed within its bound; None where there was none."""
        return None if self.forward is None or self.bound is None else self.forward <= self.bound


@dataclass(frozen=True)
class Validation:
    """The checks of several logs against one arm, and the outcome as a sentence; source: what the bounds rest on."""

    arm: Arm
    checks: tuple[LogCheck, ...]
    outcome: str
    source: str = ""

    def as_dict(self) -> dict[str, Any]:
        """validation.json."""
        constant = self.arm.torque_constant
        logs = []
        for c in self.checks:
            entry: dict[str, Any] = {
                "log": c.log,
                "residual": _numbers(c.residual),
                "residual_unfiltered": _numbers(c.unfiltered),
                "signal": _numbers(c.signal),
                "rows": c.rows.tolist(),
                "cutoff_hz": c.measurement.decimator.cutoff,
                "excluded": [[e.joint, e.reason, e.seconds] for e in c.measurement.excluded],
            }
            if constant is not None:
                entry["residual_ampere"] = _numbers(c.residual / constant)
            if c.forward is not None and c.travel is not None:
                entry["forward"] = {
                    "horizon_s": HORIZON, "windows": c.windows, "unit": "rad", "rms": _numbers(c.forward), "travel": _numbers(c.travel),
                }  # fmt: skip
                if c.bound is not None and c.within_bound is not None:
                    entry["forward"] |= {
                        "bound": _numbers(c.bound),
                        "within_bound": c.within_bound.tolist(),
                        "bound_from": self.source,
                    }
            logs.append(entry)
        return {
            "schema": "validation/1", "arm": self.arm.name, "unit": "N*m", "joints": list(self.arm.joint_names), "logs": logs,
            "outcome": self.outcome,
        }  # fmt: skip

    def write(self, folder: Path) -> None:
        """validation.json, and prediction.csv of all logs one after another (column `log` where there are several)."""
        (folder / "validation.json").write_text(json.dumps(self.as_dict(), indent=1) + "\n", encoding="utf-8")
        several = len(self.checks) > 1
        with (folder / "prediction.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            names = self.arm.joint_names
            writer.writerow(
                [*(["log"] if several else []), "t", *[f"tau_{j}" for j in names], *[f"tau_hat_{j}" for j in names]]
            )
            for c in self.checks:
                t = c.measurement.trajectory.t
                keep = np.flatnonzero(c.measurement.inside)
                table = np.column_stack([t, c.measurement.tau, c.tau_hat])[keep]
                lead = [c.log] if several else []
                writer.writerows([*lead, f"{row[0]:.6f}", *[f"{x:.6g}" for x in row[1:]]] for row in table)


def validate(
    arm: Arm,
    logs: Sequence[Log],
    forward: bool = True,
    cutoff: float | None = None,
    progress: Progress = lambda stage, share: None,
) -> Validation:
    """Predict every log with everything the arm has; BadLog and ConfigError for logs that cannot serve."""
    checks = []
    known = Known.of_arm(arm)
    for k, log in enumerate(logs):
        progress("torque", k / len(logs))
        m = prepare(log, arm, cutoff)
        tau_hat = predict(arm, m.trajectory)
        usable = m.row_usable
        rows, predicted = m.rows(m.tau), m.rows(tau_hat)
        moved = travelled = bound = None
        windows = 0
        if forward:
            progress("forward simulation", k / len(logs))
            moved, travelled, starts = forward_error(arm, m)
            windows = len(starts)
            if windows:
                bound = forward_bound(arm, m, starts, horizon_steps(m), known)
        checks.append(
            LogCheck(
                m.name, _rms(rows - predicted, usable), _rms(m.tau - tau_hat, m.usable), _std(rows, usable), usable.sum(axis=0),
                moved, travelled, windows, m, tau_hat, bound,
            )
        )  # fmt: skip
    return Validation(arm, tuple(checks), _outcome(arm, checks), known.source)


def horizon_steps(m: Measurement) -> int:
    """Samples of a window of HORIZON s."""
    return max(1, round(HORIZON * m.rate))


def forward_error(arm: Arm, m: Measurement) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """RMS angle error (n,) rad after HORIZON s under the measured torque, RMS travel (n,) rad, first samples of the windows.

    Windows lie where every joint moves: friction at rest holds any torque below its level, so a standing joint proves nothing.
    """
    plant = Plant(arm)
    steps = horizon_steps(m)
    good = m.usable.all(axis=1)
    run = np.convolve(good, np.ones(steps + 1), mode="valid") >= steps + 1
    starts = _spread(np.flatnonzero(run), steps, MOST_WINDOWS)
    offset, gain = _sensor(arm, "torque_offset", "offset", 0.0), _sensor(arm, "torque_gain", "gain", 1.0)
    nothing = np.zeros(arm.n)
    errors, travels = [], []
    tr = m.trajectory
    for k in starts:
        plant.reset(tr.q[k], tr.dq[k])
        for i in range(k, k + steps):
            # the torque of the middle of the step stands for the step
            tau = (0.5 * (m.tau[i] + m.tau[i + 1]) - offset) / gain
            plant.command(tr.q[i], tr.dq[i], tau, nothing, nothing)
            plant.advance(1 / m.rate)
        errors.append(plant.read().q - tr.q[k + steps])
        travels.append(tr.q[k + steps] - tr.q[k])
    if not errors:
        return np.full(arm.n, np.nan), np.full(arm.n, np.nan), []
    off, travel = (np.sqrt(np.mean(np.square(x), axis=0)) for x in (errors, travels))
    return off, travel, starts


def _spread(starts: np.ndarray, apart: int, most: int) -> list[int]:
    """At most `most` of the starts, each at least `apart` from the one before, spread over all of them."""
    chosen: list[int] = []
    for k in starts:
        if not chosen or k - chosen[-1] >= apart:
            chosen.append(int(k))
    if len(chosen) > most:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, most).astype(int)]
    return chosen


def _sensor(arm: Arm, effect: str, parameter: str, neutral: float) -> np.ndarray:
    found = [arm.effect(effect, joint) for joint in arm.joint_names]
    return np.array([e.parameters[parameter] if e else neutral for e in found])


def _rms(x: np.ndarray, usable: np.ndarray) -> np.ndarray:
    count = usable.sum(axis=0)
    return np.sqrt(np.where(usable, x**2, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan))


def _std(x: np.ndarray, usable: np.ndarray) -> np.ndarray:
    count = np.where(usable.any(axis=0), usable.sum(axis=0), np.nan)
    mean = np.where(usable, x, 0.0).sum(axis=0) / count
    return np.sqrt(np.where(usable, (x - mean) ** 2, 0.0).sum(axis=0) / count)


def _outcome(arm: Arm, checks: Sequence[LogCheck]) -> str:
    share = np.array([c.residual / np.where(c.signal > 0, c.signal, np.nan) for c in checks])
    if np.all(np.isnan(share)):
        return f"no joint of {arm.name} moves in these logs, so nothing was compared"
    worst = int(np.nanargmax(np.nanmax(np.where(np.isnan(share), -1.0, share), axis=0)))
    told = (
        f"the model of {arm.name} misses {np.nanmean(share):.1%} of the torque's variation, most at {arm.joint_names[worst]}: "
        f"{np.nanmax(share):.1%}"
    )
    moved = [c.forward for c in checks if c.forward is not None and c.windows]
    if moved:
        error = np.sqrt(np.mean(np.square(moved), axis=0))
        told += f"; simulated forward for {HORIZON:g} s its joints are off by {np.degrees(error.max()):.2g} deg at most (RMS), "
        told += _bounded(arm, checks)
    return told


def _bounded(arm: Arm, checks: Sequence[LogCheck]) -> str:
    """Whether the stated bounds were kept, and where not."""
    over = [
        f"{joint} in {c.log} ({np.degrees(c.forward[j]):.2g} deg, bound {np.degrees(c.bound[j]):.2g})"
        for c in checks
        if c.forward is not None and c.bound is not None and c.within_bound is not None
        for j, joint in enumerate(arm.joint_names)
        if not c.within_bound[j]
    ]
    return f"beyond the stated bound: {', '.join(over)}" if over else "within the stated bound at every joint"


def _numbers(x: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in x]
