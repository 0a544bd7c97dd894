"""The peers' estimates on one log, each in its own process."""

from __future__ import annotations

import json
import os
import resource
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import ONE_THREAD
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.effects import with_effect
from sim.mjcf import plant_text
from sim.prediction import predict
from sim.trajectory import Trajectory
from sim.urdf import urdf_text

HERE = Path(__file__).resolve().parent
PYTHON = Path(os.environ.get("ARM_CALIB_PEERS", HERE.parent.parent / ".venv-peers" / "bin" / "python"))
ONE_STEP = 0.002
KINDS = {"viscous": "viscous_friction", "coulomb": "coulomb_friction", "rotor": "rotor_inertia"}
SYMBOL = {"viscous": "viscous", "coulomb": "coulomb", "rotor": "inertia"}


def peers_on(
    folder: Path, nominal: Arm, log: Log, m: Measurement, new: list[Trajectory], out: dict[str, Any], first: bool
) -> dict[str, list[np.ndarray]]:
    """Predictions of figaroh and mujoco.sysid on the new motions; their times go into `out`."""
    (folder / "model.urdf").write_text(urdf_text(nominal))
    (folder / "model.xml").write_text(plant_text(nominal, ONE_STEP))
    (folder / "joints.json").write_text(
        json.dumps(
            {
                "joints": list(nominal.joint_names),
                "bodies": list(nominal.tree.link_names),
                "friction": friction_by_name(nominal),
            }
        )
    )
    tr, inside = m.trajectory, m.inside
    unseen = {f"new_{x}_{k}": getattr(motion, x) for k, motion in enumerate(new) for x in ("q", "dq", "ddq")}
    np.savez(
        folder / "data.npz", **(random_states(nominal) if first else {}), **unseen, motions=len(new), q=tr.q[inside], dq=tr.dq[inside],
        ddq=tr.ddq[inside], tau=m.tau[inside], taps=m.decimator.taps, step=m.decimator.step,
    )  # fmt: skip
    predictions = {}
    began = _children()
    if _peer("figaroh_peer.py", folder):
        if first:
            out["figaroh"] = json.loads((folder / "figaroh.json").read_text())
        else:
            out["seconds"]["figaroh"] = _children() - began
        for tool, file in (("figaroh, base parameters", "figaroh"), ("figaroh, effort fit with prior", "figaroh_fit")):
            predictions[tool] = [np.load(folder / f"{file}_{k}.npy") for k in range(len(new))]
    smooth = [np.stack([np.interp(log.t, tr.t, x[:, j]) for j in range(nominal.n)], axis=1) for x in (tr.q, tr.dq)]
    np.savez(folder / "data.npz", t=log.t, q=log.q, dq=log.dq, tau=log.tau, smooth_q=smooth[0], smooth_dq=smooth[1])
    if _peer("mujoco_sysid_peer.py", folder):
        peer = json.loads((folder / "mujoco_sysid.json").read_text())
        out["seconds"]["mujoco.sysid"] = peer["seconds"]
        predictions["mujoco.sysid"] = [_predicted(nominal, peer["values"], motion) for motion in new]
    return predictions


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def random_states(arm: Arm) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {f"random_{k}": rng.uniform(-2, 2, (10_000, arm.n)) for k in ("q", "dq", "ddq", "tau")}


def _predicted(nominal: Arm, values: dict[str, float], motion: Trajectory) -> np.ndarray:
    arm = nominal
    mass = np.array([values[f"mass {j}"] for j in nominal.joint_names])
    for j in nominal.joint_names:
        for kind, effect in KINDS.items():
            old = nominal.effect(effect, j)
            assert old is not None
            arm = with_effect(arm, replace(old, parameters={**old.parameters, SYMBOL[kind]: values[f"{kind} {j}"]}))
    inertia = arm.tree.inertia * (mass / arm.tree.mass)[:, None, None]
    return predict(replace(arm, tree=replace(arm.tree, mass=mass, inertia=inertia)), motion)


def friction_by_name(arm: Arm) -> dict[str, list[float]]:
    """Nominal friction and reflected inertia of every joint, by figaroh's names."""
    named = {"fv": "viscous", "fs": "coulomb", "Ia": "rotor"}
    found = {k: [arm.effect(KINDS[v], j) for j in arm.joint_names] for k, v in named.items()}
    return {k: [e.parameters[SYMBOL[named[k]]] for e in items if e is not None] for k, items in found.items()}


def _peer(program: str, folder: Path) -> bool:
    ran = subprocess.run(
        [PYTHON, HERE / program, folder], env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=3600, check=False
    )
    if ran.returncode:
        print(f"{program}: {ran.stderr[-2000:]}")
    return ran.returncode == 0
