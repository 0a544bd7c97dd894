"""The promises of an arm folder: it loads, its bodies are physically consistent, two libraries agree on its dynamics, and motions fit it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco
import numpy as np

from calib.testing.promise import Promise, Promises
from sim.arm import Arm, load_arm
from sim.arm_folder import write_arm
from sim.arm_table import LimitsTable
from sim.model import compiled
from sim.rigid_body import RigidBody

AGREE = 1e-9


def check_arm(reference: str | Path, plan: bool = True) -> tuple[Promise, ...]:
    """Check every promise of an arm, given by name, folder or an entry point's name. Without `plan` no motion is designed."""
    out, loaded = Promises(), []
    out.keep("it loads", lambda: loaded.append(load_arm(reference)))
    if not loaded:
        return tuple(out.found)
    arm = loaded[0]
    out.keep("every limit is stated, or named as missing", lambda: _limits(arm))
    out.keep("every number has a source", lambda: bool(arm.provenance) or "[provenance] is empty")
    out.keep("every link is a physically consistent body", lambda: _bodies(arm))
    out.keep("MuJoCo and Pinocchio agree on its torques", lambda: _agree(arm))
    out.keep("it is the same after it is written and read back", lambda: _written(arm))
    if np.isfinite(arm.tau_max).all():
        out.keep("its motors can hold it", lambda: _holds(arm))
    if plan:
        out.keep("one posture is free of self-collision, and a motion around it fits the limits", lambda: _planned(arm))
    return tuple(out.found)


def _limits(arm: Arm) -> str:
    for key in LimitsTable.model_fields:
        if not np.isfinite(getattr(arm, key)).all() and key not in arm.incomplete:
            return f"{key} has gaps and is not named in incomplete"
    low, high = np.nan_to_num(arm.q_min, nan=-np.inf), np.nan_to_num(arm.q_max, nan=np.inf)
    return "" if np.all(low < high) else "q_min is not below q_max"


def _bodies(arm: Arm) -> str:
    for name, mass, inertia in zip(arm.tree.link_names, arm.tree.mass, arm.tree.inertia, strict=True):
        small, middle, large = np.linalg.eigvalsh(inertia)
        if not (mass > 0 and small >= -1e-12 and large <= (small + middle) * (1 + 1e-6) + 1e-12):
            return f"{name}: mass {mass:.4g} kg, principal moments {small:.4g} {middle:.4g} {large:.4g} kg m^2"
    return ""


def _agree(arm: Arm) -> str:
    """Compare MuJoCo's inverse dynamics of the arm's model file, with rigid bodies only, with Pinocchio's of the tree."""
    model = compiled(arm.model_text, arm.model_path.parent, str(arm.model_path))
    if model.nv != arm.n:
        return f"the model has {model.nv} degrees of freedom, the arm {arm.n} joints"
    for key in ("dof_damping", "dof_frictionloss", "dof_armature", "jnt_stiffness", "tendon_damping", "tendon_armature"):
        getattr(model, key)[:] = 0
    model.dof_dampingpoly[:] = 0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_SPRING)
    data, body, rng = mujoco.MjData(model), RigidBody(arm), np.random.default_rng(0)
    worst = 0.0
    for q, dq, ddq in rng.normal(size=(20, 3, arm.n)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        own = body.inverse_dynamics(q[None], dq[None], ddq[None])[0]
        worst = max(worst, float(np.abs(data.qfrc_inverse - own).max() / max(1.0, np.abs(own).max())))
    return "" if worst <= AGREE else f"they differ by {worst:.3g} of the torque"


def _written(arm: Arm) -> str:
    with tempfile.TemporaryDirectory() as folder:
        read = write_arm(Path(folder) / "arm", arm)
    for key in ("mass", "com", "inertia", "rotation", "position", "axis"):
        if not np.allclose(getattr(read.tree, key), getattr(arm.tree, key), rtol=1e-9, atol=1e-12):
            return f"{key} differs"
    return "" if read.effects == arm.effects and read.prior == arm.prior else "effects or prior differ"


def _holds(arm: Arm) -> str:
    low, high = np.nan_to_num(arm.q_min, nan=-np.pi), np.nan_to_num(arm.q_max, nan=np.pi)
    q = np.random.default_rng(1).uniform(low, high, (300, arm.n))
    share = np.median(np.abs(RigidBody(arm).gravity_torque(q)), axis=0) / arm.tau_max
    j = int(np.argmax(share))
    return (
        ""
        if share[j] < 1
        else f"{arm.joint_names[j]} needs {share[j]:.0%} of its tau_max to stand still in half of all postures"
    )


def _planned(arm: Arm) -> str:
    from calib.excitation.design import fitted_to_room
    from calib.excitation.fourier import Basis, random_fourier
    from calib.excitation.home import home_of, open_cell
    from calib.excitation.room import Room

    cell = open_cell(arm)
    room, rng = Room(arm, cell), np.random.default_rng(0)
    home = home_of(room, cell, None, rng)
    found = next((m for _ in range(20) if (m := fitted_to_room(room, random_fourier(Basis(4, 20.0), home, rng)))), None)
    return "" if found is not None else f"no motion fits about {np.round(home, 3).tolist()}"
