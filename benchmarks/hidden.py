"""Differences of a plant from its model: an undeclared box in the way, and a lost payload."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.injection import Watched
from safety import ClearedTrajectory
from sim.arm import Arm, ArmEffect
from sim.cell import BoxObstacle, Cell, PayloadTable
from sim.effects import with_effect
from sim.joint_state import JointState
from sim.plant import Plant

BOX = 0.3
LOAD = PayloadTable(mass=6.0, com=[0.0, 0.0, 0.1])


class HiddenBox:
    """A plant with an undeclared box whose face lies across the wrist's path 60 samples after `at`.

    None if the arm touches the box before `at`.
    """

    def __init__(self) -> None:
        self._of: tuple[Arm, Cell] | None = None

    def __call__(self, arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant | None:
        if self._of is None or self._of[0] is not arm or self._of[1] is not cell:
            # rotated: MuJoCo ignores later changes to the frame of a box compiled parallel to the axes
            self._of, away = (arm, cell), _box([1.0, 2.0, -9.0], [0.1, 0.2, 0.3])
            self._probe = Plant(arm, obstacles=[*cell.table.obstacles, away])
        model, data = self._probe.model, self._probe.data
        joints, wrist = [model.joint(name).qposadr[0] for name in arm.joint_names], model.geom("shape:wrist_3_0").id
        ahead = []
        for k in (55, 65):
            data.qpos[joints] = cleared.q[min(at + k, len(cleared) - 1)]
            mujoco.mj_kinematics(model, data)
            ahead.append(data.geom_xpos[wrist].copy())
        way = ahead[1] - ahead[0]
        way /= np.linalg.norm(way)
        turned = [0.0, -float(np.arcsin(way[2])), float(np.arctan2(way[1], way[0]))]
        box = _box(((ahead[0] + ahead[1]) / 2 + way * BOX / 2).tolist(), turned)
        hidden = model.geom("obstacle:hidden").id
        model.geom_pos[hidden] = box.position
        model.geom_quat[hidden] = Rotation.from_euler("xyz", turned).as_quat(scalar_first=True)
        shapes = [k for k in range(model.ngeom) if model.geom(k).name.startswith("shape:")]
        for q in (cleared.q[0], *cleared.q[:at:10]):
            data.qpos[joints] = q
            mujoco.mj_kinematics(model, data)
            if any(mujoco.mj_geomDistance(model, data, shape, hidden, BOX, None) < 0 for shape in shapes):
                return None
        return Plant(arm, obstacles=[*cell.table.obstacles, box], seed=at)


def _box(position: list[float], rpy: list[float]) -> BoxObstacle:
    return BoxObstacle(kind="box", name="hidden", position=position, rpy=rpy, size=[BOX] * 3)


def without_box(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant:
    return Plant(arm, obstacles=cell.table.obstacles, seed=at)


def with_load(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant:
    return Plant(loaded(arm), drive=arm, obstacles=cell.table.obstacles, seed=at)


def loaded(arm: Arm) -> Arm:
    names = ("com_x", "com_y", "com_z")
    return with_effect(arm, ArmEffect("payload", None, {"mass": LOAD.mass, **dict(zip(names, LOAD.com, strict=True))}))


def load_lost(driver: Watched, state: JointState) -> JointState:
    if driver.reads == driver.at:
        model, bare = driver.plant.model, Plant(driver.arm, obstacles=[]).model
        name = driver.arm.tree.link_names[-1]
        here, there = model.body(name).id, bare.body(name).id
        for what in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
            getattr(model, what)[here] = getattr(bare, what)[there]
    return state
