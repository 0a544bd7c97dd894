"""Does the arm do what it was commanded? Checked at every reading; every rule is written so that NaN breaks it.

Values that a device does not report (NaN in its first reading) are not required; once reported, they must go on being reported.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safety.collision import GJK, Clearance
from safety.readings import Readings
from safety.sudden import LATE, blend
from safety.trip import Trip
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState, Status

PERIODS = 3.5
PAUSE_MAX = 3600.0  # s between two motions; a longer step is a clock that jumped
# Below the 5 deg and 1.15 deg/s by which a UR controller lets a joint exceed its own safety limits, so that this trips first
# (Universal Robots e-Series user manual, "Safety-related functions and interfaces", tolerances).
Q_OVER = 0.05
DQ_OVER = 0.02
SIGMAS = 6.0
TEMPERATURE_MAX = 75.0
# a sensor that reads colder is broken
TEMPERATURE_MIN = -40.0
RESIDUAL = 0.3
RESIDUAL_STEP = 0.05
# noise of a reading less a mean of such readings that may have begun with one of them
TWO_READINGS = 1.5
# a reading by itself may be out by so much of the band on one joint: a drive's current has spikes, a blow lasts and meets several joints
SPIKE = 2.0
FROZEN = 10
# a position that stays although the joint was commanded to turn by more than its grain, and says that it does, is frozen sooner: by then its
# reading is too old. A joint that sticks where it was commanded to end or to turn back is not: a speed made of positions shows that late.
FROZEN_LEAST = 3
WINDOW = 5
# pairs whose distance is looked at in every cycle, whether or not they may be near by now
LOOKS = 2


class Expected(NamedTuple):
    """What a motion should take: torque (n,) N m, the half-width of its interval, how far it may be missed of a sudden, room rad beside it."""

    tau_hat: np.ndarray
    doubt: np.ndarray
    sudden: np.ndarray
    room: float


class Monitor:
    """Rules for one run; `check` after every reading, in order."""

    def __init__(
        self, arm: Arm, cell: Cell, rate: float, clearance: Clearance, first: JointState, latency: float = 0.0
    ) -> None:
        n = arm.n
        self.arm, self._period = arm, 1.0 / rate
        self._late = max(PERIODS * self._period, latency + self._period)
        noise = np.array(arm.sensors.velocity_noise)
        self._q_lo, self._q_hi = arm.q_min - Q_OVER, arm.q_max + Q_OVER
        self._dq_hi = arm.dq_max + DQ_OVER + SIGMAS * noise
        self._jump = 1.5 * arm.dq_max
        self._grain = 10 * arm.sensors.encoder_resolution + 1e-4
        self._room = self._most = cell.table.motion.following_error_max
        self._dq_doubt = 0.1 * arm.dq_max + 0.04 * arm.ddq_max + SIGMAS * noise
        self._moving = np.maximum(0.02, 8 * noise)
        torque_noise = SIGMAS * np.array(arm.sensors.torque_noise)
        self._residual = RESIDUAL * arm.tau_max + torque_noise
        self._step = RESIDUAL_STEP * arm.tau_max + TWO_READINGS * torque_noise
        self._blend = blend(rate)
        self._clearance = clearance
        # how far each pair was, at which posture: it cannot be nearer now than that less reach times what was turned since
        self._seen_q = np.tile(first.q, (len(clearance.pairs), 1))
        self._seen = np.zeros(len(clearance.pairs))
        self._least = clearance.margin - GJK
        self._has_tau = np.isfinite(self._torque(first))
        self._has_temperature = np.isfinite(first.temperature)
        self._n, self._count = n, 0
        self._last, self._paused = first, False
        self._frozen, self._commanded_turn, self._q_cmd = np.zeros(n, dtype=int), np.zeros(n), first.q.copy()
        self._path_end = first.q.copy()
        self._window: list[JointState] = []
        self._speeds = np.zeros((WINDOW, n))
        self._slow: np.ndarray | None = None
        self._inside = np.ones(n, dtype=bool)
        # the last LATE s of the commanded path: where each step of it began, the step, and one over its square
        count = max(2, round(LATE * rate))
        self._from, self._steps, self._per = np.tile(first.q, (count, 1)), np.zeros((count, n)), np.zeros(count)
        self._reading = Readings(arm, rate, first, self._has_tau)
        self.worst = {"following error": np.zeros(n), "residual": np.zeros(n)}

    def check(
        self,
        state: JointState,
        now: float,
        q_cmd: np.ndarray,
        expected: Expected | None = None,
    ) -> Trip | None:
        """The first rule that `state` breaks, or None.

        now s on the host's clock; q_cmd (n,) rad the last command; expected: the torque that it should take, None while the arm stands.
        """
        if expected is not None:
            self._room = min(self._most, expected.room)
        trip = (
            self._check_device(state, now)
            or self._check_motion(state, q_cmd)
            or self._check_feedback(state, q_cmd)
            or self._check_torque(state, expected)
            or self._reading.check(state, self._torque(state), *(expected[:2] if expected else (None, None)))
            or self._check_clearance(state)
        )
        self._count += 1
        self._last, self._paused = state, False
        return trip

    def pause(self) -> None:
        """The arm stands, and nobody need have read since: the next reading may come any time after the last one."""
        self._paused, self._slow = True, None
        self._reading.pause()

    def _check_device(self, state: JointState, now: float) -> Trip | None:
        if state.status is not Status.RUNNING:
            status = f"{state.status.value}{': ' + state.detail if state.detail else ''}"
            return Trip("device status", status, Status.RUNNING.value, "", "find the cause at the device before anything else")
        if not (state.n == self._n and np.isfinite(state.q).all() and np.isfinite(state.dq).all()):
            return self._trip(
                "reading", ~np.isfinite(state.q + state.dq) if state.n == self._n else None, "not a number", "finite", ""
            )
        step = state.t_device - self._last.t_device
        if not 0 < step <= (PAUSE_MAX if self._paused else self._late):
            return Trip("device time between readings", float(step), self._late, "s",
                        "readings are stale or lost: check cable, network and load of the computer")  # fmt: skip
        age = now - state.t
        if not -self._period <= age <= self._late:
            return Trip("age of the reading", float(age), self._late, "s", "this computer is late: stop other work on it")
        if self._has_temperature.any():
            fine = (state.temperature >= TEMPERATURE_MIN) & (state.temperature <= TEMPERATURE_MAX) | ~self._has_temperature
            if not fine.all():
                return self._trip("temperature", ~fine, state.temperature, TEMPERATURE_MAX, "degC", "let the arm cool down")
        return None

    def _check_motion(self, state: JointState, q_cmd: np.ndarray) -> Trip | None:
        q, dq = state.q, state.dq
        moved = np.abs(q - self._last.q)
        allowed = self._jump * min(state.t_device - self._last.t_device, self._late) + self._grain
        if not (moved <= allowed).all():
            return self._trip(
                "jump of the position between two readings", ~(moved <= allowed), moved, allowed, "rad", "check the encoder"
            )
        inside = (self._q_lo <= q) & (q <= self._q_hi)
        if not inside.all():
            limit = np.where(q > 0, self._q_hi, self._q_lo)
            return self._trip("position", ~inside, q, limit, "rad", "move the joint back by the device's own controls")
        fast = np.abs(dq)
        if not (fast <= self._dq_hi).all():
            return self._trip("speed", ~(fast <= self._dq_hi), fast, self._dq_hi, "rad/s", "plan a slower motion")
        error = self._beside(q, q_cmd)
        np.fmax(self.worst["following error"], error, out=self.worst["following error"])
        if not (error <= self._room).all():
            return self._trip("following error", ~(error <= self._room), error, np.full(self._n, self._room), "rad",
                              "look for contact, a wrong payload or a brake; plan a slower motion if there is none")  # fmt: skip
        return None

    def _beside(self, q: np.ndarray, q_cmd: np.ndarray) -> np.ndarray:
        """(n,) rad beside the point of the path of the last LATE s from which the joint that is farthest from it is least far."""
        row = self._count % len(self._per)
        step = q_cmd - self._path_end
        square = float(step @ step)
        self._from[row], self._steps[row], self._per[row] = self._path_end, step, 1.0 / square if square > 0 else 0.0
        self._path_end = q_cmd.copy()
        since = q - self._from
        share = np.minimum(np.maximum(np.einsum("kj,kj->k", since, self._steps) * self._per, 0.0), 1.0)
        beside = np.abs(since - share[:, None] * self._steps)
        return np.asarray(beside[int(np.argmin(np.maximum.reduce(beside, axis=1)))])

    def _check_feedback(self, state: JointState, q_cmd: np.ndarray) -> Trip | None:
        stuck = (state.q == self._last.q) & (np.abs(state.dq) > self._moving)
        self._frozen = (self._frozen + 1) * stuck
        self._commanded_turn, self._q_cmd = (self._commanded_turn + np.abs(q_cmd - self._q_cmd)) * stuck, q_cmd.copy()
        if not (self._frozen < FROZEN_LEAST).all():
            turned = np.minimum(self._frozen * np.abs(state.dq) * self._period, self._commanded_turn)
            within_grain = turned <= self._grain
            fine = (self._frozen < FROZEN_LEAST) | (self._frozen < FROZEN) & within_grain
            if not fine.all():
                return self._trip("readings with the same position at speed", ~fine, self._frozen.astype(float),
                                  np.where(within_grain, float(FROZEN), float(FROZEN_LEAST)), "",
                                  "the encoder's value is frozen: check its cable")  # fmt: skip
        self._window.append(state)
        self._speeds[self._count % WINDOW] = state.dq
        if len(self._window) > WINDOW:
            old = self._window.pop(0)
            mean = np.add.reduce(self._speeds) / WINDOW
            off = np.abs((state.q - old.q) / (state.t_device - old.t_device) - mean)
            if not (off <= self._dq_doubt).all():
                return self._trip("speed against change of position", ~(off <= self._dq_doubt), off, self._dq_doubt, "rad/s",
                                  "check sign, unit and gear ratio of the encoder")  # fmt: skip
        return None

    def _check_torque(self, state: JointState, expected: Expected | None) -> Trip | None:
        if expected is None or not self._has_tau.any():
            return None
        tau_hat, doubt, sudden, _ = expected
        residual = np.where(self._has_tau, self._torque(state) - tau_hat, 0.0)
        size, band = np.abs(residual), self._residual + doubt
        np.fmax(self.worst["residual"], size / self.arm.tau_max, out=self.worst["residual"])
        if not (size <= band).all():
            return self._trip(
                "torque beside expectation", ~(size <= band), size, band, "N m", "look for contact or a wrong payload"
            )
        if self._slow is None:
            self._slow = residual.copy()
        self._slow = self._slow + self._blend * (residual - self._slow)
        change, allowed = np.abs(residual - self._slow), self._step + sudden
        inside, before = change <= allowed, self._inside
        alone = np.count_nonzero(inside) >= self._n - 1
        fine = (inside | before & alone) & (change <= SPIKE * allowed)
        self._inside = inside
        if not fine.all():
            return self._trip("sudden change of torque beside expectation", ~fine, change, allowed, "N m",
                              "look for contact or a lost payload")  # fmt: skip
        return None

    def _check_clearance(self, state: JointState) -> Trip | None:
        """Every pair in every cycle: those that may be too near since their distance was last looked at are looked at again."""
        count = len(self._seen)
        if not count:
            return None
        bound = self._seen - np.einsum("kj,kj->k", self._clearance.reach, np.abs(state.q - self._seen_q))
        ask = np.flatnonzero(~(bound >= self._least)).tolist()
        ask += [p for p in {(self._count * LOOKS + i) % count for i in range(LOOKS)} if p not in ask]
        found = self._clearance.distances(state.q, ask)
        self._seen[ask], self._seen_q[ask] = found, state.q
        spare = found - self._least[ask]
        if not (spare >= 0).all():
            k = int(np.argmin(spare))
            p = ask[k]
            return Trip(f"clearance of {' and '.join(self._clearance.pairs[p])}", float(found[k]), float(self._clearance.margin[p]), "m",
                        "the arm is not where it was sent: look for a following error or a wrong model")  # fmt: skip
        return None

    def _torque(self, state: JointState) -> np.ndarray:
        """Measured torque (n,) N m; from the current where only that is reported, NaN where neither is."""
        if self.arm.torque_constant is None:
            return state.tau
        return np.where(np.isfinite(state.tau), state.tau, self.arm.torque_constant * state.current)

    def _trip(
        self, quantity: str, broken: np.ndarray | None, value: np.ndarray | str, limit: np.ndarray | float | str, unit: str,
        remedy: str = "check the driver",
    ) -> Trip:  # fmt: skip
        j = None if broken is None or not broken.any() else int(np.argmax(broken))
        at, most = (float(x[j]) if isinstance(x, np.ndarray) and j is not None else x for x in (value, limit))
        return Trip(quantity, at, most, unit, remedy, None if j is None else self.arm.joint_names[j])  # type: ignore[arg-type]
