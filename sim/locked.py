"""An arm with fewer joints: a joint held still makes its link part of the link that carries it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sim.errors import ConfigError
from sim.tree import KinematicTree, combined

ROWS = ("parent", "rotation", "position", "axis", "prismatic", "mass", "com", "inertia", "armature", "damping", "frictionloss")
MORE_ROWS = ("stiffness", "springref", "q_min", "q_max", "dq_max", "tau_max")


def locked(tree: KinematicTree, held: Mapping[str, float]) -> KinematicTree:
    """The tree with the joints `held` (name -> rad, or m of a slide) fixed: their links' bodies and shapes join the parent's.

    A link that joins the base keeps its shapes and loses its mass, which has no effect on any joint torque.
    """
    rows = {key: getattr(tree, key).copy() for key in (*ROWS, *MORE_ROWS)}
    shapes = list(tree.shapes)
    for j in sorted((tree.joint_names.index(name) for name in held), reverse=True):
        up, value, axis = int(rows["parent"][j]), held[tree.joint_names[j]], rows["axis"][j]
        turn, origin = rows["rotation"][j], rows["position"][j]
        if rows["prismatic"][j]:
            origin = origin + turn @ axis * value
        else:
            turn = turn @ Rotation.from_rotvec(axis * value).as_matrix()
        for k in np.flatnonzero(rows["parent"] == j):
            rows["rotation"][k], rows["position"][k] = turn @ rows["rotation"][k], origin + turn @ rows["position"][k]
            rows["parent"][k] = up
        if up >= 0:
            own = (rows["mass"][j], origin + turn @ rows["com"][j], turn @ rows["inertia"][j] @ turn.T)
            joined = combined([(rows["mass"][up], rows["com"][up], rows["inertia"][up]), own])
            rows["mass"][up], rows["com"][up], rows["inertia"][up] = joined
        shapes = [
            replace(s, link=up, rotation=turn @ s.rotation, position=origin + turn @ s.position) if s.link == j else s
            for s in shapes
        ]
    kept = [j for j, name in enumerate(tree.joint_names) if name not in held]
    place = {old: new for new, old in enumerate(kept)} | {-1: -1}
    rows["parent"] = np.array([place.get(int(p), -1) for p in rows["parent"]])
    return replace(
        tree, **{key: row[kept] for key, row in rows.items()},
        joint_names=tuple(tree.joint_names[j] for j in kept), link_names=tuple(tree.link_names[j] for j in kept),
        shapes=tuple(replace(s, link=place[s.link]) for s in shapes),
    )  # fmt: skip


def require_within(file: Path, tree: KinematicTree, held: Mapping[str, float]) -> None:
    """ConfigError for a joint that is to stand outside its range, as an angle in degrees would make it."""
    for joint, value in held.items():
        low, high = (float(limit[tree.joint_names.index(joint)]) for limit in (tree.q_min, tree.q_max))
        if value < low or value > high:
            raise ConfigError(
                f"{file}: --lock {joint}={value:g} is outside its range of {low:g} to {high:g} (rad or m; is it in degrees?)"
            )
