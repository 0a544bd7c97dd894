"""figaroh on one problem: reads FOLDER with model.urdf, joints.json and data.npz; writes figaroh.json and .npy files.

The files are figaroh_K.npy (base parameters) and figaroh_fit_K.npy (effort fit). Runs in the peers' environment. As in its
documentation and examples, torque and every regressor column are filtered alike and decimated (parallel filtering of M.
Gautier), and rows of a joint near its reversals are left out. Two estimates follow:

- base parameters by its double QR, weighted by each joint's residual (`select_stage: base`)
- its regularised effort fit with a pseudo-inertia matrix inequality per link (`physical_fit.solve_direct_effort_fit`), with the
  nominal arm as the prior and friction and reflected inertia free; the prior weight is chosen on the last fifth of the log
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from figaroh.identification.parameter import add_standard_additional_parameters, get_standard_parameters
from figaroh.identification.physical_fit import PhysicalPolicy, build_problem, solve_direct_effort_fit
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

SLOW = 0.02  # rad/s
PRIOR_WEIGHTS = (1e-6, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)  # the first is its default
folder = Path(sys.argv[1])
data = np.load(folder / "data.npz")
model = pin.buildModelFromUrdf(str(folder / "model.urdf"))
robot = SimpleNamespace(model=model, data=model.createData())
n = model.nv
# the arms have no torque offsets, so none are fitted
config = {"act_idxv": list(range(n)), "has_friction": True, "has_actuator_inertia": True, "has_joint_offset": False}
config |= json.loads((folder / "joints.json").read_text())["friction"]
standard = get_standard_parameters(model, config) | add_standard_additional_parameters(model, config)


def cpu(work):
    began = time.process_time()
    out = work()
    return out, time.process_time() - began


def regressor(q, dq, ddq):
    return build_regressor_basic(robot, q, dq, ddq, config)


def identified(w, tau):
    gone, left = get_index_eliminate(w, standard, 1e-6)
    reduced = build_regressor_reduced(w, gone)
    decomposer = QRDecomposer()
    _, _, _, phi = decomposer.double_decomposition(tau, reduced, left)
    return gone, decomposer.get_base_indices(), phi


def decimated(x):
    """Every step-th value of each column after the low-pass filter."""
    kept = np.arange(0, len(x) - len(data["taps"]) + 1, int(data["step"]))
    return np.stack([x[k : k + len(data["taps"])].T @ data["taps"] for k in kept])


def fitted(rows, weight):
    """theta of the effort fit to part of the rows (K,); None if its solver finds no optimum."""
    use = fast & rows
    problem = build_problem(
        w[use], tau[use], list(standard), list(model.names[1:]), prior=np.array(list(standard.values())),
        policy=PhysicalPolicy(prior_weight=weight), row_weight=(row_weight * np.ones(tau.shape))[use],
    )  # fmt: skip
    return solve_direct_effort_fit(problem).theta


seconds = {}
if "random_q" in data:
    random = [data[k] for k in ("random_q", "random_dq", "random_ddq")]
    seconds["regressor"] = min(cpu(lambda: regressor(*random))[1] for _ in range(3))
    w = regressor(*random)
    seconds["base"] = min(cpu(lambda: identified(w, np.asarray(data["random_tau"]).T.ravel()))[1] for _ in range(2))
w = regressor(data["q"], data["dq"], data["ddq"]).reshape(n, len(data["q"]), -1)
w = np.stack([decimated(part) for part in w])
tau, fast = decimated(data["tau"]).T, np.abs(decimated(data["dq"]).T) > SLOW
weight = np.ones((n, 1))
for _ in range(2):
    gone, base, phi = identified((w * weight[:, :, None])[fast], (tau * weight)[fast])
    reduced = build_regressor_reduced(w.reshape(-1, w.shape[2]), gone)[:, base] @ phi
    miss = np.where(fast, tau - reduced.reshape(tau.shape), 0.0)
    weight = np.sqrt(fast.sum(axis=1) / np.sum(miss**2, axis=1))[:, None]
last = np.arange(tau.shape[1]) >= 0.8 * tau.shape[1]
row_weight, errors = weight, {}
for prior_weight in PRIOR_WEIGHTS:
    theta = fitted(~last, prior_weight)
    if theta is not None:
        errors[prior_weight] = float(np.sum(((tau - w @ theta) * weight)[fast & last] ** 2))
theta = fitted(np.ones_like(last), min(errors, key=errors.__getitem__))
for k in range(int(data["motions"])):
    fresh = regressor(*(data[f"new_{x}_{k}"] for x in ("q", "dq", "ddq")))
    np.save(folder / f"figaroh_{k}.npy", (build_regressor_reduced(fresh, gone)[:, base] @ phi).reshape(n, -1).T)
    np.save(folder / f"figaroh_fit_{k}.npy", (fresh @ theta).reshape(n, -1).T)
(folder / "figaroh.json").write_text(json.dumps(seconds))
