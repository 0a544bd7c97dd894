"""mujoco.sysid on one problem: reads FOLDER with model.xml, joints.json and data.npz; writes mujoco_sysid.json.

Runs in the peers' environment. The log is cut into chunks of 0.2 s, the purpose of its `SystemTrajectory.split`. Each chunk
begins at the measured state (smoothed positions and speeds), so that the error of one open-loop rollout does not grow over the
whole log. A link's inertia scales with its mass, as `apply_body_mass_ipos(rot_inertia_scale=True)` does. Parameters are scaled
by their columns (`x_scale="jac"`), as its warning about conditioning advises. Bounds are a tenth to ten times the nominal
value.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid

CHUNK = 0.2  # s
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


def set_mass(body, value):
    body.fullinertia = np.array(body.fullinertia) * value / body.mass
    body.mass = value


parameters = sysid.ParameterDict()
for body, joint in zip(names["bodies"], names["joints"], strict=True):
    b, j = model.body(body).id, model.joint(joint).dofadr[0]
    for kind, value, modifier in (
        ("mass", model.body_mass[b], lambda s, p, x=body: set_mass(s.body(x), p.value[0])),
        ("viscous", model.dof_damping[j], lambda s, p, x=joint: set_damping(s.joint(x), p.value[0])),
        ("coulomb", model.dof_frictionloss[j], lambda s, p, x=joint: setattr(s.joint(x), "frictionloss", p.value[0])),
        ("rotor", model.dof_armature[j], lambda s, p, x=joint: setattr(s.joint(x), "armature", p.value[0])),
    ):
        value = float(np.ravel(value)[0])
        parameters.add(sysid.Parameter(f"{kind} {joint}", value, 0.1 * value, 10.0 * value, modifier=modifier))
order = [names["joints"].index(model.joint(model.actuator_trnid[k, 0]).name) for k in range(model.nu)]
tau, t = data["tau"][:, order], data["t"]
readings = np.stack([data["q"], data["dq"]], axis=2).reshape(len(t), -1)
start = mujoco.MjData(model)
states, controls, measured = [], [], []
length = round(CHUNK / float(np.median(np.diff(t))))
for first in range(0, len(t) - length, length):
    part = slice(first, first + length + 1)
    states.append(sysid.create_initial_state(model, data["smooth_q"][first], data["smooth_dq"][first], start.act))
    controls.append(sysid.TimeSeries(t[part] - t[first], tau[part]))
    measured.append(sysid.TimeSeries.from_names((t[part] - t[first])[1:], readings[part][1:], model))
names = [f"chunk {k}" for k in range(len(states))]
sequences = sysid.ModelSequences("arm", spec, names, states, controls, measured)
# the default divides by each chunk's own size, which is zero while a joint stands still; this uses the whole log
scale = readings.std(axis=0)


def residual_of(params, predicted, measured, model, return_pred_all, state=None, sensor_weights=None):
    """Differences of every chunk over the standard deviation of the signal."""
    predicted = predicted.resample(measured.times)
    return (measured.data - predicted.data) / scale, predicted, measured


residual = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=residual_of)
began = time.process_time()
found, _ = sysid.optimize(initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False, x_scale="jac")
seconds = time.process_time() - began
values = dict(zip(found.keys(), found.as_vector().tolist(), strict=True))
(folder / "mujoco_sysid.json").write_text(json.dumps({"seconds": seconds, "values": values}))
