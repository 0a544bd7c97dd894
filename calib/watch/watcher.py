"""A watcher takes readings, one after the other, and reports what changed about the arm. It only reads.

Blocks of about 20 ms make rows of the momentum balance; the filter follows payload and friction; load, wear and validity decide.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from calib.measurement.standing import Push, Standing
from calib.watch.broken import BrokenWatch
from calib.watch.events import Kind, Quantity, WatchEvent
from calib.watch.filter import TorqueFilter
from calib.watch.intake import Intake, ReadingFault, Sample
from calib.watch.load import LoadWatch
from calib.watch.momentum import MomentumBalance, Row
from calib.watch.picture import Declared, Picture
from calib.watch.rate import RateWatch
from calib.watch.validity import ValidityWatch
from calib.watch.wear import WearWatch
from sim.arm import Arm
from sim.joint_state import JointState

BLOCK = 0.02  # s
AGAIN = 10.0  # s before the same kind of fault is reported again
NIS_MEMORY = 10.0  # s of motion
DECLARED_SHARE = 0.05  # of the declared mass, by which it may be off


class Watcher:
    """`add` takes every reading of an arm and returns its events; `rate` Hz is the device's; `gravity` (3,) m/s^2 its mounting."""

    def __init__(self, arm: Arm, rate: float, declared: Declared | None = None, gravity: np.ndarray | None = None) -> None:
        self.arm, self.declared, self._gravity = arm, declared, gravity
        self._rate = RateWatch(rate)
        self._begin(rate)
        drives = self._balance.drives
        known = _modelled_payload(arm)
        first = np.zeros(4)
        if declared is not None:
            first = np.array([declared.mass, *(declared.mass * np.array(declared.com))]) - known
        self._filter = TorqueFilter(arm, drives.coulomb, drives.viscous, first)
        self._load = LoadWatch(arm, self._filter, known)
        self._wear = WearWatch(arm, self._filter, drives.coulomb, drives.viscous)
        self._validity = ValidityWatch(arm, self._filter)
        self._standing = Standing(arm, gravity)
        self._push = np.nan  # start of the push that was reported last
        self._temperature = np.full(arm.n, np.nan)
        self._reported_at: dict[Kind, float] = {}
        self._faults: dict[str, int] = {}
        self._nis = np.nan
        self._samples = 0
        self._row: Row | None = None
        self._due: Row | None = None
        self._still = True
        self._complained = np.nan

    def _begin(self, rate: float) -> None:
        """Set up everything that counts readings, for `rate` Hz."""
        self._intake = Intake(self.arm, rate)
        self._broken = BrokenWatch(self.arm.n, rate)
        self._balance = MomentumBalance(self.arm, self._gravity, max(2, round(BLOCK * rate)))
        delay = max(self._balance.drives.delay, 0.0)
        self._delay: deque[Sample] = deque(maxlen=max(2, int(np.ceil(delay * rate)) + 2))

    @property
    def not_followed(self) -> tuple[str, ...]:
        """Effects of the arm that a watcher leaves in the unexplained torque."""
        return self._balance.drives.not_followed

    def add(self, state: JointState) -> list[WatchEvent]:
        """Take one reading; return its events."""
        self._samples += 1
        events, row = self._rest() + self._rated(state.t_device), self._row
        samples, fault = self._intake.add(state)
        for sample in samples:
            events += self._joined(sample)
        if fault is not None:
            events += self._rest() + self._faulty(fault)
        seen = 0.0 if self._row is None or self._row is row else self._row.seconds
        events += self._broken.add(state, seen, ", ".join(f"{k.replace('_', ' ')}: {n}" for k, n in self._faults.items()))
        # an event has the time of the newest reading, not that of the end of the block that shows it
        return [replace(e, t=state.t_device) for e in events] if events and np.isfinite(state.t_device) else events

    def _rated(self, t: float) -> list[WatchEvent]:
        """Report a rate that differs from the stated one; the actual one counts from then on."""
        period = self._rate.add(t)
        if period is None:
            return []
        stated, repeated = self._intake.period, self._intake.repeated
        self._begin(1.0 / period)
        self._intake.repeated = repeated
        text = f"readings come every {1e3 * period:.3g} ms, but the stated period is {1e3 * stated:.3g} ms: correct the rate; watched at {1 / period:.4g} Hz"
        return [WatchEvent(Kind.WRONG_RATE, t, (t, t), text)]

    def _joined(self, sample: Sample) -> list[WatchEvent]:
        """Add a sample to its block. When the block is full, the load is decided at once, the rest in the next cycle."""
        self._temperature = sample.temperature
        push = self._standing.add(sample.t, sample.q, sample.tau)
        events = [] if push is None else self._pushed(push, sample.t)
        taken = self._aligned(sample)
        row = self._balance.add(taken.t, taken.q, taken.dq, taken.tau)
        if row is None:
            return events
        events += self._rest()
        self._due = row
        return events + self._load_of(row)

    def _rest(self) -> list[WatchEvent]:
        """Do what is still due for the last row, so that no cycle has all of the work."""
        row, self._due = self._due, None
        return [] if row is None else self._wear_of(row)

    def picture(self) -> Picture:
        """The present estimates."""
        return Picture(
            t=self._row.t if self._row is not None else np.nan, payload=self._load.mass(), claimed=self._load.claimed, com=self._load.com() if self._load.settled else None,
            settled=self._load.settled, deciding=self._load.deciding, fits=self._validity.fits, friction=self._wear.now(self._temperature),
            nis=self._nis, moved=self._load.moved.copy(), seconds=self._validity.seconds.copy(), residual=self._validity.residual,
            compared_from=self._validity.compared_from.copy(), hidden=self._hidden(),
            samples=self._samples, faults=self._faults | ({"repeated": repeated} if (repeated := self._intake.repeated) else {}),
            broken=self._broken.broken,
        )  # fmt: skip

    def _load_of(self, row: Row) -> list[WatchEvent]:
        self._row = row
        self._still = not self._filter.usable(row).any()
        events, innovation = self._load.add(row, self._validity.fits is True)
        if innovation is not None:
            share = min(row.seconds / NIS_MEMORY, 1.0)
            now = innovation.nis / innovation.degrees
            self._nis = now if np.isnan(self._nis) else self._nis + share * (now - self._nis)
        return events

    def _wear_of(self, row: Row) -> list[WatchEvent]:
        events = []
        if not self._load.deciding and not self._still:
            events += self._validity.add(row, self._load.settled)
            if self._validity.fits:
                events += self._wear.add(row, self._temperature)
        return events + self._compared(row)

    def _compared(self, row: Row) -> list[WatchEvent]:
        """Compare the declared with the estimated payload; a difference is reported once for every declared value."""
        declared = self.declared
        if declared is None or not self._validity.fits or self._load.deciding or self._complained == declared.mass:
            return []
        mass = self._load.mass()
        off = abs(mass.value - declared.mass)
        if not (off > 5 * mass.std and off > max(self._load.least, DECLARED_SHARE * declared.mass)):
            return []
        self._complained = declared.mass
        text = (
            f"{declared.by} states {declared.mass:.3g} kg at the flange, the torques show {mass}; correct the declared payload"
        )
        size = {"mass": mass, "declared_mass": Quantity(declared.mass, 0.0, "kg")}
        return [WatchEvent(Kind.DECLARED_PAYLOAD_WRONG, row.t, (row.t, row.t), text, size)]

    def _pushed(self, push: Push, t: float) -> list[WatchEvent]:
        """Events of a push against the standing arm: when it is certain, and when it is over."""
        j, joint = push.joint, self.arm.joint_names[push.joint]
        size = Quantity(float(push.torque[j]), float(push.doubt[j] / np.sqrt(12.0)), "N*m")
        text = (
            f"something pushes the standing arm: {joint} carries {size} more than before, of which dry friction can hold at most "
            f"{push.doubt[j]:.3g} N m"
        )
        began = WatchEvent(Kind.UNEXPECTED_CONTACT, t, (push.start, t), text, {"torque": size}, joint)
        if np.isnan(push.end):
            self._push = push.start
            return [began]
        seconds = Quantity(push.end - push.start, BLOCK, "s")
        text = f"the contact ended after {seconds.value:.2f} s"
        ended = WatchEvent(Kind.CONTACT_ENDED, t, (push.start, push.end), text, {"duration": seconds})
        return [ended] if self._push == push.start else [began, ended]

    def _faulty(self, fault: ReadingFault) -> list[WatchEvent]:
        """Count a fault, and report each kind at most every `AGAIN` seconds; no balance spans a break."""
        if fault.breaks:
            self._delay.clear()
            self._balance.forget()
            self._standing.forget()
        self._faults[fault.kind.value] = self._faults.get(fault.kind.value, 0) + 1
        if fault.t - self._reported_at.get(fault.kind, -np.inf) < AGAIN:
            return []
        self._reported_at[fault.kind] = fault.t
        return [
            WatchEvent(fault.kind, fault.t, (fault.t, fault.t), f"{fault.message}; left out, as it shows nothing about the arm")
        ]

    def _aligned(self, sample: Sample) -> Sample:
        """The sample's torque with the motion that it belongs to, where the arm's torque channel lags."""
        delay = self._balance.drives.delay
        if delay <= 0:
            return sample
        self._delay.append(sample)
        then = sample.t - delay
        for before, after in zip(self._delay, list(self._delay)[1:], strict=False):
            if before.t <= then <= after.t:
                share = (then - before.t) / (after.t - before.t)
                q, dq = (getattr(before, x) + share * (getattr(after, x) - getattr(before, x)) for x in ("q", "dq"))
                return Sample(sample.t, q, dq, sample.tau, sample.temperature)
        return sample

    def _hidden(self) -> float | None:
        """Largest mass, kg, whose weight stays below the dry friction of every joint in the present pose; None while the arm moves."""
        if self._row is None or not self._still:
            return None
        lever = np.abs(self._row.payload[:, 0])
        return float(np.min(self._filter.dry / np.maximum(lever, 1e-9)))


def rehearse(arm: Arm, rate: float) -> None:
    """Run everything once on made-up readings, so that the first real ones do not wait for compilation."""
    watcher, nothing = Watcher(arm, rate), np.full(arm.n, np.nan)
    for k in range(8 * max(2, round(BLOCK * rate))):
        t = k / rate
        watcher.add(JointState(t, t, np.full(arm.n, 0.1 * t), np.full(arm.n, 0.1), 1e-6 * k * np.ones(arm.n), nothing, nothing))
    if watcher._row is not None:
        for _ in range(6):
            watcher._filter.add(watcher._row)


def _modelled_payload(arm: Arm) -> np.ndarray:
    """[m, m c] of the payload among the arm's own effects."""
    payload = arm.effect("payload")
    if payload is None:
        return np.zeros(4)
    p = payload.parameters
    return p["mass"] * np.array([1.0, p["com_x"], p["com_y"], p["com_z"]])
