"""The real arm behind a case: a scattered nominal model, friction, drive and sensors, with what is imperfect on every arm."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from benchmarks.exam.arms import Hardware
from benchmarks.exam.dynamics import inertia_at, torque_along
from benchmarks.exam.motions import Reference
from benchmarks.exam.plant import simulate
from benchmarks.exam.records import FORCE, JOINT
from sim.tree import KinematicTree

AMBIENT = 25.0  # degC
SHORTEST = 1e-4  # s, shortest time step of the plant
Chain = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass
class Sensors:
    """Parameters from the true values to the readings; arrays (6,).

    gain; offset: N m; gain_fade: share of gain lost at the largest torque; drift: N m that the offset wanders over a log;
    delay: s of the torque channel, with delay_jitter s about it and a first-order lag of `lag` s; noise: N m with AR(1)
    coefficient `colour`; hum: N m at hum_rate Hz on one joint; lost: share of frames that never arrive; skew: of the host
    clock.
    """

    gain: np.ndarray
    gain_fade: np.ndarray
    offset: np.ndarray
    drift: np.ndarray
    noise: np.ndarray
    hum: np.ndarray
    hum_rate: float
    hum_phase: float
    colour: float
    delay: float
    delay_jitter: float
    lag: float
    lost: float
    skew: float


@dataclass
class TrueArm:
    """Everything the plant needs. The `put` functions of hidden effects change it in place."""

    name: str
    joint_names: tuple[str, ...]
    nominal: Chain
    nominal_joints: np.ndarray
    hardware: Hardware
    chain: Chain
    gravity: np.ndarray
    joints: np.ndarray
    force: np.ndarray
    sensors: Sensors
    hard: bool
    home: np.ndarray
    peak: np.ndarray  # N m, largest torque that the excitation needs at each joint

    def copy(self) -> TrueArm:
        """A deep copy."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class Run:
    """A simulated run: q dq tau (N, 6) at t (N,) s, temperature (K, 6) degC at the control instants `instants` (K,)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    instants: np.ndarray
    temperature: np.ndarray
    reference: Reference


def chain_of(tree: KinematicTree) -> Chain:
    """The arrays that `dynamics` works on."""
    parts = (tree.rotation, tree.position, tree.axis, tree.mass, tree.com, tree.inertia)
    a, b, c, d, e, f = (np.array(x, dtype=float, order="C") for x in parts)
    return a, b, c, d, e, f


def build(
    name: str,
    tree: KinematicTree,
    tau_max: np.ndarray,
    hardware: Hardware,
    home: np.ndarray,
    rng: np.random.Generator,
    hard: bool,
) -> TrueArm:
    """An arm with nothing hidden, scattered about the nominal one.

    Std: 1 % in inertial parameters, 3 % in friction, 2 % in reflected inertia; twice that if `hard`.
    """
    wide = 2.0 if hard else 1.0
    n = tree.n
    nominal = chain_of(tree)
    rotation, position, axis, mass, com, inertia = chain_of(tree)
    mass = mass * (1 + 0.01 * wide * rng.standard_normal(n))
    com = com + 0.01 * wide * rng.standard_normal((n, 3)) * np.linalg.norm(com, axis=1, keepdims=True)
    stretch = 1 + 0.01 * wide * rng.standard_normal(n)
    inertia = inertia * (mass / nominal[3] * stretch)[:, None, None]

    nominal_joints = np.zeros(n, dtype=JOINT)
    for field, values in (("coulomb", tree.frictionloss), ("viscous", tree.damping), ("rotor", tree.armature)):
        nominal_joints[field] = values
    joints = nominal_joints.copy()
    for field, share in (("coulomb", 0.03), ("viscous", 0.03), ("rotor", 0.02)):
        joints[field] *= 1 + share * wide * rng.standard_normal(n)
    joints["width"] = 1e-4 * np.exp(0.3 * rng.standard_normal(n))
    joints["bristle_power"] = 1.0
    joints["bristle_damping"] = 0.2 * np.sqrt(joints["coulomb"] / joints["width"] * joints["rotor"])
    joints["warm_drop"] = 0.03 * wide * rng.uniform(0, 1, n)
    joints["warm_rise"] = hardware.heating
    joints["heating"] = hardware.heating * rng.uniform(0.7, 1.3, n)
    joints["heat_time"] = hardware.heat_time * rng.uniform(0.7, 1.4, n)
    joints["mesh"] = 0.35 * wide * hardware.torque_noise * rng.uniform(0.3, 1.0, n)
    joints["mesh_cycles"] = rng.uniform(40, 130, n)
    joints["mesh_phase"] = rng.uniform(0, 2 * np.pi, n)
    joints["limit"] = tau_max
    moved = np.diag(inertia_at(nominal, home)) + nominal_joints["rotor"]
    loop = hardware.bandwidth * rng.uniform(0.8, 1.1)
    joints["kp"], joints["kd"], joints["ki"] = moved * loop**2, 1.6 * moved * loop, 2.0 * moved * loop**2

    louder = rng.uniform(1.0, 2.0) if hard else rng.uniform(0.85, 1.15)
    zero = np.zeros(n)
    sensors = Sensors(
        gain=np.ones(n), gain_fade=zero.copy(), offset=zero.copy(), drift=zero.copy(), noise=louder * hardware.torque_noise,
        hum=zero.copy(), hum_rate=5.0, hum_phase=0.0, colour=float(rng.uniform(0.6, 0.9)), delay=float(rng.uniform(-0.0016, -0.0003)),
        delay_jitter=0.0, lag=0.0, lost=float(rng.uniform(0.005, 0.02)) if hard else 0.0,
        skew=float(rng.uniform(-1e-4, 1e-4)) if hard else float(rng.uniform(-2e-6, 2e-6)),
    )  # fmt: skip
    force = np.zeros(1, dtype=FORCE)
    force["duration"] = 1.0
    chain = (rotation, position, axis, mass, com, inertia)
    return TrueArm(
        name, tree.joint_names, nominal, nominal_joints, hardware, chain, tree.gravity.copy(), joints, force, sensors, hard, home,
        tau_max.copy(),
    )  # fmt: skip


def feed_forward(arm: TrueArm, reference: Reference) -> np.ndarray:
    """tau (K, 6) that the drive feeds forward: the nominal arm along the reference, with gravity as in the model."""
    own = arm.nominal_joints
    tau = torque_along(arm.nominal, np.array([0.0, 0.0, -9.81]), reference.q, reference.dq, reference.ddq)
    return tau + own["rotor"] * reference.ddq + own["viscous"] * reference.dq + own["coulomb"] * np.tanh(reference.dq / 0.02)


def run(arm: TrueArm, reference: Reference, settle: float, warm: np.ndarray, dt: float = 5e-4) -> Run:
    """Let the arm follow a reference; `warm` (6,) degC is the initial temperature of its joints.

    If the integration diverges because a gear is too stiff for steps of dt s, the steps are halved.
    """
    hold = round(reference.period / dt)
    q, dq, tau, temperature = simulate(
        arm.chain, arm.gravity, arm.joints, arm.force[0], AMBIENT, warm, reference.q, reference.dq, feed_forward(arm, reference),
        hold, dt, settle,
    )  # fmt: skip
    if not np.isfinite(q).all():
        if dt < SHORTEST:
            raise ArithmeticError(f"{arm.name}: the plant's integration diverged; a gear is too stiff for steps of {dt} s")
        return run(arm, reference, settle, warm, dt / 2)
    return Run(
        np.arange(len(q)) * dt - settle,
        q,
        dq,
        tau,
        np.arange(len(reference.q)) * reference.period - settle,
        temperature,
        reference,
    )
