"""How well an arm predicts logs: torque along the measured motion, and motion under the measured torque.

Torque: sim.prediction along the measured motion, filtered like the measured torque. Motion: calib.validation.forward over its
horizons. The bound on the shortest (calib.validation.forward_bound) uses the uncertainty of the arm and no torque of this log.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims import Claim, in_one_sentence
from calib.gate.commands import require
from calib.identification.known import Known
from calib.measurement.preprocessing import Measurement, prepare
from calib.measurement.reversals import reversal_rows, reverses_often
from calib.passivity import driving_claims
from calib.validation.forward import HORIZONS, SHORT, ForwardError, forward_error
from calib.validation.forward_bound import forward_bound
from calib.verdict import Assessment, assess
from logs.log import Log
from sim.arm import Arm
from sim.prediction import predict

# s in motion, and travel in rad (m): with less, a joint's torque may be anything within its dry friction
LEAST_MOTION, LEAST_TRAVEL = 3.0, 0.01
INFORMATIVE = 0.5  # share of the travel: a larger bound would hold for almost any arm
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class LogCheck:
    """Check of one log: RMS torque residual (n,) N m over usable rows, filtered as in a fit, and usable samples, unfiltered.

    sliding: over the `slid` (n,) rows that no reversal touches. NaN for a joint that moved less than LEAST_MOTION or
    LEAST_TRAVEL. signal: standard deviation of the filtered torque; motion: error over each horizon; bound (n,) rad: of the
    shortest; tau_hat (N, n) N m.
    """

    log: str
    residual: np.ndarray
    sliding: np.ndarray
    unfiltered: np.ndarray
    signal: np.ndarray
    rows: np.ndarray
    slid: np.ndarray
    motion: tuple[ForwardError, ...]
    measurement: Measurement
    tau_hat: np.ndarray
    bound: np.ndarray | None = None

    @property
    def short(self) -> ForwardError | None:
        """The error over the shortest horizon; None if nothing was simulated."""
        return self.motion[0] if self.motion and self.motion[0].starts else None

    @property
    def within_bound(self) -> np.ndarray | None:
        """(n,) whether the forward simulation stayed within its bound; None if there is none."""
        return None if self.short is None or self.bound is None else self.short.angle <= self.bound

    @property
    def informative(self) -> np.ndarray:
        """(n,) whether the bound is at most INFORMATIVE of the joint's travel."""
        none = np.zeros(len(self.residual), dtype=bool)
        return none if self.bound is None or self.short is None else np.asarray(self.bound <= INFORMATIVE * self.short.travel)


@dataclass(frozen=True)
class Validation:
    """Checks of several logs against one arm, verdict per joint, and claims; source: what the bounds are based on."""

    arm: Arm
    checks: tuple[LogCheck, ...]
    assessment: Assessment
    claims: tuple[Claim, ...]
    source: str = ""

    @property
    def outcome(self) -> str:
        """The claims in one sentence."""
        return in_one_sentence(self.claims)

    def as_dict(self) -> dict[str, Any]:
        """validation.json."""
        constant = self.arm.torque_constant
        logs = []
        for c in self.checks:
            entry: dict[str, Any] = {
                "log": c.log, "residual": _numbers(c.residual), "residual_sliding": _numbers(c.sliding),
                "residual_unfiltered": _numbers(c.unfiltered), "signal": _numbers(c.signal), "rows": c.rows.tolist(),
                "rows_sliding": c.slid.tolist(), "cutoff_hz": c.measurement.decimator.cutoff,
                "excluded": [[e.joint, e.reason, e.seconds] for e in c.measurement.excluded],
            }  # fmt: skip
            if constant is not None:
                entry["residual_ampere"] = _numbers(c.residual / constant)
            entry["motion"] = [e.entry() for e in c.motion if e.starts]
            if c.short is not None:
                entry["forward"] = {
                    "horizon_s": SHORT.seconds, "windows": len(c.short.starts), "unit": "rad",
                    "rms": _numbers(c.short.angle), "travel": _numbers(c.short.travel),
                }  # fmt: skip
                if c.bound is not None and c.within_bound is not None:
                    entry["forward"] |= {
                        "bound": _numbers(c.bound), "within_bound": c.within_bound.tolist(),
                        "informative": c.informative.tolist(), "bound_from": self.source,
                    }  # fmt: skip
            logs.append(entry)
        return {
            "schema": "validation/1", "arm": self.arm.name, "unit": "N*m", "joints": list(self.arm.joint_names), "logs": logs,
            "outcome": self.outcome, **self.assessment.as_dict(), "claims": [claim.as_dict() for claim in self.claims],
        }  # fmt: skip

    def write(self, folder: Path) -> None:
        """Write validation.json, and prediction.csv of all logs in sequence (column `log` if there are several)."""
        (folder / "validation.json").write_text(json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
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
    most: float | None = None,
) -> Validation:
    """Predict every log with everything the arm has; BadLog or ConfigError if a log is unusable or not of this arm.

    most: share of its torque's variation that every joint may leave; by default the limits of `calib.verdict`.
    """
    progress("checking", 0.0)
    require(arm, logs)
    known = Known.of_arm(arm)
    checks = []
    for k, log in enumerate(logs):
        share = k / len(logs)
        checks.append(checked(arm, log, known if forward else None, cutoff, lambda stage, share=share: progress(stage, share)))  # type: ignore[misc]
    found = _assessed(arm, checks, most)
    where = checks[0].log if len(checks) == 1 else f"{len(checks)} logs"
    driving = driving_claims(arm, [c.measurement for c in checks], np.fmax.reduce([c.residual for c in checks]))
    return Validation(
        arm, tuple(checks), found, (found.claim(arm.name, where), *driving, *forward_claims(arm, checks)), known.source
    )


def checked(
    arm: Arm, log: Log, known: Known | None, cutoff: float | None = None, progress: Callable[[str], None] = lambda stage: None
) -> LogCheck:
    """What the arm predicts of one log, with forward simulation if `known` is given; does not check that the log is its own."""
    progress("torque")
    m = prepare(log, arm, cutoff)
    tau_hat = predict(arm, m.trajectory)
    usable = m.row_usable & _moved(m)
    slid = usable & (~reversal_rows(m, arm) | reverses_often([m], arm))
    rows, predicted = m.rows(m.tau), m.rows(tau_hat)
    motion: tuple[ForwardError, ...] = ()
    bound = None
    if known is not None:
        progress("forward simulation")
        motion = tuple(forward_error(arm, m, horizon) for horizon in HORIZONS)
        if motion[0].starts:
            bound = forward_bound(arm, m, motion[0].starts, SHORT.steps(m), known)
    return LogCheck(
        m.name, _rms(rows - predicted, usable), _rms(rows - predicted, slid), _rms(m.tau - tau_hat, m.usable & _moved(m)),
        _std(rows, usable), usable.sum(axis=0), slid.sum(axis=0), motion, m, tau_hat, bound,
    )  # fmt: skip


def _moved(m: Measurement) -> np.ndarray:
    """(n,) whether a joint moved enough for its torque to be compared."""
    seconds = m.row_usable.sum(axis=0) / m.decimator.row_rate
    q = np.where(m.usable, m.trajectory.q, np.nan)
    travel = np.fmax.reduce(q, initial=-np.inf) - np.fmin.reduce(q, initial=np.inf)
    moved: np.ndarray = (seconds >= LEAST_MOTION) & (travel >= LEAST_TRAVEL)
    return moved


def _rms(x: np.ndarray, usable: np.ndarray) -> np.ndarray:
    count = usable.sum(axis=0)
    return np.sqrt(np.where(usable, x**2, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan))


def _std(x: np.ndarray, usable: np.ndarray) -> np.ndarray:
    count = np.where(usable.any(axis=0), usable.sum(axis=0), np.nan)
    return _rms(x - np.where(usable, x, 0.0).sum(axis=0) / count, usable)


def _assessed(arm: Arm, checks: Sequence[LogCheck], most: float | None) -> Assessment:
    """Assessment of all logs together, from the RMS over their rows."""

    def together(x: Sequence[np.ndarray], over: Sequence[np.ndarray]) -> np.ndarray:
        rows, count = np.array(over, dtype=float), np.sum(over, axis=0)
        power = np.where(rows > 0, np.square(x), 0.0) * rows
        return np.sqrt(power.sum(axis=0) / np.where(count > 0, count, np.nan))

    residual = together([c.sliding for c in checks], [c.slid for c in checks])
    signal = together([c.signal for c in checks], [c.rows for c in checks])
    return assess(arm.joint_names, residual, signal, arm.tau_max, most)


def forward_claims(arm: Arm, checks: Sequence[LogCheck]) -> list[Claim]:
    """Error of the simulation, or its instability, and whether the bounds were kept; a vague bound does not count as kept."""
    unstable = [c.log for c in checks if c.short is not None and c.short.starts and not np.isfinite(c.short.angle).all()]
    said = [Claim("unstable", {"horizon": SHORT.seconds, "logs": unstable})] if unstable else []
    rows: list[dict[str, Any]] = [
        {
            "joint": joint, "log": c.log, "off_deg": float(np.degrees(c.short.angle[j])), "travel_deg": float(np.degrees(c.short.travel[j])),
            "bound_deg": float(np.degrees(c.bound[j])), "informative": bool(c.informative[j]),
        }
        for c in checks
        if c.short is not None and c.bound is not None and c.log not in unstable
        for j, joint in enumerate(arm.joint_names)
    ]  # fmt: skip
    if not rows:
        return said
    worst = max(rows, key=lambda r: float(r["off_deg"]))
    beyond = [r for r in rows if not r["off_deg"] <= r["bound_deg"]]
    off = {r["joint"] for r in beyond}
    vague = [j for j in arm.joint_names if any(r["joint"] == j and not r["informative"] for r in rows)]
    within = [j for j in arm.joint_names if j not in off and j not in vague]
    return [
        *said,
        Claim("forward", {"horizon": SHORT.seconds, **{k: worst[k] for k in ("joint", "log", "off_deg", "travel_deg")}}),
        Claim(
            "bounds", {"rows": rows, "within": within, "beyond": beyond, "not_informative": [j for j in vague if j not in off]}
        ),
    ]


def _numbers(x: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in x]
