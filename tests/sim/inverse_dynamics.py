"""MuJoCo's inverse dynamics without contacts, limits and dry friction."""

import mujoco
import numpy as np


def inverse_dynamics(model, q, dq, ddq):
    """(N, n) N m at the states q, dq, ddq (N, n)."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, tau = mujoco.MjData(model), []
    for row in zip(q, dq, ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        tau.append(data.qfrc_inverse.copy())
    return np.array(tau)
