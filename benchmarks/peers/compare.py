"""One log of one arm, known to the last digit, for us and for the peers: how long each takes, and how wrong its torque is elsewhere.

The metric needs no agreement on parameters: the torque of each tool's model on a motion that nobody saw, against the truth without noise.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks import ONE_THREAD
from benchmarks.known_truth import fitting_motion, fourier_motion, recorded_on_mock, varied
from calib.identification.identify import identify
from calib.identification.least_squares import ordinary
from calib.identification.model import TorqueModel
from calib.preprocessing import prepare
from sim.arm import Arm, load_arm
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


def run() -> list[dict[str, Any]]:
    """Rows of the table; where the peers are not installed, the rows that say so."""
    nominal = load_arm("ur10e")
    truth = without_offsets(varied(nominal, 7))
    log = recorded_on_mock(truth, nominal, fitting_motion(nominal, 3, 10.0), 1, timestep=ONE_STEP)
    new = fourier_motion(nominal, 40, 10.0)
    exact = predict(truth, new)

    def error(tau: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.square((tau - exact) / exact.std(axis=0)))))

    began = time.process_time()
    found = identify(nominal, [log])
    seconds = time.process_time() - began
    unknown = [e.name for e in found.result.full if not e.identifiable and e.name.startswith(("m_", "Ia_"))]
    unknown += [e.name for e in found.result.estimates if not e.identifiable and e.name.startswith(("viscous", "coulomb"))]
    rng = np.random.default_rng(0)
    random = {f"random_{k}": rng.uniform(-2, 2, (10_000, nominal.n)) for k in ("q", "dq", "ddq", "tau")}
    model = TorqueModel.of_arm(nominal)
    motion = [random[f"random_{k}"] for k in ("q", "dq", "ddq")]
    rows = [
        _row("stacked regressor, 10,000 samples, 6 joints", best(lambda: model.body.regressor(*motion)) * 1e3, "ms", "<= 10"),
        _row("Pinocchio in a loop: stacked regressor, 10,000 samples", best(lambda: _looped(model, *motion), 3) * 1e3, "ms"),
        _row("arrays to base parameters with std", best(lambda: ordinary(model, *motion, random["random_tau"])) * 1e3, "ms", "<= 100"),
        _row("mass, damping, friction, rotor (24) and the rest (58 in all), 10 s log at 500 Hz", seconds, "s", "<= 1",
             f"calib identify, derivatives and possible inertias included; named as not identifiable: {', '.join(unknown) or 'none'}"),
        _row("torque error on an unseen motion: nominal arm", 100 * error(predict(nominal, new)), "%"),
        _row("torque error on an unseen motion: calib identify", 100 * error(predict(found.arm, new)), "%", "ahead of both peers"),
    ]  # fmt: skip
    if not PYTHON.is_file():
        return [*rows, _row("peers", "not installed", note="`make peers` installs figaroh and mujoco.sysid into .venv-peers")]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        m = prepare(log, nominal)
        (folder / "model.urdf").write_text(urdf_text(nominal))
        (folder / "model.xml").write_text(plant_text(nominal, ONE_STEP))
        names = {"joints": list(nominal.joint_names), "bodies": list(nominal.tree.link_names)}
        (folder / "joints.json").write_text(json.dumps(names))
        tr, inside = m.trajectory, m.inside
        np.savez(
            folder / "data.npz", **random, q=tr.q[inside], dq=tr.dq[inside], ddq=tr.ddq[inside], tau=m.tau[inside], t=log.t,
            new_q=new.q, new_dq=new.dq, new_ddq=new.ddq,
        )  # fmt: skip
        if _peer("figaroh_peer.py", folder):
            took = json.loads((folder / "figaroh.json").read_text())
            rows += [
                _row("figaroh: stacked regressor, 10,000 samples", took["regressor"] * 1e3, "ms"),
                _row("figaroh: arrays to base parameters", (took["regressor"] + took["base"]) * 1e3, "ms"),
                _row("figaroh: torque error on the unseen motion", 100 * error(np.load(folder / "figaroh.npy")), "%",
                     note="its base parameters, friction, rotor and offsets; our derivatives, every sample"),
            ]  # fmt: skip
        np.savez(folder / "data.npz", t=log.t, q=log.q, dq=log.dq, tau=log.tau)
        if _peer("mujoco_sysid_peer.py", folder):
            peer = json.loads((folder / "mujoco_sysid.json").read_text())
            rows += [
                _row("mujoco.sysid: 24 parameters, same log", peer["seconds"], "s"),
                _row("mujoco.sysid: torque error on the unseen motion", 100 * error(_predicted(nominal, peer["values"], new)), "%"),
                _row("mass of shoulder_pan's link, which no motion shows: mujoco.sysid",
                     100 * (peer["values"][f"mass {nominal.joint_names[0]}"] / truth.tree.mass[0] - 1), "% off"),
            ]  # fmt: skip
    return rows


def best(work: Any, repeats: int = 5) -> float:
    """Least CPU seconds of several runs."""
    work()
    out = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        out.append(time.process_time() - began)
    return min(out)


def _looped(model: TorqueModel, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """The same regressor, sample by sample by Pinocchio."""
    links = model.body.pinocchio
    data, out = links.createData(), np.empty((len(q), model.arm.n, 10 * model.arm.n))
    for k in range(len(q)):
        out[k] = pin.computeJointTorqueRegressor(links, data, q[k], dq[k], ddq[k])
    return out


def without_offsets(arm: Arm) -> Arm:
    """The arm with true torque readings, which is what every tool can model."""
    return replace(arm, effects=tuple(e for e in arm.effects if e.effect != "torque_offset"))


def _predicted(nominal: Arm, values: dict[str, float], motion: Trajectory) -> np.ndarray:
    arm = nominal
    mass = np.array([values[f"mass {j}"] for j in nominal.joint_names])
    for j in nominal.joint_names:
        for kind, effect in KINDS.items():
            old = nominal.effect(effect, j)
            assert old is not None
            arm = with_effect(arm, replace(old, parameters={**old.parameters, SYMBOL[kind]: values[f"{kind} {j}"]}))
    return predict(replace(arm, tree=replace(arm.tree, mass=mass)), motion)


def _peer(program: str, folder: Path) -> bool:
    ran = subprocess.run(
        [PYTHON, HERE / program, folder], env=os.environ | ONE_THREAD, capture_output=True, text=True, timeout=900, check=False
    )
    if ran.returncode:
        print(f"{program}: {ran.stderr[-2000:]}")
    return ran.returncode == 0


def _row(what: str, value: float | str, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value if isinstance(value, str) else f"{value:.3g}", "unit": unit, "bar": bar, "note": note}
