"""The only way to a `ClearedTrajectory`: every check of this package on one motion, and the samples that will be sent."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.driver import DeviceStop
from safety.collision import Clearance, Witness
from safety.hashes import Hashes, hashes_of
from safety.limits import check_limits, check_sent, sampled
from safety.monitor import compile_cycle
from safety.reach import fastest_point
from safety.sudden import sudden_change
from safety.torque import Torque, check_torque, suffices, torque_interval
from safety.tube import tube_of
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

_SEAL = object()


@dataclass(frozen=True)
class Proof:
    """What was verified: the largest share of each limit that is used (1 is the limit) and the longest stop.

    near: the nearest approach to "the cell" and to "itself", if there is any; room rad: the least following error that is
    covered; braking, device_braking: the share of the arm's ddq_max, and of the device's own deceleration, that the torque
    suffices for in a stop.
    """

    used: dict[str, float]
    near: dict[str, Witness]
    stop_time: float
    stop_angle: float
    room: float
    braking: float
    device_braking: float


class ClearedTrajectory:
    """A motion that passed every check, as the samples that will be sent at `rate` Hz; only `clear` makes one.

    t (N,) s from 0; q dq ddq (N, n); tau_hat (N, n) N m: expected torque; doubt (N, n) N m: half-width of its interval; sudden
    (N, n) N m: bound of a sudden change of its residual; load (N, n) N m: part of tau_hat due to the declared payload; room
    (N,) rad: following error that is covered; braking (n,) rad/s^2: of our stop. All are read-only.
    """

    __slots__ = ("__weakref__", "_values")

    if TYPE_CHECKING:
        t: np.ndarray
        q: np.ndarray
        dq: np.ndarray
        ddq: np.ndarray
        tau_hat: np.ndarray
        doubt: np.ndarray
        sudden: np.ndarray
        load: np.ndarray
        room: np.ndarray
        braking: np.ndarray
        rate: float
        arm_sha256: str
        joint_names: tuple[str, ...]
        hashes: Hashes
        verdict: Proof
        stop: DeviceStop
        latency: float
        suffices: Callable[[Trajectory], bool]
    else:

        def __getattr__(self, name: str) -> Any:
            try:
                return object.__getattribute__(self, "_values")[name]
            except KeyError:
                raise AttributeError(name) from None

    def __init__(self, seal: object, values: dict[str, Any]) -> None:
        if seal is not _SEAL:
            raise TypeError("only safety.clear() makes a ClearedTrajectory: clear the motion")
        object.__setattr__(self, "_values", values)
        _CLEARED.add(self)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name}: a ClearedTrajectory cannot be changed; clear the new motion")

    def __reduce__(self) -> Any:
        raise TypeError("a ClearedTrajectory cannot be copied or sent to another process; clear the motion there")

    def __len__(self) -> int:
        return len(self.t)


_CLEARED: weakref.WeakSet[ClearedTrajectory] = weakref.WeakSet()


def require_cleared(motion: object, arm: Arm, rate: float) -> ClearedTrajectory:
    """`motion` itself if `clear` made it for this arm and this rate; SafetyStop for anything else."""
    if not (isinstance(motion, ClearedTrajectory) and motion in _CLEARED):
        raise SafetyStop(f"{type(motion).__name__} was not made by safety.clear(); nothing else is ever sent to an arm")
    if motion.arm_sha256 != arm.sha256 or motion.joint_names != arm.joint_names:
        raise SafetyStop(f"the motion was cleared for another arm, not {arm.name} ({arm.sha256[:12]}); clear it for this one")
    if motion.rate != rate:
        raise SafetyStop(
            f"the motion was cleared for {motion.rate:g} Hz, the driver runs at {rate:g} Hz; clear it for this rate"
        )
    return motion


def clear(
    trajectory: Trajectory,
    arm: Arm,
    cell: Cell,
    rate: float | None = None,
    stop: DeviceStop | None = None,
    latency: float = 0.0,
    clearance: Clearance | None = None,
) -> ClearedTrajectory:
    """Verify a motion, both its stops and a tube around them: limits, torque, power, point speed, clearance; or SafetyStop.

    rate Hz: of the samples that will be sent, by default the arm's own. stop: how the device brakes. latency s: the worst of
    this computer. clearance: saves building the geometry again. Non-zero speed at an end is allowed here: motions that are
    joined are cleared as one.
    """
    if not isinstance(trajectory, Trajectory):
        raise SafetyStop(f"{type(trajectory).__name__} is not a Trajectory; only a Trajectory can be cleared")
    rate = arm.sensors.rate if rate is None else rate
    if not (isinstance(rate, float | int) and np.isfinite(rate) and 10 <= rate <= 2000):
        raise SafetyStop(f"rate {rate!r} Hz: a control rate is a number from 10 to 2000")
    stop = DeviceStop() if stop is None else stop
    if not isinstance(stop, DeviceStop):
        raise SafetyStop(f"{stop!r} is not a DeviceStop; state how the device brakes")
    compile_cycle()  # not later, when an arm is connected
    clearance = clearance or Clearance(arm, cell)
    used = check_limits(trajectory, arm)
    sent = _samples(trajectory, float(rate))
    check_sent(sent, arm)
    used["point speed"] = fastest_point(sent, clearance.arm) / cell.table.motion.point_speed_max
    torque = torque_interval(sent, arm, cell)
    used |= check_torque(sent, torque, arm)
    tube = tube_of(sent, arm, cell, clearance, stop, latency)
    braking = float((tube.braking / arm.ddq_max).min())
    near = clearance.nearest_on(sent.t, sent.q)
    verdict = Proof(used, near, tube.stop_time, tube.stop_angle, float(tube.room.min()), braking, tube.device_share)
    values: dict[str, Any] = {name: _frozen(getattr(sent, name)) for name in ("t", "q", "dq", "ddq")}
    values |= {"tau_hat": _frozen(torque.tau_hat), "doubt": _frozen(torque.doubt)}
    values |= {"room": _frozen(tube.monitored(float(rate))), "braking": _frozen(tube.braking)}
    values["sudden"], values["load"] = _frozen(sudden_change(sent, arm, cell)), _load(sent, torque, arm, cell)
    values |= {
        "rate": float(rate), "arm_sha256": arm.sha256, "joint_names": arm.joint_names, "hashes": hashes_of(arm, cell),
        "verdict": verdict, "stop": stop, "latency": latency, "suffices": partial(suffices, arm=arm, cell=cell),
    }  # fmt: skip
    return ClearedTrajectory(_SEAL, values)


def _load(motion: Trajectory, torque: Torque, arm: Arm, cell: Cell) -> np.ndarray:
    """Part of tau_hat (N, n) N m that is due to the declared payload; zeros if none is declared."""
    if cell.table.payload is None:
        return np.broadcast_to(np.zeros(arm.n), torque.tau_hat.shape)
    bare = replace(cell, table=cell.table.model_copy(update={"payload": None}))
    return _frozen(torque.tau_hat - torque_interval(motion, arm, bare).tau_hat)


def _samples(motion: Trajectory, rate: float) -> Trajectory:
    """The motion at k / rate s, including its last sample; the last instant may be up to a period after the motion's end."""
    t = motion.t - motion.t[0]
    based = Trajectory(t, motion.q, motion.dq, motion.ddq)
    count = max(int(np.ceil(t[-1] * rate * (1 - 1e-12))), 1)
    grid = np.arange(count + 1) / rate
    inside = sampled(based, np.minimum(grid, t[-1]))
    return inside if grid[-1] <= t[-1] else Trajectory(grid, inside.q, inside.dq, inside.ddq)


def _frozen(array: np.ndarray) -> np.ndarray:
    """A copy backed by bytes, which no flag makes writable again."""
    return np.frombuffer(np.ascontiguousarray(array).tobytes(), dtype=array.dtype).reshape(array.shape)
