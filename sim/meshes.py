"""Mesh files in the formats used for robots, as STL in metres for MuJoCo. Only this file calls trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.errors import ConfigError

FORMATS = (".stl", ".obj", ".dae", ".ply", ".off", ".glb", ".gltf", ".3mf")
MAX_BYTES = 200_000_000


def as_stl(source: Path, copy: Path) -> None:
    """Write the triangles of a mesh file to `copy` as binary STL in metres (COLLADA states its unit; others are taken as metres).

    ConfigError if the file has another format, is too large, cannot be read, has no triangles or a corner that is not finite.
    """
    import trimesh

    if source.suffix.lower() not in FORMATS:
        raise ConfigError(f"mesh {source}: {source.suffix} is not read; convert it to one of {', '.join(FORMATS)}")
    if source.stat().st_size > MAX_BYTES:
        raise ConfigError(f"mesh {source}: {source.stat().st_size} bytes; at most {MAX_BYTES}; simplify it")
    try:
        scene = trimesh.load_scene(source)
        mesh = scene.to_mesh()
    except Exception as error:  # the readers of these formats may raise anything for a damaged file
        raise ConfigError(f"mesh {source}: cannot be read ({type(error).__name__}: {error}); export it again") from error
    unit = str(scene.metadata.get("units") or scene.units or "")
    if unit.endswith(" * meters"):
        mesh.apply_scale(float(unit.split()[0]))
    if not (len(mesh.faces) and np.all(np.isfinite(mesh.vertices))):
        raise ConfigError(f"mesh {source}: {len(mesh.faces)} triangles; a body has at least 4, all of finite corners")
    copy.write_bytes(mesh.export(file_type="stl"))
