"""`prediction.mcap`: a validated log for Foxglove, Rerun and PlotJuggler, with the moving arm and the predicted torque."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.validation.validate import LogCheck
from logs.log import Log
from logs.prediction import write_prediction
from sim.arm import Arm
from sim.mjcf import quaternion
from sim.urdf import base_name, viewer_text


def write_predictions(folder: Path, arm: Arm, logs: Sequence[Log], checks: Sequence[LogCheck]) -> list[Path]:
    """prediction.mcap in `folder`, or prediction-<log>.mcap for each of several; the logs themselves are not touched."""
    files = []
    for k, (log, check) in enumerate(zip(logs, checks, strict=True)):
        word = re.sub(r"[^A-Za-z0-9_]", "-", Path(check.log).stem)[:40]
        name = "prediction.mcap" if len(checks) == 1 else f"prediction-{k + 1}-{word}.mcap"
        m = check.measurement
        keep = np.flatnonzero(m.inside)
        on_wall = bool(np.isfinite(log.t_host).all())
        stamps = (log.t_host_origin if on_wall else log.t_origin) + np.rint(m.trajectory.t[keep] * 1e9).astype(np.int64)
        if not len(keep) or stamps[0] < 0:
            continue
        q, urdf = m.trajectory.q[keep], viewer_text(arm)
        parents = [base_name(arm) if p < 0 else arm.tree.link_names[p] for p in arm.tree.parent]
        frames = list(zip(parents, arm.tree.link_names, strict=True))
        poses = joint_poses(arm, q) if urdf else np.empty((len(q), 0, 7))
        write_prediction(
            folder / name, stamps, arm.joint_names, q, m.trajectory.dq[keep], m.tau[keep], check.tau_hat[keep], urdf, frames if urdf else [],
            poses,
        )  # fmt: skip
        files.append(folder / name)
    return files


def joint_poses(arm: Arm, q: np.ndarray) -> np.ndarray:
    """(N, n, 7) position m and quaternion x y z w of each link's frame in its parent's, at the angles q (N, n) rad or m."""
    tree = arm.tree
    out = np.empty((len(q), arm.n, 7))
    for j in range(arm.n):
        angle = np.zeros(len(q)) if tree.prismatic[j] else q[:, j]
        slide = q[:, j] if tree.prismatic[j] else np.zeros(len(q))
        out[:, j, :3] = tree.position[j] + slide[:, None] * (tree.rotation[j] @ tree.axis[j])
        w, v = quaternion(tree.rotation[j])[0], quaternion(tree.rotation[j])[1:]
        c, s = np.cos(angle / 2), np.sin(angle / 2)[:, None] * tree.axis[j]
        out[:, j, 3:6] = w * s + c[:, None] * v + np.cross(v, s)
        out[:, j, 6] = w * c - s @ v
    return out
