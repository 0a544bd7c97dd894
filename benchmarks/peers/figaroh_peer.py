"""figaroh on one problem: FOLDER has model.urdf and data.npz; writes figaroh.json. Runs in the peers' environment."""

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


random = [data[k] for k in ("random_q", "random_dq", "random_ddq")]
seconds = {"regressor": min(cpu(lambda: regressor(*random))[1] for _ in range(3))}
w = regressor(*random)
seconds["base"] = min(cpu(lambda: identified(w, np.asarray(data["random_tau"]).T.ravel()))[1] for _ in range(2))
w = regressor(data["q"], data["dq"], data["ddq"])
gone, base, phi = identified(w, np.asarray(data["tau"]).T.ravel())
fresh = build_regressor_reduced(regressor(data["new_q"], data["new_dq"], data["new_ddq"]), gone)
predicted = (fresh[:, base] @ phi).reshape(n, -1).T
np.save(folder / "figaroh.npy", predicted)
(folder / "figaroh.json").write_text(json.dumps(seconds))
