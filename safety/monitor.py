"""Does the arm do what it was commanded? Checked at every reading; every rule is written so that NaN breaks it.

RULES names what is checked, in that order; `safety.rules` and `safety.lies` implement it. Values that a device does not report
(NaN in its first reading) are not required; once reported, they must continue to be reported.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from safety.collision import GJK, Clearance
from safety.cycle import cycle
from safety.lies import clear_swing
from safety.looks import nearest, to_look_at
from safety.monitor_rules import RULES, SPAN, SWING
from safety.rows import ARM, NONE, NUMBERS, ROWS, WINDOW, Of, Row
from safety.rules import take_torque
from safety.sudden import LATE, blend
from safety.trip import Trip
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState, Status

PERIODS = 3.5
PAUSE_MAX = 3600.0  # s between two motions; a longer step means that a clock jumped
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
# noise factor of a reading less a mean of readings that may have begun with a single one
TWO_READINGS = 1.5
# one reading of one joint may exceed its band by this factor: a drive's current has spikes, whereas an impact lasts and affects
# several joints
SPIKE = 2.0
# s for which the torque must be that of the arm without its declared load; the most that may then remain, as a share of that
# load; and the noise factor of a mean that began with a single reading
LOST = 0.2
LOAD_SHARE = 0.5
OF_A_MEAN = 0.25
FROZEN = 10
# a constant position counts as frozen sooner if the joint was commanded to turn by more than the grain and reports that it
# does: the reading is too old by then. A joint that sticks at the end or reversal of a command is exempt: a speed derived from
# positions shows that late.
FROZEN_LEAST = 3
# pairs whose distance is computed in every cycle, whether or not they may be near by now
LOOKS = 2
# s by which a reported speed may lag (a drive's filter), and its largest constant error, share of dq_max
LAG = 0.02
BIAS = 0.01
# standard deviations of noise by which the expected torque must change before a constant reading counts as frozen
CHANGED = 3.0
# share of the certain swing that the torque must show
FOLLOWS = 0.25
# s: the earliest arrival of each block is used, which no delay makes earlier; a rate that is off by 0.2 % is found within 4 s
BLOCK = 1.0
# quartz clocks agree to 100 parts in a million (IEC 60679-1 classes); a busy computer seldom delays every reading of a block
DRIFT = 5e-4
JITTER = 3e-3


# plain integers: looking up an enum member takes longer than writing the number
ROOM_AT, COUNT_AT, LAST_T_AT, PAUSED_AT = (int(place) for place in (Of.ROOM, Of.COUNT, Of.LAST_T, Of.PAUSED))


class Expected(NamedTuple):
    """Expected of a motion: torque (n,) N m, half-width of its interval, and bound of a sudden change of its residual.

    room rad beside the path; load (n,) N m: part of tau_hat due to the declared payload.
    """

    tau_hat: np.ndarray
    doubt: np.ndarray
    sudden: np.ndarray
    room: float
    load: np.ndarray | float = 0.0


@cache
def compile_cycle() -> None:
    """Compile what a cycle needs, or load it from Numba's cache: seconds, once per computer. Call it before connecting."""
    row = np.ones((ROWS, 1))
    cycle(row, np.zeros(NUMBERS), np.zeros((2, 3)), np.zeros((WINDOW, 2)), np.zeros((WINDOW, 1)), np.zeros((4, 4)), np.zeros(3))
    one, asked = np.zeros((1, 1)), np.zeros(1, dtype=np.int64)
    to_look_at(row[Row.Q], np.zeros(1), one, one, np.zeros(1), 0, LOOKS, asked)
    nearest(row[Row.Q], np.zeros(1), asked, np.zeros(1), one, np.zeros(1))


class Monitor:
    """The rules of one run; call `check` after every reading, in order."""

    def __init__(
        self, arm: Arm, cell: Cell, rate: float, clearance: Clearance, first: JointState, latency: float = 0.0
    ) -> None:
        n = arm.n
        self.arm, self._n, self._most = arm, n, cell.table.motion.following_error_max
        self._row, self._number, self._out = np.zeros((ROWS, n)), np.zeros(NUMBERS), np.zeros(3)
        self._path = np.zeros((max(2, round(LATE * rate)), 2 * n + 1))
        self._path[:, :n] = first.q
        self._window, self._speeds = np.zeros((WINDOW, n + 1)), np.zeros((WINDOW, n))
        self._span = np.zeros((max(4, round(SPAN * rate)), 3 * n + 1))
        self._begin(arm, rate, first, latency)
        self._clearance = clearance
        # last distance of each pair and its posture: the distance now is at least that, less reach times the turn since then
        self._seen_q = np.tile(first.q, (len(clearance.pairs), 1))
        self._seen = np.zeros(len(clearance.pairs))
        self._least, self._reach = clearance.margin - GJK, np.ascontiguousarray(clearance.reach)
        self._asked = np.zeros(len(clearance.pairs), dtype=np.int64)
        self._found = np.zeros(len(clearance.pairs))
        # rows that change with every reading, as views: looking them up each time would take half of a cycle
        r = self._row
        self._reading = (r[Row.Q], r[Row.DQ], r[Row.TAU], r[Row.CURRENT], r[Row.TEMPERATURE])
        self._expected = (r[Row.TAU_HAT], r[Row.DOUBT], r[Row.SUDDEN], r[Row.LOAD])
        self._command, self._last = r[Row.Q_CMD], r[Row.LAST_Q]
        self._times = self._number[Of.T : Of.EXPECTED + 1]
        compile_cycle()

    def _begin(self, arm: Arm, rate: float, first: JointState, latency: float) -> None:
        r, x, period = self._row, self._number, 1.0 / rate
        noise, torque_noise = np.array(arm.sensors.velocity_noise), np.array(arm.sensors.torque_noise)
        r[Row.TAU], r[Row.CURRENT], r[Row.CONSTANT] = first.tau, first.current, np.nan
        if arm.torque_constant is not None:
            x[Of.ANY_CONSTANT], r[Row.CONSTANT] = 1.0, arm.torque_constant
            take_torque(r)
        has_tau, has_temperature = np.isfinite(r[Row.TAU]), np.isfinite(first.temperature)
        r[Row.Q_LO], r[Row.Q_HI] = arm.q_min - Q_OVER, arm.q_max + Q_OVER
        r[Row.DQ_HI] = arm.dq_max + DQ_OVER + SIGMAS * noise
        r[Row.JUMP] = 1.5 * arm.dq_max
        r[Row.DQ_DOUBT] = 0.1 * arm.dq_max + 0.04 * arm.ddq_max + SIGMAS * noise
        r[Row.MOVING] = np.maximum(0.02, 8 * noise)
        r[Row.RESIDUAL] = RESIDUAL * arm.tau_max + SIGMAS * torque_noise
        r[Row.STEP] = RESIDUAL_STEP * arm.tau_max + TWO_READINGS * (SIGMAS * torque_noise)
        r[Row.TAU_MAX], r[Row.HAS_TAU], r[Row.HAS_TEMPERATURE], r[Row.NOISE] = (
            arm.tau_max,
            has_tau,
            has_temperature,
            torque_noise,
        )
        r[Row.TURNED_ALLOWED] = (
            10 * arm.sensors.encoder_resolution + 1e-4 + SPAN * BIAS * arm.dq_max + SIGMAS * noise * SPAN / np.sqrt(len(self._span))
        )  # fmt: skip
        r[Row.LAST_Q] = r[Row.PATH_END] = r[Row.LAST_CMD] = first.q
        r[Row.INSIDE], r[Row.LAST_TAU] = 1.0, np.nan
        x[Of.PERIOD], x[Of.LATE], x[Of.PAUSE_MAX] = period, max(PERIODS * period, latency + period), PAUSE_MAX
        x[Of.GRAIN] = 10 * arm.sensors.encoder_resolution + 1e-4
        x[Of.TEMPERATURE_MIN], x[Of.TEMPERATURE_MAX] = TEMPERATURE_MIN, TEMPERATURE_MAX
        x[Of.FROZEN_LEAST], x[Of.FROZEN_MOST], x[Of.BLEND], x[Of.SPIKE] = FROZEN_LEAST, FROZEN, blend(rate), SPIKE
        x[Of.LAG], x[Of.CHANGED], x[Of.SIGMAS] = LAG, CHANGED, SIGMAS
        x[Of.SWING_ROWS], x[Of.FOLLOWS] = max(8, round(SWING * rate)), FOLLOWS
        x[Of.BLOCK], x[Of.DRIFT], x[Of.JITTER] = BLOCK, DRIFT, JITTER
        x[Of.LOST_ROWS], x[Of.LOAD_SHARE], x[Of.LOAD_NOISE] = max(4, round(LOST * rate)), LOAD_SHARE, OF_A_MEAN * SIGMAS
        x[Of.ANY_TAU] = has_tau.any()
        x[Of.ROOM], x[Of.LAST_T] = self._most, first.t_device
        x[Of.BLOCK_END], x[Of.BLOCK_LEAST] = first.t_device + BLOCK, np.inf
        clear_swing(r, x)

    @property
    def worst(self) -> dict[str, np.ndarray]:
        """The largest following error (n,) rad and torque residual (n,), as a share of tau_max, so far."""
        return {"following error": self._row[Row.WORST_ERROR], "residual": self._row[Row.WORST_RESIDUAL]}

    def check(
        self,
        state: JointState,
        now: float,
        q_cmd: np.ndarray,
        expected: Expected | None = None,
    ) -> Trip | None:
        """The first rule that `state` breaks, or None.

        now s on the host's clock; q_cmd (n,) rad: the last command; expected: torque and room there, None while the arm stands
        still.
        """
        x = self._number
        if expected is not None:
            x[ROOM_AT] = min(self._most, expected.room)
            tau_hat, doubt, sudden, load = self._expected
            tau_hat[:], doubt[:], sudden[:], load[:] = expected.tau_hat, expected.doubt, expected.sudden, expected.load
        trip = self._check_device(state)
        if trip is None:
            q, dq, tau, current, temperature = self._reading
            q[:], dq[:], tau[:], current[:], temperature[:] = state.q, state.dq, state.tau, state.current, state.temperature
            self._command[:] = q_cmd
            self._times[:] = state.t, state.t_device, now, expected is not None
            rule, joint = cycle(self._row, x, self._path, self._window, self._speeds, self._span, self._out)
            trip = self._broken(rule, joint) if joint != NONE else self._check_clearance(q)
        x[COUNT_AT] += 1
        if state.n == self._n:
            self._last[:], x[LAST_T_AT] = state.q, state.t_device
        x[PAUSED_AT] = 0.0
        return trip

    def pause(self) -> None:
        """The arm stands still and need not have been read: the next reading may come any time after the last one."""
        x = self._number
        x[Of.PAUSED], x[Of.SLOW_BEGUN], x[Of.SPAN_COUNT], x[Of.LOAD_BEGUN], x[Of.LOST] = 1.0, 0.0, 0.0, 0.0, 0.0
        self._row[Row.SAME] = 0.0
        clear_swing(self._row, x)

    def _check_device(self, state: JointState) -> Trip | None:
        if state.status is not Status.RUNNING:
            status = f"{state.status.value}{': ' + state.detail if state.detail else ''}"
            return Trip("device status", status, Status.RUNNING.value, "", "find the cause at the device before anything else")
        if state.n != self._n:
            return Trip("reading", "not a number", "finite", "", RULES[0].remedy)
        return None

    def _broken(self, rule: int, joint: int) -> Trip:
        quantity, unit, remedy = RULES[rule]
        value, limit, more = (float(number) for number in self._out)
        name = None if joint == ARM else self.arm.joint_names[joint]
        if rule == 0:
            return Trip(quantity, "not a number", "finite", unit, remedy, name)
        return Trip(quantity.format(more), value, limit, unit, remedy, name)

    def _check_clearance(self, q: np.ndarray) -> Trip | None:
        """Check every pair in every cycle; only distances that may have become too small are computed again."""
        if not len(self._seen):
            return None
        turn = int(self._number[COUNT_AT])
        near = to_look_at(q, self._seen, self._seen_q, self._reach, self._least, turn, LOOKS, self._asked)
        self._clearance.look(q, self._asked[:near].tolist(), self._found)
        k = nearest(q, self._found[:near], self._asked, self._seen, self._seen_q, self._least)
        if k >= 0:
            p = int(self._asked[k])
            return Trip(f"clearance of {' and '.join(self._clearance.pairs[p])}", float(self._found[k]), float(self._clearance.margin[p]), "m",
                        "the arm is not where it was sent: look for a following error or a wrong model")  # fmt: skip
        return None
