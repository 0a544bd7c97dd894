"""Can the recordings be trusted? Faults of the recording are told apart from effects of the arm before any name is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.model import LogModel
from calib.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm

LEAST_SECONDS = 5.0  # usable, of a log
MOST_LOST = 0.3  # share of a log's samples
FROZEN = 0.5  # s with every reading of a joint the same to the last bit while others move
# A reading in other units or of the motor side is off by a factor of 9.55, 57.3 or the gear ratio; a wrong model by less.
FACTOR = 2.5
TORQUE_FACTOR = 4.0  # beyond what torque_gain may be; friction, which is most of a wrist's torque, changes by less
LEAST_CORRELATION = 0.8


@dataclass(frozen=True)
class Check:
    """One line of `data_checks`."""

    check: str
    ok: bool
    detail: str

    def entry(self) -> dict[str, object]:
        """As diagnosis.json has it."""
        return {"check": self.check, "ok": bool(self.ok), "detail": self.detail}


def checks(logs: Sequence[Log], measurements: Sequence[Measurement], models: Sequence[LogModel], arm: Arm) -> list[Check]:
    """All checks of all logs; models are of the nominal arm."""
    out = []
    for log, m in zip(logs, measurements, strict=True):
        out += [_sampling(log, m), _usable(m), _frozen(log, m), _speed(log, m), *_clock(log, m)]
    return [*out, *_torque(models, arm)]


def _sampling(log: Log, m: Measurement) -> Check:
    step = np.diff(log.t)
    lost = 1.0 - len(log) / max(1.0, (log.t[-1] - log.t[0]) / float(np.median(step)) + 1.0)
    detail = (
        f"{m.name}: {1 / np.median(step):.4g} Hz, {max(lost, 0.0):.1%} of the samples missing, longest gap {step.max():.3g} s"
    )
    return Check("sampling", lost < MOST_LOST, detail)


def _usable(m: Measurement) -> Check:
    seconds = float(m.usable.any(axis=1).sum()) / m.rate
    return Check("motion", seconds >= LEAST_SECONDS, f"{m.name}: {seconds:.1f} s with a joint in motion")


def _clock(log: Log, m: Measurement) -> list[Check]:
    if log.clock is None:
        return []
    ppm = 1e6 * float(log.clock.skew)
    return [Check("clock", True, f"{m.name}: device and host clock differ by {ppm:.0f} ppm; device time is used")]


def _frozen(log: Log, m: Measurement) -> Check:
    """Both readings of a joint stand to the last bit: a position alone may stand within the encoder's resolution."""
    shortest = max(3, round(FROZEN / float(np.median(np.diff(log.t)))))
    moving = np.abs(np.diff(log.q, axis=0)).max(axis=1) > 0
    worst: tuple[int, str] = (0, "")
    for j, joint in enumerate(log.joint_names):
        effort = log.tau[:, j] if np.isfinite(log.tau[:, j]).any() else log.current[:, j]
        same = (np.diff(log.q[:, j]) == 0) & (np.diff(effort) == 0) & moving
        run = _longest(same)
        worst = max(worst, (run, joint))
    ok = worst[0] < shortest
    seconds = worst[0] * float(np.median(np.diff(log.t)))
    detail = (
        f"{m.name}: no joint's readings stand"
        if ok
        else f"{m.name}: the readings of {worst[1]} stand still for {seconds:.2f} s"
    )
    return Check("frozen joints", ok, detail)


def _longest(flags: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _speed(log: Log, m: Measurement) -> Check:
    """The speed reading against the position's derivative."""
    for j, joint in enumerate(log.joint_names):
        read = np.interp(m.trajectory.t, log.t, np.nan_to_num(log.dq[:, j]))
        seen = m.trajectory.dq[:, j]
        ok = m.usable[:, j] & np.isfinite(seen)
        if not np.isfinite(log.dq[:, j]).any() or ok.sum() < 50:
            continue
        slope = float(read[ok] @ seen[ok]) / max(float(seen[ok] @ seen[ok]), 1e-12)
        if not 1 / FACTOR < slope < FACTOR:
            return Check(
                "units",
                False,
                f"{m.name}: the speed of {joint} is {slope:.3g} times the derivative of its position; "
                "check units (degrees, rpm), sign and gear ratio",
            )
    return Check("units", True, f"{m.name}: speed is the derivative of position")


def _torque(models: Sequence[LogModel], arm: Arm) -> list[Check]:
    """Torque readings against the nominal model: a sign, unit or gear ratio is a factor, not an effect."""
    out = []
    for j, joint in enumerate(arm.joint_names):
        # All rows: a reading in wrong units lies beyond the joint's limit, and would be left out as clipped.
        read = np.concatenate([m.rows(m.measurement.tau[:, j]) for m in models])
        wanted = np.concatenate([m.rows(m.tau_hat[:, j]) for m in models])
        if len(read) < 50 or np.std(wanted) == 0 or np.std(read) == 0:
            continue
        slope = float(read @ wanted) / float(wanted @ wanted)
        correlation = float(read @ wanted) / float(np.linalg.norm(read) * np.linalg.norm(wanted))
        if correlation < -LEAST_CORRELATION:
            out.append(Check("sign", False, f"the torque of {joint} has the opposite sign of the model's; check its direction"))
        elif correlation > LEAST_CORRELATION and not 1 / TORQUE_FACTOR < slope < TORQUE_FACTOR:
            detail = f"the torque of {joint} is {slope:.3g} times the model's; check its unit, torque constant and gear ratio"
            out.append(Check("scale", False, detail))
    return out or [Check("torque", True, "sign and size of every joint's torque are the model's")]
