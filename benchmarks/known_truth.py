"""Arms with known parameters, motions for them, and recordings of their sensors: by formula and on the mock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from calib.excitation.design import fitted_to_room
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.home import open_cell
from calib.excitation.room import Room
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.plant import Plant
from sim.prediction import predict
from sim.trajectory import Trajectory

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def varied(arm: Arm, seed: int, relative: float = 0.05) -> Arm:
    """The arm as a real one differs from its data sheet: masses and effect parameters vary, with small torque offsets.

    Relative std of masses, friction and reflected inertia: `relative`. Inertias scale with the mass. Torque offsets: std 0.2
    N m.
    """
    rng = np.random.default_rng(seed)
    mass = arm.tree.mass * (1 + relative * rng.standard_normal(arm.n))
    tree = replace(arm.tree, mass=mass, inertia=arm.tree.inertia * (mass / arm.tree.mass)[:, None, None])
    effects = [
        ArmEffect(e.effect, e.joint, {k: v * (1 + relative * rng.standard_normal()) for k, v in e.parameters.items()})
        for e in arm.effects
    ]
    effects += [ArmEffect("torque_offset", j, {"offset": float(0.2 * rng.standard_normal())}) for j in arm.joint_names]
    return replace(arm, tree=tree, effects=tuple(effects))


def without_offsets(arm: Arm) -> Arm:
    """The arm without torque offsets, so that every tool can model it."""
    return replace(arm, effects=tuple(e for e in arm.effects if e.effect != "torque_offset"))


def fourier_motion(arm: Arm, seed: int, seconds: float = 20.0, rate: float = 200.0) -> Trajectory:
    """A random Fourier motion within the limits of speed and acceleration. Collisions are not checked."""
    basis = Basis(6, seconds)
    motion = random_fourier(basis, HOME, np.random.default_rng(seed))
    t = np.linspace(0, seconds, 400)
    speed = np.abs(basis.matrix(t, 1) @ motion.x.T).max(axis=0)
    acceleration = np.abs(basis.matrix(t, 2) @ motion.x.T).max(axis=0)
    factor = np.minimum(0.7 * arm.dq_max / speed, 0.9 * arm.ddq_max / acceleration)
    return Fourier(basis, HOME, motion.x * factor[:, None]).sampled(rate)


def fitting_motion(arm: Arm, seed: int, seconds: float = 20.0) -> Trajectory:
    """A random Fourier motion clear of the arm itself and its mounting plane, at the arm's own rate, at most 500 Hz."""
    room, rng = Room(arm, open_cell(arm)), np.random.default_rng(seed)
    while True:
        found = fitted_to_room(room, random_fourier(Basis(6, seconds), HOME, rng))
        if found is not None:
            return found.sampled(min(arm.sensors.rate, 500.0))


def recorded(arm: Arm, motion: Trajectory, seed: int = 0, noise: float = 1.0, memory: float = 0.7) -> Log:
    """The motion as the arm's sensors report it: quantised angles, torque with AR(1) noise of coefficient `memory`."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(motion.q.shape)
    push = np.sqrt(1 - memory**2)
    coloured, _ = lfilter([push], [1.0, -memory], white, axis=0, zi=(1 - push) * white[:1])
    tau = predict(arm, motion) + noise * coloured * np.array(arm.sensors.torque_noise)
    resolution = arm.sensors.encoder_resolution
    q = np.round((motion.q + resolution * rng.uniform(-0.5, 0.5, motion.q.shape)) / resolution) * resolution
    nan = np.full(q.shape, np.nan)
    return Log(arm.joint_names, motion.t, motion.t, q, motion.dq, tau, nan, nan, motion.q, motion.dq, nan)


def recorded_on_mock(truth: Arm, drive: Arm, motion: Trajectory, seed: int = 0, timestep: float | None = None) -> Log:
    """Readings of a position-controlled mock of `truth` along the motion; its controller uses the model `drive`."""
    plant = Plant(truth, drive=drive, seed=seed, timestep=timestep)
    plant.reset(motion.q[0])
    period, nothing = float(motion.t[1] - motion.t[0]), np.zeros(truth.n)
    states = []
    for q, dq in zip(motion.q, motion.dq, strict=True):
        plant.command(q, dq, nothing)
        states.append(plant.read())
        plant.advance(period)
    q, dq, tau, current, warm = (
        np.array([getattr(s, k) for s in states]) for k in ("q", "dq", "tau", "current", "temperature")
    )
    t = np.array([s.t_device for s in states])
    return Log(truth.joint_names, t, t, q, dq, tau, current, warm, motion.q, motion.dq, np.zeros_like(q))
