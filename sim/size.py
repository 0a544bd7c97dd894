"""Placeholder masses from an arm's size, for arms without published masses: a scale for priors, not an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.tree import KinematicTree

# UR3e to UR20, Panda: 16 to 45 kg per square metre of reach; hobby arms 4 to 10
MASS_PER_REACH = 20.0
LEAST_REACH = 0.1


def sized(tree: KinematicTree) -> KinematicTree:
    """The tree with masses by its size: 20 kg per square metre of reach, the same for each link, at the middle of the link.

    The radius of gyration is 0.15 of the reach for every link. With these values the model can be simulated, and a prior's
    width is meaningful.
    """
    n = tree.n
    ends = np.zeros((n, 3))
    for j in range(n):
        if tree.parent[j] >= 0 and np.linalg.norm(tree.position[j]) > np.linalg.norm(ends[tree.parent[j]]):
            ends[tree.parent[j]] = tree.position[j]
    reach = max(tree.reach, LEAST_REACH)
    mass = np.full(n, MASS_PER_REACH * reach**2 / n)
    inertia = mass[:, None, None] * (0.15 * reach) ** 2 * np.eye(3) * 2 / 3
    return replace(tree, mass=mass, com=ends / 2, inertia=inertia)
