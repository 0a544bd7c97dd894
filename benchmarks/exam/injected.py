"""Torque of the true arm along a motion recorded on a real one, so that an effect can be added to measured currents.

Joints are rigid here: the change of motion from a soft gear or a gap cannot be added afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, savgol_filter, sosfiltfilt

from benchmarks.exam.dynamics import joint_torque, place
from benchmarks.exam.plant import coupled_drag, delivered, dry_level, on_joint, pushed, reading, speed_friction
from benchmarks.exam.records import CROSS_DRAG
from benchmarks.exam.severity import BAND, RATE, Rows
from benchmarks.exam.true_arm import AMBIENT, TrueArm

STEP = 2e-3  # s
SMOOTH = 0.15  # s, window of the polynomial that differentiates the recorded angles


@dataclass(frozen=True)
class Recorded:
    """A recording of a real arm: column names, table (N, C), t (K,) s every STEP, and q dq ddq (K, 6) smoothed there."""

    columns: list[str]
    table: np.ndarray
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray

    @property
    def stamps(self) -> np.ndarray:
        """Time from the first sample, s, (N,)."""
        return self.table[:, 0] - self.table[0, 0]

    def block(self, name: str) -> slice:
        """Position of the six columns NAME_0 ... NAME_5."""
        first = self.columns.index(f"{name}_0")
        return slice(first, first + 6)


def recorded(path: Path) -> Recorded:
    """Read a table of ur_rtde's recorder."""
    with path.open(encoding="utf-8") as file:
        columns = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    first = columns.index("actual_q_0")
    stamps = table[:, 0] - table[0, 0]
    t = np.arange(0.0, stamps[-1], STEP)
    q = CubicSpline(stamps, table[:, first : first + 6])(t)
    window = int(SMOOTH / STEP) // 2 * 2 + 1
    return Recorded(columns, table, t, *(savgol_filter(q, window, 4, deriv=k, delta=STEP, axis=0) for k in range(3)))


@numba.njit(cache=True)
def needed(chain, gravity, joints, force, ambient, q, dq, ddq, dt):
    """tau (K, n) N m of rigid joints' motors along q dq ddq (K, n), sampled every dt s: the inverse of the plant's laws."""
    count, n = q.shape
    turn, inertia = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    origin, z, centre = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    h, push, out = np.empty(n), np.empty(3), np.empty((count, n))
    bristle, common, memory, heat = np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.full(n, ambient)
    for k in range(count):
        place(chain, q[k], turn, origin, z, centre, inertia)
        pushed(force, k * dt, push)
        joint_torque(gravity, push, chain[3], origin, z, centre, inertia, dq[k], ddq[k], h)
        for j in range(n):
            joint, v = joints[j], dq[k, j]
            other = dq[k, int(joint.b)] if joint.strange == CROSS_DRAG else 0.0
            load = h[j] - on_joint(joint, q[k, j], v, ddq[k, j], other, memory[j], dt)
            heat[j] += dt * (joint.heating * abs(v) / 0.5 + ambient - heat[j]) / joint.heat_time
            warmth = 1.0 - joint.warm_drop * (1.0 - np.exp(-(heat[j] - ambient) / joint.warm_rise))
            stiffness = joint.coulomb / joint.width
            most = warmth * dry_level(joint, q[k, j], v, load) / stiffness
            ease = abs(bristle[j] / most) ** (joint.bristle_power - 1.0) if joint.bristle_power != 1.0 else 1.0
            old = bristle[j]
            bristle[j] = (old + v * dt) / (1.0 + abs(v) * dt / most * ease)
            drag = stiffness * bristle[j] + joint.bristle_damping * (bristle[j] - old) / dt
            drag += warmth * (joint.viscous * v + speed_friction(joint, v))
            out[k, j] = load + joint.rotor * ddq[k, j] + drag
        for j in range(1, n):
            ratio = joints[j].couple_ratio
            if ratio != 0.0:
                drag, common[j] = coupled_drag(joints[j], dq[k, j] + ratio * dq[k, j - 1], common[j], dt)
                torque = drag + joints[j].couple_inertia * (ddq[k, j] + ratio * ddq[k, j - 1])
                out[k, j] += torque
                out[k, j - 1] += ratio * torque
    return out


def torque(arm: TrueArm, motion: Recorded) -> np.ndarray:
    """Motor torque (K, 6) N m along a recorded motion, whose angles are readings of the arm's encoders."""
    angle, speed, acceleration = motion.q, motion.dq, motion.ddq
    records = arm.joints.view(np.recarray)
    if np.any(arm.joints["encoder_offset"]) or np.any(arm.joints["wobble"]):
        # fixed-point iteration for reading(angle) = q; the reading error varies slowly with the angle
        angle = angle.copy()
        for _ in range(20):
            angle -= np.stack([reading.py_func(records[j], angle[:, j]) for j in range(6)], axis=1) - motion.q
        speed = np.gradient(angle, STEP, axis=0)
        acceleration = np.gradient(speed, STEP, axis=0)
    return needed(arm.chain, arm.gravity, arm.joints, arm.force[0], AMBIENT, angle, speed, acceleration, STEP)


def reported(arm: TrueArm, t: np.ndarray, tau: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Reading of the torque channel for motor torques (N, 6) commanded at t (N,): limit, delay, gain, offset."""
    s = arm.sensors
    records = arm.joints.view(np.recarray)
    out = np.stack([[delivered.py_func(records[j], x) for x in tau[:, j]] for j in range(6)], axis=1)
    if s.lag > 0 or s.delay > 0:
        late = t - s.delay - s.lag - s.delay_jitter * rng.uniform(-1, 1, len(t))
        out = np.stack([np.interp(late, t, x) for x in out.T], axis=1)
    out = s.gain * (1 - s.gain_fade * np.abs(out) / np.abs(tau).max(axis=0)) * out + s.offset
    wander = np.sin(np.pi * t / t[-1] * 0.8)[:, None] * s.drift
    return out + wander + s.hum * np.sin(2 * np.pi * s.hum_rate * t + s.hum_phase)[:, None]


def rows(arm: TrueArm, motion: Recorded) -> Rows:
    """The recorded motion with the arm's reported torque along it, filtered and decimated; for `severity.Balance`."""
    tau = reported(arm, motion.t, torque(arm, motion), np.random.default_rng(0))
    thin = round(1 / (RATE * STEP))
    low = butter(4, BAND, fs=1 / STEP, output="sos")
    return Rows(motion.q[::thin], motion.dq[::thin], motion.ddq[::thin], sosfiltfilt(low, tau, axis=0)[::thin])


def with_hidden(motion: Recorded, clean: TrueArm, hidden: TrueArm, constant: np.ndarray, rng: np.random.Generator) -> Recorded:
    """The recording with the torque that `hidden` needs beyond `clean` added to its currents; constant (6,) N m/A."""
    added = torque(hidden, motion) - torque(clean, motion)
    current = motion.block("actual_current")
    t = motion.stamps
    tau = motion.table[:, current] * constant + np.stack([np.interp(t, motion.t, x) for x in added.T], axis=1)
    table = motion.table.copy()
    table[:, current] = reported(hidden, t, tau, rng) / constant
    return Recorded(motion.columns, table, motion.t, motion.q, motion.dq, motion.ddq)


def write(path: Path, motion: Recorded) -> None:
    """Write the table as ur_rtde's recorder does."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(motion.columns) + "\n")
        np.savetxt(file, motion.table, fmt="%.5f", delimiter=",")
