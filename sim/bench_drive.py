"""One drive on a bench as an arm of one joint: a free shaft, a known load on a lever, or a load of unknown mass."""

from __future__ import annotations

import numpy as np

from sim.tree import GRAVITY, KinematicTree

STEEL = 7850.0
FREE_MASS = 0.1
UNKNOWN_LOAD = (1.0, 0.1)


def bench_drive(joint: str, load: tuple[float, float] | None = None, unknown: bool = False) -> KinematicTree:
    """A tree with one hinge; load = (kg, m from the axis) hangs straight down from a level axis at q = 0 rad.

    The load is a steel ball. Without a load the shaft is vertical, so that gravity exerts no torque, and a ball of 0.1 kg on
    the axis is a placeholder. unknown: 1 kg at 0.1 m stands in for a load of unknown mass.
    """
    mass, lever = load or (UNKNOWN_LOAD if unknown else (FREE_MASS, 0.0))
    level = load is not None or unknown
    radius = (3 * mass / (4 * np.pi * STEEL)) ** (1 / 3)
    none, nan = np.zeros(1), np.full(1, np.nan)
    return KinematicTree(
        joint_names=(joint,), link_names=("shaft",), parent=np.array([-1]), rotation=np.eye(3)[None], position=np.zeros((1, 3)),
        axis=np.array([[0.0, 1.0, 0.0] if level else [0.0, 0.0, 1.0]]), prismatic=np.array([False]), mass=np.array([mass]),
        com=np.array([[0.0, 0.0, -lever]]), inertia=0.4 * mass * radius**2 * np.eye(3)[None], armature=none, damping=none,
        frictionloss=none, stiffness=none, springref=none, q_min=nan, q_max=nan, dq_max=nan, tau_max=nan,
        gravity=np.array([0.0, 0.0, -GRAVITY]), shapes=(),
    )  # fmt: skip
