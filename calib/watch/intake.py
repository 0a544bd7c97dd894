"""Screening of readings: one that is missing, impossible, late or frozen is reported and never reaches an estimate.

A reading counts at once, unless its torque has jumped by more than motion can cause. It then waits for the next one, which shows
whether it was a single outlier. An impossible reading is dropped as if it had been lost: its neighbours belong together unless the
time between them is a gap. A reading that arrives twice counts once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.watch.events import Kind
from sim.arm import Arm
from sim.errors import ConfigError
from sim.joint_state import JointState

GAP_PERIODS = 3.5
FROZEN_SECONDS, FROZEN_PERIODS = 0.03, 3.5  # whichever is longer
MOVING = 0.05  # rad/s
SPIKE = 0.3  # of the largest torque: a rise and fall by that much within two periods is not motion


@dataclass(frozen=True, slots=True)
class Sample:
    """A reading that counts: t s device clock, q rad, dq rad/s, tau N m of the drives, temperature degC, (n,) each."""

    t: float
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    temperature: np.ndarray


@dataclass(frozen=True, slots=True)
class ReadingFault:
    """A fault of the readings at t; `message` states it with values. breaks: readings before and after do not belong together."""

    kind: Kind
    t: float
    message: str
    breaks: bool = True


class Intake:
    """Readings in, samples or faults out; `rate` Hz is the stated rate of the device; `repeated` counts duplicate readings."""

    def __init__(self, arm: Arm, rate: float) -> None:
        if not (np.isfinite(rate) and rate > 0):
            raise ConfigError(f"rate = {rate} Hz of {arm.name}: it must be above zero; see the driver or the log")
        self._arm, self.period = arm, 1.0 / rate
        unlimited = lambda x: np.where(np.isfinite(x), x, np.inf)  # noqa: E731
        self._tau_most, self._dq_most = 3.0 * unlimited(arm.tau_max), 2.0 * unlimited(arm.dq_max)
        noise = np.array(arm.sensors.torque_noise)
        self._spike = np.maximum(10 * noise, SPIKE * unlimited(arm.tau_max))
        self.repeated = 0
        self._newest: JointState | None = None
        self._last: Sample | None = None
        # the sample before one whose torque is in doubt
        self._waiting: Sample | None = None
        self._same_q = self._same_tau = 0.0
        self._frozen = max(FROZEN_SECONDS, FROZEN_PERIODS * self.period)
        self._moving = max(MOVING, 4 * arm.sensors.encoder_resolution / self._frozen)

    def add(self, state: JointState) -> tuple[list[Sample], ReadingFault | None]:
        """Take one reading; return the samples that count from now on, and the fault, if any."""
        newest, self._newest = self._newest, state
        if newest is not None and _same(newest, state):
            self.repeated += 1
            return [], None
        sample, fault = self._single(state)
        if sample is None:
            return [], fault
        last, self._last = self._last, sample
        if last is None:
            return [sample], None
        step = sample.t - last.t
        if not step > 0:
            return [], self._broken(Kind.BAD_READING, sample.t, f"device time goes from {last.t:.6f} to {sample.t:.6f} s")
        if step > GAP_PERIODS * self.period:
            message = f"no reading for {1e3 * step:.0f} ms; one is due every {1e3 * self.period:.3g} ms"
            return [], self._broken(Kind.GAP, sample.t, message)
        fault = self._continuous(last, sample, step)
        if fault is not None:
            return [], fault
        return self._counting(last, sample)

    def _counting(self, last: Sample, sample: Sample) -> tuple[list[Sample], ReadingFault | None]:
        """The sample; none while its torque is in doubt; or the one that was in doubt, and the sample."""
        before, waited = self._waiting, self._waiting is not None
        self._waiting = None
        if before is not None:
            rise, fall = last.tau - before.tau, last.tau - sample.tau
            spike = (np.minimum(np.abs(rise), np.abs(fall)) > self._spike) & (rise * fall > 0)
            if spike.any():
                j = int(np.argmax(spike))
                values = f"one reading of {last.tau[j]:.4g} N m between {before.tau[j]:.4g} and {sample.tau[j]:.4g}"
                return [], self._broken(Kind.BAD_READING, last.t, f"{self._arm.joint_names[j]}: {values}")
        if np.any(np.abs(sample.tau - last.tau) > self._spike):
            self._waiting = last
            return [last] if waited else [], None
        return [last, sample] if waited else [sample], None

    def _single(self, state: JointState) -> tuple[Sample | None, ReadingFault | None]:
        names = self._arm.joint_names
        wrong = partial(ReadingFault, breaks=False)
        if state.n != self._arm.n:
            return None, wrong(
                Kind.WRONG_ARM, state.t_device, f"a reading of {state.n} joints, {self._arm.name} has {self._arm.n}"
            )
        tau = state.tau
        if not np.isfinite(tau).all() and self._arm.torque_constant is not None:
            tau = np.where(np.isfinite(tau), tau, state.current * self._arm.torque_constant)
        dq = state.dq
        if np.isnan(dq).all() and self._last is not None and state.t_device > self._last.t:
            dq = (state.q - self._last.q) / (state.t_device - self._last.t)
        if not np.isfinite(state.t_device):
            return None, wrong(Kind.BAD_READING, self._last.t if self._last else 0.0, f"device time is {state.t_device}")
        for word, unit, value, most in (
            ("position", "rad", state.q, 1e3), ("speed", "rad/s", dq, self._dq_most), ("torque", "N m", tau, self._tau_most),
        ):  # fmt: skip
            bad = ~(np.abs(value) <= most)
            if word == "speed" and np.isnan(state.dq).all() and self._last is None:
                dq = np.zeros(self._arm.n)
            elif bad.any():
                j = int(np.argmax(bad))
                rule = (
                    "it must be a number"
                    if not np.isfinite(value[j])
                    else f"no joint of this arm reaches {np.broadcast_to(most, bad.shape)[j]:.4g}"
                )
                return None, wrong(Kind.BAD_READING, state.t_device, f"{names[j]}: {word} is {value[j]:.4g} {unit}; {rule}")
        return Sample(state.t_device, state.q, dq, tau, state.temperature), None

    def _continuous(self, ready: Sample, after: Sample, step: float) -> ReadingFault | None:
        moved = np.abs(after.q - ready.q)
        allowed = self._dq_most * step + 0.02
        if not np.all(moved <= allowed):
            j = int(np.argmax(moved - allowed))
            return self._broken(
                Kind.BAD_READING,
                after.t,
                f"{self._arm.joint_names[j]}: position jumps {moved[j]:.4g} rad in {1e3 * step:.3g} ms",
            )
        moving = np.abs(after.dq) > self._moving
        self._same_q = self._same_q + step if moving.any() and np.all(moved[moving] == 0) else 0.0
        self._same_tau = self._same_tau + step if moving.any() and np.array_equal(after.tau, ready.tau) else 0.0
        for word, seconds in (("positions", self._same_q), ("torques", self._same_tau)):
            if seconds > self._frozen:
                return self._broken(Kind.FROZEN, after.t, f"the {word} have not changed for {1e3 * seconds:.0f} ms of motion")
        return None

    def _broken(self, kind: Kind, t: float, message: str) -> ReadingFault:
        self._waiting = None
        return ReadingFault(kind, t, message)


def _same(a: JointState, b: JointState) -> bool:
    """Whether two readings are duplicates: instant and values are equal."""
    if a.t_device != b.t_device:
        return False
    return all(np.array_equal(getattr(a, x), getattr(b, x), equal_nan=True) for x in ("q", "dq", "tau", "current"))
