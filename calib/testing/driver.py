"""The promises of a driver (drivers.driver.Driver). Use an emulated device: some commands are beyond the arm's range."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from calib.testing.promise import Promise, Promises
from drivers.driver import Check, DeviceInfo, DeviceStop, Driver
from sim.arm import Arm
from sim.errors import CalibError, ConfigError, DeviceError
from sim.joint_state import JointState

SAMPLES = 50
QUANTUM = 2e-3
REFUSALS = (DeviceError, ConfigError)


def check_driver(
    make: Callable[[], Driver],
    arm: Arm,
    standing: np.ndarray | None = None,
    position: Callable[[Driver], np.ndarray] | None = None,
) -> tuple[Promise, ...]:
    """Check every promise of a driver, each on a device newly opened by `make`; none may move by more than 2e-3 rad without a command.

    standing (n,) rad: position of the device before it is connected. position(driver): its true position, if the emulator provides it.
    Without either, a motion during `connect` is only seen if it continues afterwards.
    """
    out, n = Promises(), arm.n
    still, zero = np.zeros(n), np.zeros(n)

    def session(use: Callable[[Driver], object]) -> Callable[[], object]:
        def run() -> object:
            driver = make()
            try:
                driver.info = driver.connect()
                return use(driver)
            finally:
                # faults of close itself are a promise of their own
                with suppress(Exception):
                    driver.close()

        return run

    out.keep("the driver is a Driver of this arm", lambda: _is_driver(make(), arm))
    out.refuse("before connect, read is refused", lambda: make().read(), *REFUSALS)
    out.refuse("before connect, send is refused", lambda: make().send(still, zero, zero), *REFUSALS)
    out.keep("before connect, stop and close are harmless", lambda: _harmless(make()))
    out.keep("connect reports what the device is", session(lambda d: _info(d.info, d)))
    out.keep("connect moves nothing", session(lambda d: _unmoved(d, standing, position)))
    out.keep("a reading has one number for each joint, and angles are finite", session(lambda d: _shape(d.read(), n)))
    out.keep("readings are new: both clocks advance, and no reading repeats", session(_new))
    out.keep("readings come at the stated rate", session(_rate))
    for what, q in {
        "NaN": np.full(n, np.nan), "infinity": np.full(n, np.inf), "one number too many": np.zeros(n + 1),
        "one NaN among good numbers": np.r_[np.zeros(n - 1), np.nan],
    }.items():  # fmt: skip
        out.refuse(f"a command of {what} is refused", session(partial(_send, q=q)), *REFUSALS)
    for what, dq, tau in (("speed", np.full(n, np.nan), zero), ("torque", zero, np.full(n, np.nan))):
        out.refuse(
            f"a command whose {what} is NaN is refused",
            session(partial(_spoilt, dq=dq, tau=tau)),
            *REFUSALS,
        )
    out.keep("send returns what was sent", session(lambda d: _echo(d, d.read().q)))
    out.keep("send never clamps", session(lambda d: _no_clamp(d, arm)))
    out.keep("send does not change the arrays it is given", session(_untouched))
    out.keep("stop may be called at any time, and repeatedly", session(_stopped_twice))
    out.keep("close ends without an error, also when repeated", lambda: _closed_twice(make()))
    out.refuse("after close, send is refused", lambda: _after_close(make(), n), *REFUSALS)
    out.keep("with `with`, the device is released after an error", lambda: _released(make()))
    out.keep("a closed device can be connected again", lambda: _again(make()))
    out.keep("checks are Checks with a detail, and a remedy where they fail", session(_checks))
    return tuple(out.found)


def _is_driver(driver: Driver, arm: Arm) -> str:
    if not isinstance(driver, Driver):
        return f"{type(driver).__name__} is not a subclass of drivers.driver.Driver"
    if driver.arm.joint_names != arm.joint_names:
        return f"driver.arm has joints {driver.arm.joint_names}, the arm {arm.joint_names}"
    if not isinstance(driver.device_stop, DeviceStop):
        return f"device_stop is {driver.device_stop!r}, not a DeviceStop"
    return "" if np.isfinite(driver.rate) and driver.rate > 0 else f"rate is {driver.rate!r} Hz"


def _harmless(driver: Driver) -> None:
    driver.stop()
    driver.close()


def _info(info: DeviceInfo, driver: Driver) -> str:
    if not isinstance(info, DeviceInfo):
        return f"connect returned {info!r}, not a DeviceInfo"
    if not (info.model and info.serial and info.firmware):
        return f"model {info.model!r}, serial {info.serial!r}, firmware {info.firmware!r}: none may be empty"
    return (
        "" if abs(info.rate - driver.rate) < 0.05 * driver.rate else f"it states {info.rate} Hz, driver.rate is {driver.rate}"
    )


def _unmoved(driver: Driver, standing: np.ndarray | None, position: Callable[[Driver], np.ndarray] | None) -> str:
    look = position or (lambda d: d.read().q)
    first = np.array(look(driver), dtype=float)
    if standing is not None and not np.all(np.abs(first - standing) < QUANTUM):
        return f"it was at {np.round(standing, 4).tolist()} rad and is at {np.round(first, 4).tolist()} after connect"
    for _ in range(SAMPLES):
        driver.read()
    moved = np.abs(np.array(look(driver)) - first).max()
    return "" if moved < QUANTUM else f"it moved by {moved:.3g} rad without a command"


def _shape(state: JointState, n: int) -> str:
    if not isinstance(state, JointState) or state.n != n:
        return f"read returned {state!r}"
    return "" if np.isfinite(state.q).all() else f"q is {state.q.tolist()}: a device must report its angles"


def _new(driver: Driver) -> str:
    states = [driver.read() for _ in range(SAMPLES)]
    for name in ("t", "t_device"):
        steps = np.diff([getattr(s, name) for s in states])
        if not np.all(steps > 0):
            return f"{name} does not advance: smallest step {np.min(steps):.3g} s in {SAMPLES} readings"
    return ""


def _rate(driver: Driver) -> str:
    t = [driver.read().t_device for _ in range(SAMPLES)]
    found = (SAMPLES - 1) / (t[-1] - t[0]) if t[-1] > t[0] else 0.0
    return "" if 0.8 < found / driver.rate < 1.25 else f"{found:.4g} Hz by the device's clock; {driver.rate:g} Hz is stated"


def _send(driver: Driver, q: np.ndarray) -> np.ndarray:
    zero = np.zeros(len(q))
    driver.read()
    driver.engage()
    return driver.send(q, zero, zero)


def _spoilt(driver: Driver, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    q = driver.read().q
    driver.engage()
    return driver.send(q, dq, tau)


def _echo(driver: Driver, q: np.ndarray) -> str:
    driver.engage()
    sent = np.asarray(driver.send(q, np.zeros(len(q)), np.zeros(len(q))))
    ok = sent.shape == q.shape and np.all(np.abs(sent - q) < QUANTUM)
    return "" if ok else f"commanded {np.round(q, 4).tolist()}, it reports that it sent {sent!r}"


def _no_clamp(driver: Driver, arm: Arm) -> str:
    q = np.where(np.isfinite(arm.q_max), arm.q_max, 3.0) + 1.0
    driver.read()
    driver.engage()
    try:
        sent = np.asarray(driver.send(q, np.zeros(arm.n), np.zeros(arm.n)))
    except CalibError:
        return ""
    return (
        ""
        if np.all(np.abs(sent - q) < QUANTUM)
        else f"commanded {q[0]:.4g} rad, beyond its range, it sent {sent[0]:.4g} without an error"
    )


def _untouched(driver: Driver) -> str:
    q = np.array(driver.read().q)
    given = (q.copy(), np.zeros(len(q)), np.zeros(len(q)))
    driver.engage()
    driver.send(*given)
    return "" if np.array_equal(given[0], q) and not np.any(given[1]) and not np.any(given[2]) else "it changed its arguments"


def _stopped_twice(driver: Driver) -> None:
    driver.stop()
    driver.stop()


def _closed_twice(driver: Driver) -> None:
    driver.connect()
    driver.read()
    driver.close()
    driver.close()


def _after_close(driver: Driver, n: int) -> object:
    driver.connect()
    q = np.array(driver.read().q)
    with suppress(Exception):
        driver.close()
    return driver.send(q, np.zeros(n), np.zeros(n))


def _released(driver: Driver) -> str:
    closed: list[bool] = []
    close = driver.close

    def noted() -> None:
        closed.append(True)
        close()

    driver.close = noted  # type: ignore[method-assign]
    try:
        with driver:
            raise DeviceError("an error in the middle of a motion, made by calib.testing")
    except DeviceError as error:
        if "made by calib.testing" not in str(error):
            return f"the error was replaced by {error}"
    return "" if closed else "close was not called"


def _again(driver: Driver) -> None:
    for _ in range(2):
        driver.connect()
        driver.read()
        driver.close()


def _checks(driver: Driver) -> str:
    for check in driver.checks():
        if not isinstance(check, Check) or not (check.name and check.detail):
            return f"{check!r} says nothing"
        if check.ok is False and not check.remedy:
            return f"{check.name}: no remedy"
    return ""
