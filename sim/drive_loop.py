"""Position loop of an emulated drive: the nominal arm's torque plus a PID law on the drive's encoder."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm
from sim.rigid_body import RigidBody

# Closed-loop bandwidth of the emulated drive: servo loops of this class reach a few hertz (UR servoJ at lookahead 0.1 s, gain 300);
# feed-forward does the rest.
BANDWIDTH = 2 * np.pi * 6.0
PUSHED = 5.0  # largest eigenvalue of M^-1 diag(M) at which gains proportional to diag(M) settle at 200 Hz and above
# postures in which it is evaluated: for a Panda without reflected inertia it is 2 in one and 79 in another, where axes 1 and 3 align
POSTURES = 200
# position error, rad, at which the gains of a pushed arm overcome the dry friction that its drive knows; and the natural frequency, rad/s,
# that bounds these gains, so that a loop closed every millisecond stays stable
GIVES_WAY = 4e-3
SWIFT = 650.0
SLOW = 0.02  # rad/s over which the friction that a pushed arm's drive expects changes sign
State = tuple[np.ndarray, np.ndarray, np.ndarray]


class DriveLoop:
    """Follows commands with a model of the arm, `known`; vectors in the order of joint_names.

    pushed: in some posture, gains proportional to each joint's own inertia would overshoot. torque_alone: the gains of the last
    command are zero, so its torque is applied as it is.
    """

    def __init__(self, known: Arm, joint_names: tuple[str, ...]) -> None:
        self._nominal = RigidBody(known)
        self._rotor, self._viscous, self._coulomb = (
            np.array([e.parameters[key] if (e := known.effect(effect, n)) else 0.0 for n in joint_names])
            for effect, key in (("rotor_inertia", "inertia"), ("viscous_friction", "viscous"), ("coulomb_friction", "coulomb"))
        )
        self.pushed = self._most_pushed(known) > PUSHED

    def reset(self, q: np.ndarray) -> np.ndarray:
        """Hold q (n,) rad; return the torque (n,) N m that the nominal arm needs for it."""
        n = len(q)
        self._target: State = (q.copy(), np.zeros(n), np.zeros(n))
        self._acceleration, self._period = np.zeros(n), 0.0
        self._command_time = -np.inf
        self._gains: tuple[np.ndarray, np.ndarray] | None = None
        self.torque_alone = False
        self._kp, self._kd = self._gain_matrices(q)
        self._integral = np.zeros(n)
        holding = self._nominal.gravity_torque(q[None])[0]
        self._line = (q, np.zeros(n), holding, q, np.zeros(n), holding)
        return holding

    def command(
        self, now: float, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, kp: np.ndarray | None, kd: np.ndarray | None
    ) -> None:
        """From `now` s on, follow q (n,) rad, dq (n,) rad/s and extra torque tau (n,) N m; kp and kd as in `Plant.command`."""
        q, dq, tau = (np.array(x, dtype=float) for x in (q, dq, tau))
        elapsed = now - self._command_time
        start = self._wanted(now) if kp is None or kd is None else None
        if elapsed > 0:  # a second command at one instant replaces the first
            self._period = elapsed if elapsed < 0.1 else 0.0
            self._acceleration = (dq - self._target[1]) / elapsed if self._period else np.zeros_like(q)
        self._target, self._command_time = (q, dq, tau), now
        self._gains = None if kp is None or kd is None else (np.asarray(kp, dtype=float), np.asarray(kd, dtype=float))
        self.torque_alone = self._gains is not None and not any(x.any() for x in self._gains)
        if start is not None:
            # no jump at a command: a reading would show it half a period late
            ddq, period = self._acceleration, self._period
            q1, dq1 = q + period * dq + 0.5 * period**2 * ddq, dq + period * ddq
            model1 = self._nominal.inverse_dynamics(q1[None], dq1[None], ddq[None])[0] + self._rotor * ddq
            self._line = (*start, q1, dq1, model1)
            if self.pushed:
                self._kp, self._kd = self._gain_matrices(q)

    def torque(self, now: float, angle: np.ndarray, speed: np.ndarray, dt: float) -> np.ndarray:
        """Torque (n,) N m for motor readings (n,) rad and rad/s; the integral grows by dt s."""
        if self._gains is not None:
            q, dq, tau = self._target
            kp, kd = self._gains
            stiff: np.ndarray = kp * (q - angle) + kd * (dq - speed) + tau
            return stiff
        q, dq, model = self._wanted(now)
        push = self._kp @ (q - angle)
        self._integral += (0.15 * BANDWIDTH * dt) * push
        if self.pushed:  # plus friction, which is large compared with the inertia
            model = model + self._coulomb * np.tanh(dq / SLOW) + self._viscous * dq
        total: np.ndarray = model + push + self._kd @ (dq - speed) + self._integral + self._target[2]
        return total

    def _wanted(self, now: float) -> State:
        """q, dq and the model's torque now on the segment of the last command; at its end if it has no length or has run out."""
        q0, dq0, model0, q1, dq1, model1 = self._line
        since = now - self._command_time
        if since >= self._period:
            return q1, dq1, model1
        share = since / self._period
        missed = q1 - q0 - 0.5 * self._period * (dq0 + dq1)
        dq = dq0 + share * (dq1 - dq0)
        return q0 + 0.5 * since * (dq0 + dq) + share * missed, dq, model0 + share * (model1 - model0)

    def _most_pushed(self, known: Arm) -> float:
        """Largest eigenvalue of M^-1 diag(M) over fixed random postures within the limits; a whole turn where none is stated."""
        n = self._nominal.n
        low, high = (
            np.where(np.isfinite(known.q_min), known.q_min, -np.pi),
            np.where(np.isfinite(known.q_max), known.q_max, np.pi),
        )
        q = np.random.default_rng(0).uniform(low, high, (POSTURES, n))
        tall, unit = np.repeat(q, n, axis=0), np.tile(np.eye(n), (POSTURES, 1))
        matrix = RigidBody(known, np.zeros(3)).inverse_dynamics(tall, np.zeros_like(tall), unit).reshape(POSTURES, n, n)
        matrix = matrix + np.diag(self._rotor)
        scale = np.sqrt(np.diagonal(matrix, axis1=1, axis2=2))
        # the eigenvalues are one over those of diag(M)^-1/2 M diag(M)^-1/2, which is symmetric
        least = float(np.linalg.eigvalsh(matrix / (scale[:, :, None] * scale[:, None, :])).min())
        return 1.0 / least if least > 0 else np.inf

    def _gain_matrices(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """kp N m/rad and kd N m s/rad at q, (n, n): proportional to each joint's inertia with the others held.

        For a pushed arm that would overshoot, because the links accelerate one another and no reflected inertia counteracts it
        (none is stated). Its gains follow the whole mass matrix, which gives every joint the same bandwidth, plus terms for
        friction, without which a light link with friction would lag.
        """
        matrix = self._nominal.mass_matrix(q) + np.diag(self._rotor)
        if not self.pushed:
            held = np.diag(np.diag(matrix))
            return BANDWIDTH**2 * held, 2 * 0.9 * BANDWIDTH * held
        least = 1.0 / np.diag(np.linalg.inv(matrix))  # inertia of each joint with the others free
        stiff = np.minimum(self._coulomb / GIVES_WAY, SWIFT**2 * least)
        damped = np.maximum(2 * 0.9 * np.sqrt(stiff * least) - self._viscous, 0.0)
        kp = BANDWIDTH**2 * matrix + BANDWIDTH * np.diag(self._viscous) + np.diag(stiff)
        return kp, 2 * 0.9 * BANDWIDTH * matrix + np.diag(damped)
