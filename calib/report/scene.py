"""An arm and its cell as plain data for the 3D player: a tree of joints, shapes on links, obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim.arm import Arm
from sim.cell import BoxObstacle, Cell, MeshObstacle, PlaneObstacle
from sim.tree import Shape

STICK = 0.02


def scene(arm: Arm, cell: Cell | None) -> dict[str, Any]:
    """links (parent, rotation, position, axis, prismatic), shapes (name, link, kind, size, rotation, position, mesh) and size m of the arm.

    An arm without any shapes is drawn as sticks between its joints. An obstacle's link is None; obstacles that are meshes are not drawn.
    """
    tree = arm.tree
    links = [
        {
            "parent": int(tree.parent[j]),
            "rotation": np.round(tree.rotation[j], 6),
            "position": np.round(tree.position[j], 6),
            "axis": np.round(tree.axis[j], 6),
            "prismatic": bool(tree.prismatic[j]),
        }
        for j in range(tree.n)
    ]
    shapes = [_shape(shape) for shape in tree.shapes] or _sticks(arm)
    size = float(sum(np.linalg.norm(p) for p in tree.position)) or 1.0
    obstacles = (
        [] if cell is None else [_obstacle(o, 2 * size) for o in cell.table.obstacles if not isinstance(o, MeshObstacle)]
    )
    return {"links": links, "shapes": [*shapes, *obstacles], "size": size}


def _shape(shape: Shape) -> dict[str, Any]:
    data: dict[str, Any] = {
        "name": shape.name,
        "link": shape.link,
        "kind": shape.kind,
        "size": [float(s) for s in shape.size],
        "rotation": np.round(shape.rotation, 6),
        "position": np.round(shape.position, 6),
    }
    if shape.vertices is not None and shape.faces is not None:
        data |= {"vertices": np.round(shape.vertices, 4), "faces": shape.faces}
    return data


def _sticks(arm: Arm) -> list[dict[str, Any]]:
    sticks = []
    for j in range(arm.n):
        end = arm.tree.position[j]
        length = float(np.linalg.norm(end))
        direction = end / length if length > 0 else np.array([0.0, 0.0, 1.0])
        sticks.append(
            {
                "name": "",
                "link": int(arm.tree.parent[j]),
                "kind": "capsule",
                "size": [STICK, length / 2],
                "rotation": Rotation.align_vectors(direction[None], [[0.0, 0.0, 1.0]])[0].as_matrix(),
                "position": end / 2,
            }
        )
    return sticks


def _obstacle(obstacle: BoxObstacle | PlaneObstacle, width: float) -> dict[str, Any]:
    if isinstance(obstacle, BoxObstacle):
        size, rotation = [edge / 2 for edge in obstacle.size], Rotation.from_euler("xyz", obstacle.rpy).as_matrix()
        return {
            "name": obstacle.name,
            "link": None,
            "kind": "box",
            "size": size,
            "rotation": rotation,
            "position": obstacle.position,
        }
    normal = np.array(obstacle.normal) / np.linalg.norm(obstacle.normal)
    rotation = Rotation.align_vectors(normal[None], [[0.0, 0.0, 1.0]])[0].as_matrix()
    return {
        "name": obstacle.name,
        "link": None,
        "kind": "plane",
        "size": [width],
        "rotation": rotation,
        "position": obstacle.position,
    }
