"""The exported MuJoCo model against `sim.plant` for every catalogue effect: 5 s under the same drive from the same start.

`python -m benchmarks.exported docs/export.md` writes the table into that page. `run` returns the rows of `python -m
benchmarks`.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import calib.mujoco
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import EFFECTS, LAWS, Effect, Stage, with_effect
from sim.joint_state import JointState
from sim.mjcf import TWIST, twists
from sim.mujoco_export import exported_model
from sim.plant import Plant

ARM, JOINT, SECONDS, PERIOD = "ur10e", "shoulder_lift_joint", 5.0, 0.002
# strong doses; the table shows their effect on motion and torque beside the model error
DOSES: dict[str, tuple[dict[str, float], ...]] = {
    "coulomb_friction": ({"coulomb": 30.0},),
    "viscous_friction": ({"viscous": 40.0},),
    "asymmetric_friction": ({"half_difference": 6.0},),
    "stribeck_friction": ({"stiction_excess": 8.0, "stribeck_velocity": 0.1},),
    "nonlinear_viscous_friction": ({"coefficient": 15.0, "exponent": 1.6}, {"coefficient": 15.0, "exponent": 0.5}),
    "load_dependent_friction": ({"coefficient": 0.15},),
    "thermal_friction": ({"relative_drop": 0.6, "time_constant": 2.0},),
    "presliding_friction": ({"stiffness": 300.0},),
    "gear_ripple": ({"amplitude": 2.0, "cycles": 200.0, "phase": 0.5},),
    "friction_law": ({"slip_3e-3": 8.0, "power_0.6": 6.0, "stribeck_0.1": 5.0, "load": 0.05},),
    "rotor_inertia": ({"inertia": 12.0},),
    "joint_elasticity": ({"stiffness": 5000.0},),
    "backlash": ({"half_gap": 0.01},),
    "torque_ripple": ({"amplitude": 10.0, "cycles": 12.0, "phase": 0.4},),
    "joint_spring": ({"stiffness": 20.0, "rest_angle": -1.0},),
    "torque_gain": ({"gain": 1.2},),
    "torque_offset": ({"offset": 10.0},),
    "torque_saturation": ({"limit": 110.0},),
    "encoder_offset": ({"offset": 0.1},),
    "encoder_eccentricity": ({"amplitude": 0.02, "cycles": 2.0, "phase": 0.3},),
    "time_delay": ({"delay": 0.01},),
    "payload": ({"mass": 6.0, "com_x": 0.0, "com_y": 0.05, "com_z": 0.1},),
    "link_inertia": ({"mass": 18.0, "com_x": -0.3, "com_y": 0.02, "com_z": 0.15},),
    "base_tilt": ({"roll": 0.1, "pitch": 0.15},),
    "tool_force": ({"force_x": 20.0, "force_y": -10.0, "force_z": 30.0},),
    "transmission_coupling": ({"ratio": 1.0, "inertia": 2.0, "viscous": 15.0, "coulomb": 10.0},),
    "external_contact": ({"start": 1.5, "duration": 2.0, "force_x": 0.0, "force_y": 40.0, "force_z": 40.0},),
}


class ExportedPlant(Plant):
    """The same drive on the exported model. Physics and readings are those of MuJoCo and `calib.mujoco`.

    No effect is applied here.
    """

    def _build(self, arm: Arm) -> None:
        super()._build(arm)
        with calib.mujoco.paused():
            self.model = mujoco.MjModel.from_xml_string(exported_model(arm).text)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)
        calib.mujoco.install()
        self._dof = np.array([self.model.joint(name).dofadr[0] for name in arm.joint_names])
        motors = [self.model.actuator_trnid[k, 0] for k in range(self.model.nu)]
        self._motor = np.array([motors.index(self.model.joint(name).id) for name in arm.joint_names])
        self._twist = [(arm.joint_index(joint), self.model.joint(TWIST.format(joint=joint)).dofadr[0]) for joint in twists(arm)]
        self._qpos, self._qvel, self._qacc, self._ctrl = self.data.qpos, self.data.qvel, self.data.qacc, self.data.ctrl
        self._each_step = {stage: [] for stage in Stage}
        # the exported model clips by forcerange, where the plant clips in its DRIVE stage
        self._stages = self._stages | {Stage.DRIVE: []}

    def _apply_effects(self) -> None:
        """Do nothing: the model contains the effects."""

    def _motor_reading(self) -> tuple[np.ndarray, np.ndarray]:
        reading = calib.mujoco.read(self.model, self.data)
        return reading.q_motor, reading.dq_motor

    def read(self, t: float | None = None) -> JointState:
        """Readings of the exported model's sensors and of `calib.mujoco.read`."""
        mujoco.mj_forward(self.model, self.data)
        reading = calib.mujoco.read(self.model, self.data)
        nan = np.full(self.arm.n, np.nan)
        return JointState(self.time, self.time, reading.q, reading.dq, reading.tau, nan, nan)


@dataclass(frozen=True)
class Run:
    """Link angles, rad, and readings of angle and torque, each (N, n)."""

    q: np.ndarray
    reading: np.ndarray
    tau: np.ndarray


def ran(plant: Plant, seconds: float = SECONDS) -> Run:
    """Run of 5 s with three harmonics per joint under control at 500 Hz, or the first `seconds` of it."""
    n = plant.arm.n
    rng, t = np.random.default_rng(4), np.arange(0, SECONDS, PERIOD)
    a, b = rng.uniform(-0.3, 0.3, (2, 3, n))
    wave = np.outer(t, 2 * np.pi / SECONDS * np.arange(1, 4))
    swing = np.sin(np.pi * t / SECONDS)[:, None] ** 2 * (np.sin(wave) @ a + np.cos(wave) @ b)
    wanted = np.array([0.2, -1.6, 1.0, -1.3, -1.2, 0.3]) + swing
    speed = np.gradient(wanted, t, axis=0)
    plant.reset(wanted[0])
    q, reading, tau = [], [], []
    for k in range(round(seconds / PERIOD)):
        plant.command(wanted[k], speed[k], np.zeros(n))
        plant.advance(PERIOD / 2)
        state = plant.read()
        angle = plant.data.qpos[plant._dof].copy()
        for j, dof in plant._twist:
            angle[j] += plant.data.qpos[dof]
        q.append(angle)
        reading.append(state.q)
        tau.append(state.tau)
        plant.advance(PERIOD / 2)
    return Run(np.array(q), np.array(reading), np.array(tau))


@dataclass(frozen=True)
class Compared:
    """RMS differences from the plant for one dose: of the exported model, and of a model without the effect.

    motion: worst joint, over its RMS excursion; torque: worst joint, over its RMS torque.
    """

    effect: Effect
    parameters: dict[str, float]
    form: str
    how: str
    motion: float
    torque: float
    motion_without: float
    torque_without: float


def compared(effect: Effect, parameters: dict[str, float], nominal: Arm) -> Compared:
    """Compare one effect at that strength, which replaces the arm's own."""
    item = ArmEffect(effect.name, JOINT if effect.scope == "joint" else None, parameters)
    truth = with_effect(nominal, item)
    rows = exported_model(truth).table["effects"]
    row = next(
        (r for r in rows if r["effect"] == effect.name and r["joint"] == item.joint), {"form": "native", "how": "bodies"}
    )
    real = ran(Plant(truth, nominal))
    model, without = (difference(real, ran(ExportedPlant(arm, nominal))) for arm in (truth, nominal))
    return Compared(effect, parameters, row["form"], row["how"], *model, *without)


def difference(real: Run, model: Run) -> tuple[float, float]:
    """RMS difference of a model from the arm, of motion and of torque: largest over the joints, relative to the joint's own.

    The first 0.05 s are left out: a delayed MuJoCo sensor reads zero until its history is full.
    """
    first = round(0.05 / PERIOD)
    real, model = (Run(r.q[first:], r.reading[first:], r.tau[first:]) for r in (real, model))
    moved = np.sqrt(np.mean((real.reading - real.reading.mean(axis=0)) ** 2, axis=0))
    motion = np.sqrt(np.mean((model.reading - real.reading) ** 2, axis=0)) / moved
    torque = np.sqrt(np.mean((model.tau - real.tau) ** 2, axis=0)) / np.sqrt(np.mean(real.tau**2, axis=0))
    return float(motion.max()), float(torque.max())


def quiet(arm: Arm) -> Arm:
    """The arm without sensor noise, so that all differences come from the model."""
    n = arm.n
    silent = {"encoder_resolution": 1e-12, "torque_noise": [0.0] * n, "velocity_noise": [0.0] * n, "rate": 1 / PERIOD}
    return replace(arm, sensors=arm.sensors.model_copy(update=silent))


def doses() -> Iterator[tuple[Effect, dict[str, float]]]:
    """Every catalogue effect at each strength tried; an effect without an entry in DOSES at its typical values."""
    for effect in (*EFFECTS, *LAWS):
        typical = {p.name: p.grid[len(p.grid) // 2] for p in effect.parameters}
        for dose in DOSES.get(effect.name, (typical,)):
            yield effect, effect.none() | dose


def page(found: list[Compared]) -> str:
    """Markdown table of docs/export.md."""
    lines = [
        "| effect | form | element | motion | torque | motion without it | torque without it |",
        "|---|---|---|---|---|---|---|",
    ]
    for c in found:
        name = f"`{c.effect.name}`" + (f", exponent {c.parameters['exponent']:g}" if "exponent" in c.parameters else "")
        shares = (f"{100 * x:.2g} %" for x in (c.motion, c.torque, c.motion_without, c.torque_without))
        lines.append(f"| {name} | {c.form} | {c.how} | {' | '.join(shares)} |")
    return "\n".join(lines) + "\n"


def run() -> list[dict[str, Any]]:
    """Rows of `python -m benchmarks`."""
    nominal = quiet(load_arm(ARM))
    found = [compared(*dose, nominal) for dose in doses()]
    worst = max(found, key=lambda c: c.motion)
    note = f"{worst.effect.name}; UR10e, 5 s under control, sim.plant as truth"
    return [{"what": "exported MuJoCo model, worst effect: RMS motion error", "value": f"{100 * worst.motion:.2g}", "unit": "%", "bar": "<= 1", "note": note}]  # fmt: skip


BEGIN, END = (
    "<!-- what follows is written by `python -m benchmarks.exported docs/export.md` -->",
    "<!-- end of what was written -->",
)


def written(text: str, table: str) -> str:
    """The page with the table inserted. ValueError if BEGIN or END is missing."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not (rest and after):
        raise ValueError(f"the page lacks the lines {BEGIN} and {END}, between which the table goes")
    return f"{before}{BEGIN}\n\n{table}\n{END}{after}"


def main(arguments: list[str]) -> None:
    """Print the table, and write it into each page given."""
    table = page([compared(*dose, quiet(load_arm(ARM))) for dose in doses()])
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    table += f"\nMuJoCo {mujoco.__version__}, {date.today()}, on commit {commit or 'unknown'}.\n"
    print(table)
    for name in arguments:
        Path(name).write_text(written(Path(name).read_text(encoding="utf-8"), table), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
