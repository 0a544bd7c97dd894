"""mujoco.sysid on one problem: FOLDER has model.xml and data.npz; writes mujoco_sysid.json. Runs in the peers' environment."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid

folder = Path(sys.argv[1])
data = np.load(folder / "data.npz")
spec = mujoco.MjSpec.from_string((folder / "model.xml").read_text())
names = json.loads((folder / "joints.json").read_text())
for name in names["joints"]:
    for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name, name=f"{name}_{kind.name}")
model = spec.compile()


def set_damping(joint, value):
    joint.damping[0] = value


parameters = sysid.ParameterDict()
for body, joint in zip(names["bodies"], names["joints"], strict=True):
    b, j = model.body(body).id, model.joint(joint).dofadr[0]
    for kind, value, modifier in (
        ("mass", model.body_mass[b], lambda s, p, x=body: setattr(s.body(x), "mass", p.value[0])),
        ("viscous", model.dof_damping[j], lambda s, p, x=joint: set_damping(s.joint(x), p.value[0])),
        ("coulomb", model.dof_frictionloss[j], lambda s, p, x=joint: setattr(s.joint(x), "frictionloss", p.value[0])),
        ("rotor", model.dof_armature[j], lambda s, p, x=joint: setattr(s.joint(x), "armature", p.value[0])),
    ):
        value = float(np.ravel(value)[0])
        parameters.add(sysid.Parameter(f"{kind} {joint}", value, 0.3 * value, 3.0 * value, modifier=modifier))
order = [names["joints"].index(model.joint(model.actuator_trnid[k, 0]).name) for k in range(model.nu)]
control = sysid.TimeSeries(data["t"], data["tau"][:, order])
readings = np.stack([data["q"], data["dq"]], axis=2).reshape(len(data["t"]), -1)
start = mujoco.MjData(model)
start.qpos[:], start.qvel[:] = data["q"][0], data["dq"][0]
state = sysid.create_initial_state(model, start.qpos, start.qvel, start.act)
measured = sysid.TimeSeries.from_names(data["t"][1:], readings[1:], model)
sequences = sysid.ModelSequences("arm", spec, "log", state, control, measured)
residual = sysid.build_residual_fn(models_sequences=[sequences])
began = time.process_time()
found, _ = sysid.optimize(initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False)
seconds = time.process_time() - began
values = dict(zip(found.keys(), found.as_vector().tolist(), strict=True))
(folder / "mujoco_sysid.json").write_text(json.dumps({"seconds": seconds, "values": values}))
