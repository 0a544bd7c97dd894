"""An exported model at one instant: forces of the effects that no element models, and readings of its encoders and drives."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from threading import Lock

import mujoco
import numpy as np

from sim.effects import Effect, PathState, Stage, effect_named
from sim.errors import ConfigError
from sim.exported_table import EffectsTable, effects_tables
from sim.instant import instant
from sim.mjcf import TWIST
from sim.mjcf_drives import READING
from sim.mujoco_export import DRY
from sim.slip import SLIP_WIDTH

MANY = 1000  # simulations whose memory is kept at once
MODELS = 100  # models whose effects are kept: the last ones used


@dataclass(frozen=True)
class Reading:
    """Readings of encoders and drives, (n,) each in joint order; q dq behind the gear, q_motor dq_motor before it."""

    q: np.ndarray
    dq: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class _Item:
    effect: Effect
    joint: int | None
    parameters: dict[str, float]
    native: bool
    shapes: bool


class ExportedArm:
    """The effects of one exported model, with the indices of its elements."""

    _known: OrderedDict[tuple[int, bytes, bytes], dict[str, ExportedArm]] = OrderedDict()
    _keeping = Lock()  # MuJoCo may call from any thread

    @classmethod
    def all_of(cls, model: mujoco.MjModel) -> dict[str, ExportedArm]:
        """The arms of `model` that `calib export` wrote, by the prefix (or suffix) with which they were attached."""
        key = (int(model.signature), model.text_data, model.names)
        with cls._keeping:
            if key not in cls._known:
                cls._known[key] = {a + z: cls(model, table, a, z) for (a, z), table in effects_tables(model).items()}
                while len(cls._known) > MODELS:
                    cls._known.popitem(last=False)
            cls._known.move_to_end(key)
            return cls._known[key]

    def __init__(self, model: mujoco.MjModel, table: EffectsTable, before: str = "", after: str = "") -> None:
        def named(name: str) -> str:
            return f"{before}{name}{after}"

        joints, names = table.joints, [named(joint) for joint in table.joints]
        missing = [name for name in names if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) < 0]
        if missing:
            raise ConfigError(
                f"the model's table of effects names the joint {missing[0]}, which the model does not have; export the arm again"
            )
        self.n = len(names)
        self.dof = np.array([model.joint(name).dofadr[0] for name in names])
        self.qpos = np.array([model.joint(name).qposadr[0] for name in names])
        self.last = model.joint(names[-1]).id
        self.body = int(model.jnt_bodyid[self.last])
        kind = mujoco.mjtObj.mjOBJ_JOINT
        soft = [(j, mujoco.mj_name2id(model, kind, named(TWIST.format(joint=joint)))) for j, joint in enumerate(joints)]
        self.twist = [(j, int(model.jnt_qposadr[k]), int(model.jnt_dofadr[k])) for j, k in soft if k >= 0]
        for j, k in soft:
            if k >= 0 and j == self.n - 1:
                self.body = int(model.jnt_bodyid[k])
        self.dry = {
            joints.index(joint): (model.actuator(named(DRY.format(joint))).id, law) for joint, law in table.dry_friction.items()
        }
        reading = [before + READING.format(joint) for joint in joints]
        self.motors = [(j, *place) for j, name in enumerate(names) for place in _motor_sensors(model, reading[j], after, name)]
        self.driven = np.isin(np.arange(self.n), [j for j, *_ in self.motors])
        self.least_step = _least_step(model, [sensor for _, sensor, *_ in self.motors])
        self.items: dict[Stage, list[_Item]] = {stage: [] for stage in Stage}
        for row in table.effects:
            effect = effect_named(row.effect)
            joint = None if row.joint is None else joints.index(row.joint)
            if row.form != "none":
                self.items[effect.stage].append(_Item(effect, joint, row.parameters, row.form == "native", row.shapes))
        stages = (Stage.FORCE, Stage.JOINT, Stage.FRICTION, Stage.MOTOR)
        self.ours = {stage: [item for item in self.items[stage] if not item.native] for stage in stages}
        self.level = [item for item in self.items[Stage.FRICTION] if item.joint in self.dry and not item.shapes]
        self.warmed = [item for item in self.items[Stage.MOTOR] if item.joint in self.dry and item.native]
        self.needs_load = any(item.effect.needs_load for item in self.ours[Stage.MOTOR])
        self.memories: dict[int, tuple[float, dict[Hashable, np.ndarray]]] = {}
        self.acts = any(self.ours.values())

    def add_forces(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Add to data.qfrc_passive what no element models, and set the dry friction of joints whose level varies."""
        state = self._instant(data)
        if self.ours[Stage.FORCE]:
            _apply(state, self.ours[Stage.FORCE])
            data.qfrc_passive += self._at_last_link(model, data, state)
        if self.ours[Stage.JOINT]:
            _apply(state, self.ours[Stage.JOINT])
            data.qfrc_passive[self.dof] -= state.load[0]
        if self.ours[Stage.FRICTION]:
            self._rub(model, data, state)
        if self.ours[Stage.MOTOR]:
            if self.needs_load and not self.ours[Stage.FRICTION]:
                state.load[:] = self._load(model, data, state)
            state.memory = self._memory_of(data)
            state.tau[:] = 0.0
            _apply(state, self.ours[Stage.MOTOR])
            data.qfrc_passive[self.dof] -= state.tau[0]

    def _rub(self, model: mujoco.MjModel, data: mujoco.MjData, state: PathState) -> None:
        """Set dry friction from warmth and the gear load at the previous step's acceleration; correct the rest for warmth."""
        state.load[:] = self._load(model, data, state)
        _apply(state, self.level)
        for j, (actuator, law) in self.dry.items():
            level, warmth = float(state.level[0, j]), float(state.warmth[0, j])
            excess = law.lugre[1] - law.lugre[0]
            model.actuator_biasprm[actuator, 3] = warmth * max(level, 1e-9)
            model.actuator_biasprm[actuator, 4] = warmth * max(level + excess, 1e-9)
            stiffness = law.stiffness if law.stiffest is None else min(max(level + excess, 1e-9) / SLIP_WIDTH, law.stiffest)
            model.actuator_dynprm[actuator, 5] = warmth * stiffness
            # its force is limited to that of the friction: in fast motion a load-dependent level would feed back amplified
            damping, most = warmth * law.damping * stiffness / law.stiffness, max(warmth * level, 1e-9)
            model.actuator_dynprm[actuator, 6] = damping / (1 + damping * abs(float(state.dq[0, j])) / most)
        if self.warmed and np.any(state.warmth != 1.0):
            # the elements model it cold
            cold = replace(state, warmth=np.ones_like(state.warmth), tau=np.zeros_like(state.tau))
            state.tau[:] = 0.0
            for each in (state, cold):
                _apply(each, self.warmed)
            data.qfrc_passive[self.dof] -= (state.tau - cold.tau)[0]

    def _load(self, model: mujoco.MjModel, data: mujoco.MjData, state: PathState) -> np.ndarray:
        """Torque (n,) N m through each gear, at the previous step's acceleration."""
        links = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 1, links)
        state.force[:] = 0.0
        _apply(state, self.items[Stage.FORCE])
        if self.items[Stage.FORCE]:
            links -= self._at_last_link(model, data, state)
        state.load[:] = links[self.dof]
        _apply(state, self.items[Stage.JOINT])
        return state.load[0]

    def _memory_of(self, data: mujoco.MjData) -> dict[Hashable, np.ndarray]:
        """State that laws with memory keep for a simulation; cleared at time zero and when its time goes back."""
        time, memory = self.memories.get(data._address, (0.0, {}))
        if data.time < time or data.time == 0.0:
            memory = {}
        if len(self.memories) > MANY:
            self.memories.clear()
        self.memories[data._address] = (float(data.time), memory)
        return memory

    def _at_last_link(self, model: mujoco.MjModel, data: mujoco.MjData, state: PathState) -> np.ndarray:
        wrench = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, state.force[0], np.zeros(3), data.xanchor[self.last], self.body, wrench)
        return wrench

    def _instant(self, data: mujoco.MjData) -> PathState:
        """The torque path now, at the angles and speeds of the motors."""
        return instant(data.time, data.qpos[self.qpos], data.qvel[self.dof], data.qacc[self.dof])

    def reading(self, data: mujoco.MjData) -> Reading:
        """Angles as the encoders read them, torques with the sensors' gain, offset and delay; NaN torque without a motor.

        A motor's force is multiplied by its gear ratio.
        """
        q_motor, dq_motor = data.qpos[self.qpos].copy(), data.qvel[self.dof].copy()
        q, dq = q_motor.copy(), dq_motor.copy()
        for j, at, speed in self.twist:
            q[j] += data.qpos[at]
            dq[j] += data.qvel[speed]
        for item in self.items[Stage.ENCODER]:
            if item.joint is not None:
                q_motor, dq_motor = _read_angle(item, q_motor, dq_motor)
                q, dq = _read_angle(item, q, dq)
        torque = np.where(self.driven, 0.0, np.nan)
        for j, _, address, gear in self.motors:
            torque[j] += gear * data.sensordata[address]
        if self.items[Stage.SENSOR]:
            state = self._instant(data)
            state.tau = torque[None]
            _apply(state, self.items[Stage.SENSOR])
            torque = state.tau[0]
        return Reading(q, dq, q_motor, dq_motor, torque)


def _motor_sensors(model: mujoco.MjModel, reading: str, after: str, joint: str) -> Iterator[tuple[int, int, float]]:
    """(sensor, its address in sensordata, gear ratio) of each motor of a joint."""
    for k in range(model.nsensor):
        name, motor = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, k) or "", int(model.sensor_objid[k])
        ours = name.startswith(reading) and name.endswith(after)
        if ours and int(model.actuator_trnid[motor, 0]) == model.joint(joint).id:
            yield k, int(model.sensor_adr[k]), float(model.actuator_gear[motor, 0])


def _least_step(model: mujoco.MjModel, sensors: list[int]) -> float:
    """Shortest step, s, at which the sensors' history still covers their delay."""
    return max(
        (float(model.sensor_delay[k]) / (int(model.sensor_history[k, 0]) - 2) for k in sensors if model.sensor_delay[k] > 0),
        default=0.0,
    )


def _apply(state: PathState, items: list[_Item]) -> None:
    for item in items:
        item.effect.apply(state, item.joint, item.parameters)


def _read_angle(item: _Item, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and speeds (n,) as read through one encoder effect."""
    q, dq, here = q.copy(), dq.copy(), np.array([item.joint])
    dq[here] = item.effect.reading_speed(q[here], dq[here], item.parameters)
    q[here] = item.effect.reading(q[here], item.parameters)
    return q, dq
