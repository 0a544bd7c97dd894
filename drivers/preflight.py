"""Preflight: checks, without motion, that the device is the one that the cell file and the arm folder describe."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from drivers.driver import Check, DeviceInfo, Driver
from drivers.remedies import of_clock, of_rate
from sim.arm import Arm, ArmEffect
from sim.cell import Cell, PayloadTable
from sim.effects import with_effect
from sim.joint_state import JointState, Status
from sim.own_values import values_of
from sim.prediction import at_rest

# A larger error of payload or mounting shifts gravity torques visibly; a larger error of rate or clock cannot be fitted.
MASS_TOLERANCE = 0.05  # kg
COM_TOLERANCE = 0.01  # m
TILT_TOLERANCE = math.radians(2.0)
RATE_TOLERANCE = 0.01
LOST_TOLERANCE = 0.01
CLOCK_TOLERANCE = 0.002
# share of tau_max: a wrong mounting or a forgotten tool exceeds it, a model within its prior does not
GRAVITY_TOLERANCE = 0.15
STANDSTILL = 0.02  # rad/s
# doubt about the published mass times lever, as a share of the gravity torque, and about the reading's zero, as a share of tau_max
GRAVITY_DOUBT, ZERO_DOUBT = 0.05, 0.01
SIGMAS = 3.0
# share of measured friction by which the two directions may differ (asymmetry, driven or driving load)
UNEVEN = 0.15


def preflight(driver: Driver, cell: Cell, seconds: float = 1.0) -> list[Check]:
    """The checks of a connected driver: those of every device, and those of its kind (`driver.checks`).

    Reads `seconds` s of samples; sends nothing.
    """
    arm, info = driver.arm, driver.info
    states = [driver.read() for _ in range(max(2, math.ceil(seconds * driver.rate)))]
    checks = [
        _identity(arm, info),
        _status(driver, states[-1]),
        _position(arm, states),
        _speed(arm, states),
        _temperature(arm, states),
        _payload(cell, info),
        _mounting(arm, info),
        _gravity(arm, cell, states),
        *_timing(driver.rate, cell, states),
        *driver.checks(),
        *(Check(f"assumed: {name}", None, sentence) for name, sentence in cell.assumed.items()),
    ]
    return lifted(checks, cell.table.assume)


def lifted(checks: list[Check], assumed: Collection[str]) -> list[Check]:
    """The checks: a failed one gets ok None if an assumption of the cell waives it; else its remedy names the one that would."""
    return [check if check.ok is not False or not check.assume else _lifted(check, check.assume in assumed) for check in checks]


def _lifted(check: Check, assumed: bool) -> Check:
    if assumed:
        return replace(
            check, ok=None, detail=f"{check.detail}; waived, because the cell file assumes {check.assume}", remedy=""
        )
    return replace(check, remedy=f'{check.remedy}; or, if you are certain, state assume = ["{check.assume}"] in the cell file')


def _identity(arm: Arm, info: DeviceInfo) -> Check:
    serial = f", serial {info.serial}" if info.serial else ""
    detail = f"{info.model}{serial}, firmware {info.firmware}; arm folder {arm.name} ({arm.sha256[:12]})"
    return Check("device", True, detail)


def _status(driver: Driver, state: JointState) -> Check:
    text = state.status.value + (f": {state.detail}" if state.detail else "")
    return Check("status", state.status in driver.ready, text, "bring the device to its running state and check again")


def _position(arm: Arm, states: list[JointState]) -> Check:
    q = np.array([s.q for s in states])
    inside = np.isfinite(q) & (arm.q_min <= q) & (q <= arm.q_max)
    if np.all(inside):
        return Check("joint limits", True, "every joint stands within the arm's limits")
    k, j = np.argwhere(~inside)[0]
    name = arm.joint_names[j]
    return Check(
        "joint limits", False, f"{name} stands at {q[k, j]:.4f} rad, outside {arm.q_min[j]:.4f} to {arm.q_max[j]:.4f} rad",
        f"move {name} back by hand or with the device's own controls, or correct its limits in arm.toml if the arm allows it",
    )  # fmt: skip


def _speed(arm: Arm, states: list[JointState]) -> Check:
    """Whether the arm stands still; motion is not a failure, because another program may be driving it."""
    dq = np.abs(np.mean([s.dq for s in states], axis=0))
    j = int(np.argmax(np.where(np.isfinite(dq), dq, np.inf)))
    stands = bool(np.all(dq <= STANDSTILL))
    return Check(
        "speed", True if stands else None,
        f"{'the arm stands still' if stands else 'the arm moves'}: {arm.joint_names[j]} is fastest at {dq[j]:.4f} rad/s",
    )  # fmt: skip


def _temperature(arm: Arm, states: list[JointState]) -> Check:
    warm = states[-1].temperature
    if not np.isfinite(warm).any():
        return Check("temperature", None, "the device reports no temperature, so nothing warns of an overheating joint")
    j = int(np.nanargmax(warm))
    return Check("temperature", True, f"{np.nanmin(warm):.0f} to {warm[j]:.0f} degC, {arm.joint_names[j]} is warmest")


def _payload(cell: Cell, info: DeviceInfo) -> Check:
    if info.payload_mass is None or info.payload_com is None:
        return Check("payload", None, "the device does not report the payload that it assumes")
    declared = cell.table.payload
    mass = declared.mass if declared else 0.0
    com = np.array(declared.com if declared else (0.0, 0.0, 0.0))
    off = float(np.linalg.norm(np.array(info.payload_com) - com))
    ok = abs(info.payload_mass - mass) <= MASS_TOLERANCE and (mass <= MASS_TOLERANCE or off <= COM_TOLERANCE)
    reported = ", ".join(f"{x:.3f}" for x in info.payload_com)
    return Check(
        "payload", ok, f"the device assumes {info.payload_mass:.3f} kg at ({reported}) m; the cell file declares {mass:.3f} kg",
        "set the payload that is actually mounted, both on the device and in [payload] of the cell file",
        "payload-as-declared",
    )  # fmt: skip


def _mounting(arm: Arm, info: DeviceInfo) -> Check:
    if info.gravity is None:
        return Check("mounting", None, "the device does not report its mounting")
    g = np.array(info.gravity)
    cosine = float(g @ arm.gravity / (np.linalg.norm(g) * np.linalg.norm(arm.gravity) or np.nan))
    tilt = math.acos(min(1.0, max(-1.0, cosine))) if math.isfinite(cosine) else math.nan
    return Check(
        "mounting", tilt <= TILT_TOLERANCE,
        f"the gravity directions of device and model differ by {math.degrees(tilt):.1f} deg",
        "set the mounting on the device, or gravity in the arm's model file, to the arm's actual orientation",
        "mounting-as-modelled",
    )  # fmt: skip


def _gravity(arm: Arm, cell: Cell, states: list[JointState]) -> Check:
    """tau at rest = g(q) - torque of springs ± friction, at most the Coulomb level; the model carries the cell file's payload."""
    name = "torque at rest"
    if states[-1].status is not Status.RUNNING:
        return Check(name, None, "the device is not following commands, so its torque does not carry the arm yet")
    dq = np.mean([s.dq for s in states], axis=0)
    if not np.all(np.abs(dq) <= STANDSTILL):
        return Check(name, None, "the arm moves, so its torque at rest cannot be compared")
    tau = np.mean([s.tau for s in states], axis=0)
    if not np.all(np.isfinite(tau)) and arm.torque_constant is not None:
        tau = arm.torque_constant * np.mean([s.current for s in states], axis=0)
    if not np.all(np.isfinite(tau)):
        return Check(name, None, "the device reports no torque, and the arm file has no torque_constant for its current")
    loaded = with_payload(arm, cell.table.payload)
    expected = at_rest(loaded, np.mean([s.q for s in states], axis=0)[None])[0]
    friction = stated_friction(arm)
    excess = np.abs(tau - expected) - friction
    share = excess / arm.tau_max
    j = int(np.argmax(np.where(np.isfinite(share), share, np.inf)))
    return Check(
        name, bool(np.all(share <= GRAVITY_TOLERANCE)),
        f"{arm.joint_names[j]} has {tau[j]:.1f} N m, the model {expected[j]:.1f} N m, friction up to {friction[j]:.1f} N m",
        "check for a tool that the cell file does not declare, a mounting other than the model's, a different order or sign of the "
        "joints, or the wrong arm folder",
        "torque-at-rest-as-reported",
    )  # fmt: skip


def gravity(driver: Driver, cell: Cell, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
    """Checks of which arm this is, from the holding torque tau (K, n) N m in poses q (K, n) rad, with friction removed.

    friction (K, n) N m is the friction that was removed.
    """
    arm, name = driver.arm, "gravity torque"
    if not (np.isfinite(tau).all() and np.isfinite(friction).all()):
        return [Check(name, None, "no torque is known, so these poses cannot show which arm this is")]
    left = UNEVEN * friction
    fit = held_by(with_payload(arm, cell.table.payload), q, tau, left)
    j, k = fit.joint, fit.pose
    own = Check(
        name, fit.miss <= 1.0,
        f"in {len(q)} poses, {arm.joint_names[j]} deviates most: {tau[k, j]:.1f} N m where the model has {fit.expected:.1f} N m, "
        f"friction of {friction[k, j]:.1f} N m removed; {fit.miss:.1f} times the tolerance",
        "check for a tool that the cell file does not declare, a mounting other than the model's, or the wrong arm folder",
        "torque-at-rest-as-reported",
    )  # fmt: skip
    return lifted([own, *driver.gravity(q, tau, left)], cell.table.assume)


@dataclass(frozen=True)
class RestMisfit:
    """Largest misfit of torque at rest, in multiples of the arm's tolerance (up to 1 it fits), with pose, joint, expected N m."""

    miss: float
    pose: int
    joint: int
    expected: float


def held_by(arm: Arm, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> RestMisfit:
    """max (|tau - tau_rest(q)| - friction - noise) / doubt over poses (K, n), springs included; friction (n,) or (K, n), any sign."""
    gravity = at_rest(arm, np.atleast_2d(q))
    noise = SIGMAS * np.array(arm.sensors.torque_noise)
    doubt = GRAVITY_DOUBT * np.abs(gravity) + ZERO_DOUBT * arm.tau_max
    miss = np.maximum(np.abs(np.atleast_2d(tau) - gravity) - friction - noise, 0.0) / doubt
    miss = np.where(np.isfinite(miss), miss, np.inf)
    k, j = (int(i) for i in np.unravel_index(int(np.argmax(miss)), miss.shape))
    return RestMisfit(float(miss[k, j]), k, j, float(gravity[k, j]))


def with_payload(arm: Arm, payload: PayloadTable | None) -> Arm:
    """The arm with the payload that the cell file declares."""
    if payload is None or payload.mass <= 0:
        return arm
    com = dict(zip(("com_x", "com_y", "com_z"), payload.com, strict=True))
    return with_effect(arm, ArmEffect("payload", None, {"mass": payload.mass, **com}))


def stated_friction(arm: Arm) -> np.ndarray:
    """Dry friction that the arm's file states, (n,) N m; zero where it states none."""
    return values_of(arm, "coulomb_friction", "coulomb")


def _timing(rate: float, cell: Cell, states: list[JointState]) -> list[Check]:
    device = np.diff([s.t_device for s in states])
    host = np.diff([s.t for s in states])
    if not np.all(device > 0):
        return [
            Check("device clock", False, "the device's time stamps do not increase", "restart the device, then check again")
        ]
    measured = 1.0 / float(np.median(device))
    missing = int(np.sum(np.rint(device * rate) - 1))
    slope = float(np.sum(host) / np.sum(device)) - 1.0
    return [
        Check(
            "rate", abs(measured / rate - 1.0) <= RATE_TOLERANCE and missing <= LOST_TOLERANCE * len(device),
            f"{measured:.1f} Hz of {rate:.1f} Hz, {missing} of {len(device) + missing} samples missing, "
            f"longest wait on this computer {1e3 * float(np.max(host)):.1f} ms",
            of_rate(cell),
        ),
        Check(
            "device clock", abs(slope) <= CLOCK_TOLERANCE + 0.01 / float(np.sum(device)),
            f"device and host clock differ by {1e6 * slope:.0f} ppm over {np.sum(device):.1f} s", of_clock(cell),
        ),
    ]  # fmt: skip
