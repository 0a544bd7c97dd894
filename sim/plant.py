"""A position-controlled arm in MuJoCo with every effect of the arm: native where MuJoCo has it, otherwise applied each step.

The drive knows only the nominal arm: it adds that model's torque to a PID law on its own encoder. Its loop is closed at every
simulation step, so the torque it reports belongs to the same instant as its position. Readings are quantised and noisy
according to `arm.sensors`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable

import mujoco
import numpy as np

from sim.arm import Arm
from sim.cell import BoxObstacle, MeshObstacle, PlaneObstacle
from sim.drive_loop import DriveLoop
from sim.effects import Stage
from sim.encoders import Encoders
from sim.instant import apply_all, instant
from sim.joint_state import JointState
from sim.mjcf import SOFT_STEP, STEP, twists
from sim.plant_model import along, load_gears, loaded, plant_model, twist_gears
from sim.prediction import by_stage
from sim.rigid_body import RigidBody
from sim.slip import slip_direction
from sim.torque_history import TorqueHistory
from sim.torque_path import PathState

DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
NOISE_MEMORY = 0.7  # AR(1) coefficient of the torque noise from sample to sample; real current residuals show 0.6 to 0.9
AMBIENT = 25.0
ROUNDING = 1e-6  # of a step: a period of 2 ms is two steps of 1 ms, whatever its last digit


class Plant:
    """A simulated real arm: `arm` is the truth, `drive` the nominal arm that its controller knows.

    Time advances only in `advance`. The same seed and the same calls give exactly the same result.
    """

    def __init__(
        self,
        arm: Arm,
        drive: Arm | None = None,
        seed: int = 0,
        timestep: float | None = None,
        obstacles: Iterable[BoxObstacle | PlaneObstacle | MeshObstacle] = (),
    ) -> None:
        self.drive, self._obstacles = drive or arm, tuple(obstacles)
        self.timestep = timestep or (SOFT_STEP if twists(arm) else STEP)
        self._build(arm)
        self._loop = DriveLoop(self.drive, arm.joint_names)
        self._rng = np.random.default_rng(seed)
        self.reset(np.zeros(arm.n))

    def _build(self, arm: Arm) -> None:
        self.arm = arm
        self.model, self._dof, self._motor, self._twist, self._last_body = plant_model(arm, self.timestep, self._obstacles)
        self.data = mujoco.MjData(self.model)
        self._stages = by_stage(arm.effects, arm)
        self._each_step = {
            stage: [x for x in items if x[0].mjcf(x[2].joint or "", x[2].parameters) is None]
            for stage, items in self._stages.items()
        }
        self._presliding = [j for e, j, _ in self._stages[Stage.FRICTION] if e.name == "presliding_friction" and j is not None]
        self._damping = self.model.dof_damping[self._dof].copy()
        self._limit = np.where(np.isfinite(arm.tau_max), arm.tau_max, np.inf)
        # views of MuJoCo's arrays: taking them anew at every step costs as much as the step
        self._qpos, self._qvel, self._qacc, self._ctrl = self.data.qpos, self.data.qvel, self.data.qacc, self.data.ctrl
        self._encoders = Encoders(self._stages[Stage.ENCODER], arm.sensors.encoder_resolution)
        self._level_varies = bool(self._each_step[Stage.FRICTION])
        self._every_step = self._level_varies or any(self._each_step[stage] for stage in (Stage.FORCE, Stage.MOTOR))
        self._needs_load = not self._level_varies and any(effect.needs_load for effect, _, _ in self._each_step[Stage.MOTOR])
        self._bodies = RigidBody(arm)

    def become(self, arm: Arm) -> None:
        """Replace the arm during motion, as after picking something up or as a joint wears; motion, drive and noise continue.

        ValueError if a joint would get or lose a soft gear, whose motion is unknown.
        """
        if list(twists(arm)) != list(twists(self.arm)):
            raise ValueError(f"{arm.name}: an arm in motion keeps its soft joints; build a new plant")
        before = self.data
        self._build(arm)
        self.data.qpos[:], self.data.qvel[:], self.data.time = before.qpos, before.qvel, before.time
        self.data.ctrl[:], self.data.qacc_warmstart[:] = before.ctrl, before.qacc_warmstart
        mujoco.mj_forward(self.model, self.data)

    def reset(
        self, q: np.ndarray, dq: np.ndarray | None = None, came: np.ndarray | None = None, at: float = 0.0, warming: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Place the arm at q (n,) rad, at rest or moving with dq (n,) rad/s, at time `at` s.

        came (K, n) rad: the readings that led up to q, which load dry friction, as gravity loads soft gears; without it both are unloaded.
        warming (n,): share of the way from cold to warm, held constant; without it the joints were cold at time zero.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.time = at
        self._warming = None if warming is None else warming[None]
        q = np.asarray(q, dtype=float)
        self.data.qpos[self._dof] = self._encoders.angle(q)
        if dq is not None:
            self.data.qvel[self._dof] = dq
        mujoco.mj_forward(self.model, self.data)
        self._reported = self._loop.reset(q)
        self._slip, self._noise, self._heat = np.zeros((3, self.arm.n))
        self._memory: dict[Hashable, np.ndarray] = {}
        if came is not None:
            twist_gears(self.model, self.data, self._bodies, self._dof, self._twist)
            angle = self.data.qpos[self._dof]
            path = along(self._instant(), np.concatenate([came + (angle - q), angle[None]]), self._stages, self._bodies)
            self._slip[self._presliding] = loaded(path, self._stages, self._each_step, self._presliding, self._memory)
        self._slip_angle = self.data.qpos[self._dof].copy()
        self._history = TorqueHistory(self.time, self._reported)
        self._encoder_before: tuple[float, np.ndarray] = (self.time, self.encoder())

    @property
    def stable(self) -> bool:
        """Whether every angle, speed and acceleration was finite and moderate since `reset`; otherwise MuJoCo resets itself."""
        return not any(self.data.warning[kind].number for kind in DIVERGED)

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    def command(
        self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, kp: np.ndarray | None = None, kd: np.ndarray | None = None
    ) -> None:
        """Start a control period: follow q (n,) rad with dq (n,) rad/s and extra torque tau (n,) N m.

        The drive moves smoothly to where q and dq will be at the next command, one period of the last length later, and waits
        there. With kp (N m/rad) and kd (N m s/rad) it is an impedance servo with a fixed target, whose torque is only
        kp (q - angle) + kd (dq - speed) + tau.
        """
        self._loop.command(self.time, q, dq, tau, kp, kd)
        self._control()

    def advance(self, dt: float) -> None:
        """Simulate dt seconds, in equal steps no longer than `timestep`."""
        whole = dt / self.timestep
        steps = max(1, math.ceil(whole - ROUNDING))
        step = self.model.opt.timestep = self.timestep if abs(whole - steps) <= ROUNDING else dt / steps
        if self._loop.torque_alone and not self._every_step:
            mujoco.mj_step(self.model, self.data, steps)
            steps = 0
        for _ in range(steps):
            self._apply_effects()
            mujoco.mj_step(self.model, self.data)
            # position k and the torque of step k belong together: q[k+1] - 2 q[k] + q[k-1] = h^2 ddq(tau[k])
            if not self._loop.torque_alone:
                self._control(step)
        friction = np.abs(self.data.qfrc_passive[self._dof] * self.data.qvel[self._dof])
        self._heat += dt * (friction - self._heat * 2.0) / 200.0

    def read(self, t: float | None = None) -> JointState:
        """What the drives report now; `t` is the host's clock and defaults to simulated time."""
        n, sensors = self.arm.n, self.arm.sensors
        encoder = self.encoder()
        before, last = self._encoder_before
        step = self.time - before
        true_speed = self.data.qvel[self._dof].copy()
        for j, dof in self._twist:
            true_speed[j] += self.data.qvel[dof]
        velocity = (encoder - last) / step if step > 0 else true_speed
        if step > 0:
            self._encoder_before = (self.time, encoder)
        velocity = velocity + self._rng.normal(0.0, 1.0, n) * np.array(sensors.velocity_noise)
        self._noise = NOISE_MEMORY * self._noise + np.sqrt(1 - NOISE_MEMORY**2) * self._rng.normal(0.0, 1.0, n)
        tau = self._sensed() + self._noise * np.array(sensors.torque_noise)
        constant = self.arm.torque_constant
        current = np.full(n, np.nan) if constant is None else tau / constant
        now = self.time
        return JointState(now if t is None else t, now, encoder, velocity, tau, current, AMBIENT + self._heat)

    def encoder(self) -> np.ndarray:
        """Encoder angles (n,) rad now; unlike `read` it changes no state."""
        angle = self.data.qpos[self._dof].copy()
        for j, dof in self._twist:
            angle[j] += self.data.qpos[dof]
        return self._encoders.read(angle)

    def _motor_reading(self) -> tuple[np.ndarray, np.ndarray]:
        """Angle and speed on the drive's own encoder: the motor's side of a soft joint."""
        return self._encoders.motor(self._qpos[self._dof], self._qvel[self._dof])

    def _control(self, dt: float = 0.0) -> None:
        """Run the drive's loop at this instant; its integral grows by dt s."""
        now = self.time
        angle, speed = self._motor_reading()
        torque = self._loop.torque(now, angle, speed, dt)
        torque = np.minimum(np.maximum(torque, -self._limit), self._limit)
        for effect, joint, item in self._stages[Stage.DRIVE]:
            state = self._instant(torque=torque)
            effect.apply(state, joint, item.parameters)
            torque = state.tau[0]
        self._ctrl[self._motor] = torque
        self._reported = torque
        self._history.keep(now, torque)

    def _sensed(self) -> np.ndarray:
        tau = self._reported
        for _, _, item in self._stages[Stage.CHANNEL]:
            tau = self._history.at(self.time - item.parameters["delay"])
        if not self._stages[Stage.SENSOR]:
            return tau
        state = self._instant(torque=tau)
        apply_all(state, self._stages[Stage.SENSOR])
        return state.tau[0]

    def _instant(self, torque: np.ndarray | None = None) -> PathState:
        """The torque path at this one instant, for effects that are applied each step."""
        state = instant(self.time, self._qpos[self._dof], self._qvel[self._dof], self._qacc[self._dof], torque)
        state.warming = self._warming
        return state

    def _apply_effects(self) -> None:
        if not self._every_step:
            return
        steps, state, data = self._each_step, self._instant(), self.data
        data.qfrc_applied[:] = 0.0
        if steps[Stage.FORCE]:
            apply_all(state, steps[Stage.FORCE])
            point = data.xpos[self._last_body]
            wrench = np.zeros(self.model.nv)
            mujoco.mj_applyFT(self.model, data, state.force[0], np.zeros(3), point, self._last_body, wrench)
            data.qfrc_applied += wrench
        if self._level_varies:
            load_gears(state, self._stages, self._bodies)
            apply_all(state, self._stages[Stage.FRICTION])
            level = (state.warmth * state.level)[0]
            for j in self._presliding:
                angle = np.array([self._slip_angle[j], state.q[0, j]])
                self._slip[j] = slip_direction(angle, state.width[:, j].repeat(2), self._slip[j])[1]
                data.qfrc_applied[self._dof[j]] -= level[j] * self._slip[j]
                level[j] = 0.0
            self._slip_angle = state.q[0].copy()
            self.model.dof_frictionloss[self._dof] = level
            self.model.dof_damping[self._dof] = self._damping * state.warmth[0]
        state.tau[:] = 0.0
        if self._needs_load:
            load_gears(state, self._stages, self._bodies)
        state.memory = self._memory
        apply_all(state, steps[Stage.MOTOR])
        data.qfrc_applied[self._dof] -= state.tau[0]
