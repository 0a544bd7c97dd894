"""What the monitor process requires at every reading of a stage: of the arm, the guard's commands and the guard's stop."""

from __future__ import annotations

import numpy as np

from safety.collision import Clearance
from safety.coming_to_rest import STANDING_CYCLES
from safety.guard import STANDSTILL
from safety.monitor import Monitor
from safety.monitor_link import silence_of
from safety.signs import ENDED, HOLDS, STOPS, Sign
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState

# s after which a stopping arm must be slower than when its stop began, and after which it must be at rest
SLOWER_AFTER = 0.4
REST_AFTER = 4.0


class Watch:
    """The rules of one stage. Call `look` at every reading; `trip` is why the guard was asked to stop, or None."""

    def __init__(
        self, arm: Arm, cell: Cell, rate: float, clearance: Clearance, first: JointState, latency: float, tube: VerifiedSamples
    ) -> None:
        self.trip: str | None = None
        self.deaf = ""  # why no readings arrive
        self._monitor = Monitor(arm, cell, rate, clearance, first, latency)
        self._tube, self._silence = tube, silence_of(rate, latency)
        self._steps = 1 + int(np.ceil(self._silence * rate))
        self._noise = STANDSTILL + 8 * np.array(arm.sensors.velocity_noise)
        self._leg, self._k, self._still = -1, ENDED, 0
        self._q: np.ndarray | None = None
        self._tripped_at = self._stopping_since = self._fastest = np.inf

    def look(self, state: JointState | None, now: float, sign: Sign) -> str | None:
        """Why the arm must be taken from the guard now, or None. state: None if no reading arrived."""
        if sign.k in (STOPS, ENDED):
            return self._stopping(state, now)
        if not now - sign.at <= self._silence:
            return f"the guard was silent for {1e3 * (now - sign.at):.0f} ms, {1e3 * self._silence:.0f} ms are allowed"
        if self.trip is None:
            self.trip = self._rules(state, now, sign)
            self._tripped_at = now
        elif not now - self._tripped_at <= self._silence:
            return f"the guard did not stop within {1e3 * self._silence:.0f} ms after: {self.trip}"
        return None

    @property
    def at_rest(self) -> bool:
        """Whether the arm was seen at rest after the guard began to stop it, or ended."""
        return self._still >= STANDING_CYCLES

    def _stopping(self, state: JointState | None, now: float) -> str | None:
        if self.at_rest:
            return None
        speed = np.inf if state is None else float(np.max(np.abs(state.dq)))
        stands = state is not None and bool((np.abs(state.dq) <= self._noise).all())  # a single one may be a reversal
        self._still = self._still + 1 if stands else 0
        if self._stopping_since == np.inf:
            self._stopping_since, self._fastest = now, speed
        since = now - self._stopping_since
        if not (stands or since <= REST_AFTER):
            return f"the arm does not stand {REST_AFTER:g} s after its stop began"
        if not (stands or since <= SLOWER_AFTER or speed < self._fastest):
            return f"the arm is no slower {SLOWER_AFTER:g} s after its stop began"
        return None

    def _rules(self, state: JointState | None, now: float, sign: Sign) -> str | None:
        """The first broken rule as a sentence, or None."""
        if state is None:
            return f"the monitor process receives no more readings: {self.deaf}"
        found = None
        if sign.k != HOLDS:
            found = self._tube.sample(sign.leg, sign.k)
            if found is None or sign.q.tobytes() != found[0].tobytes():
                return f"command {sign.k} of motion {sign.leg} is not one that was verified"
        elif self._q is not None and sign.q.tobytes() not in (q.tobytes() for q in (self._q, *self._tube.last(self._leg))):
            return "the command changes while the guard holds the arm"
        if (sign.leg, sign.k == HOLDS) != (self._leg, self._k == HOLDS):
            self._monitor.pause()
            before = -1
        else:
            before = self._k
        if sign.k != HOLDS and not before <= sign.k <= before + self._steps:
            return f"command {sign.k} of motion {sign.leg} comes after {before}"
        self._leg, self._k, self._q = sign.leg, sign.k, sign.q
        trip = self._monitor.check(state, now, sign.q, None if found is None else found[1])
        return None if trip is None else str(trip)
