"""SHA-256 of what a plan was made for: the model, its limits, and the cell with its meshes."""

from __future__ import annotations

import hashlib
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sim.arm import Arm
from sim.cell import Cell
from sim.version import software_version

HEX = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Hashes(BaseModel):
    """What a plan was made for. cell is None for a plan made without a cell."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    model: HEX
    limits: HEX
    cell: HEX | None = None
    software: str


def hashes_of(arm: Arm, cell: Cell | None) -> Hashes:
    """SHA-256 of the model (text, compiled numbers, shapes), of the limits and of the cell, and the software version."""
    model = hashlib.sha256(arm.model_text.encode())
    tree = arm.tree
    for value in (
        tree.parent,
        tree.rotation,
        tree.position,
        tree.axis,
        tree.mass,
        tree.com,
        tree.inertia,
        tree.armature,
        tree.gravity,
    ):
        model.update(np.ascontiguousarray(value).tobytes())
    for shape in tree.shapes:
        model.update(f"{shape.link} {shape.name} {shape.kind} {shape.size!r}".encode())
        for part in (shape.rotation, shape.position, shape.vertices, shape.faces):
            model.update(b"-" if part is None else np.ascontiguousarray(part).tobytes())
    limits = hashlib.sha256(",".join(arm.joint_names).encode())
    for name in ("q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max"):
        limits.update(np.ascontiguousarray(getattr(arm, name), dtype="<f8").tobytes())
    return Hashes(
        model=model.hexdigest(),
        limits=limits.hexdigest(),
        cell=None if cell is None else _cell_hash(cell),
        software=software_version(),
    )


def _cell_hash(cell: Cell) -> str:
    digest = hashlib.sha256(cell.sha256.encode())
    for obstacle in (*cell.table.obstacles, *cell.table.tool):
        if obstacle.kind == "mesh":
            digest.update(hashlib.sha256(cell.mesh(obstacle.file, f"obstacle {obstacle.name}")).digest())
    return digest.hexdigest()
