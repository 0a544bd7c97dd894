"""figaroh on one problem: FOLDER has model.urdf and data.npz; writes figaroh.json and figaroh_K.npy. Runs in the peers' environment.

As its documentation and examples have it: torque and every column of the regressor filtered alike and decimated (parallel filtering of
M. Gautier), rows of a joint left out near its reversals, base parameters by its double QR, weighted by each joint's residual.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate

SLOW = 0.02  # rad/s
folder = Path(sys.argv[1])
data = np.load(folder / "data.npz")
model = pin.buildModelFromUrdf(str(folder / "model.urdf"))
robot = SimpleNamespace(model=model, data=model.createData())
n = model.nv
config = {"act_idxv": list(range(n)), "has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True}
names = [f"{p}_{i + 1}" for i in range(n) for p in ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")]
names += [f"extra_{k}" for k in range(4 * n)]
standard = dict.fromkeys(names, 0.0)


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
    """Every step-th value of each column after the low pass."""
    kept = np.arange(0, len(x) - len(data["taps"]) + 1, int(data["step"]))
    return np.stack([x[k : k + len(data["taps"])].T @ data["taps"] for k in kept])


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
for k in range(int(data["motions"])):
    fresh = build_regressor_reduced(regressor(*(data[f"new_{x}_{k}"] for x in ("q", "dq", "ddq"))), gone)
    np.save(folder / f"figaroh_{k}.npy", (fresh[:, base] @ phi).reshape(n, -1).T)
(folder / "figaroh.json").write_text(json.dumps(seconds))
