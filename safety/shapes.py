"""Bodies for distances: link shapes, obstacles, tool and what it holds. Meshes become convex hulls, which are no smaller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import coal
import mujoco
import numpy as np
import pinocchio as pin

from sim.arm import Arm
from sim.cell import BoxObstacle, Cell, MeshObstacle, PlaneObstacle, ToolBox, ToolCapsule, ToolMesh
from sim.errors import ConfigError
from sim.tree import Shape

LARGEST = 10.0
FARTHEST = 100.0
TOOL = "tool "
Obstacle = BoxObstacle | PlaneObstacle | MeshObstacle


def link_body(shape: Shape, where: str) -> coal.CollisionGeometry:
    """The body of a link's shape; ConfigError if a size or a place is invalid."""
    size = shape.size
    counts = {"capsule": 2, "cylinder": 2, "sphere": 1, "box": 3, "mesh": 0}
    used = np.array(size[: counts[shape.kind]])
    _check_sizes(used, f"{where}: shape {shape.name}")
    if not (np.all(np.isfinite(shape.rotation)) and np.all(np.isfinite(shape.position))):
        raise ConfigError(f"{where}: shape {shape.name} has a place that is not finite; correct its pos and quat")
    if shape.kind == "capsule":
        return coal.Capsule(size[0], 2 * size[1])
    if shape.kind == "cylinder":
        return coal.Cylinder(size[0], 2 * size[1])
    if shape.kind == "sphere":
        return coal.Sphere(size[0])
    if shape.kind == "box":
        return coal.Box(*(2 * used))
    assert shape.vertices is not None
    return hull(shape.vertices, f"{where}: mesh of shape {shape.name}")


def obstacle_body(obstacle: Obstacle, cell: Cell, where: str) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """The body of an obstacle and its placement; ConfigError if a size, a place or a mesh is invalid."""
    position = np.array(obstacle.position, dtype=float)
    if not np.all(np.abs(position) <= FARTHEST):
        raise ConfigError(f"{where}: stands at {position.tolist()} m, farther than {FARTHEST:g} m (millimetres?)")
    if isinstance(obstacle, PlaneObstacle):
        normal = np.array(obstacle.normal, dtype=float)
        length = float(np.linalg.norm(normal))
        if not (np.isfinite(length) and length > 1e-6):
            raise ConfigError(f"{where}: normal {normal.tolist()} has no direction; give the outward normal, such as [0, 0, 1]")
        normal = normal / length
        return coal.Halfspace(normal, float(normal @ position)), pin.SE3.Identity()
    placement = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), position)
    if isinstance(obstacle, BoxObstacle):
        size = np.array(obstacle.size, dtype=float)
        _check_sizes(size, where)
        return coal.Box(*size), placement
    return hull(mesh_vertices(cell.mesh(obstacle.file, where), obstacle.file, where), f"{where}: {obstacle.file}"), placement


@dataclass(frozen=True)
class ToolShape(Shape):
    """A shape that the cell adds to the arm. The arm's own model may have shapes whose names begin alike."""


def equipped(arm: Arm, cell: Cell) -> Arm:
    """The arm with the cell's [[tool]] shapes on its last link, named `tool NAME`; an arm that has its tool stays as it is.

    ConfigError if a mesh cannot be read, or if the arm's model has a shape of that name.
    """
    if any(isinstance(s, ToolShape) for s in arm.tree.shapes):
        return arm
    shapes = tuple(_tool_shape(tool, arm.n - 1, cell) for tool in cell.table.tool)
    if taken := {s.name for s in shapes} & {s.name for s in arm.tree.shapes}:
        raise ConfigError(f"{cell.path}: {arm.model_path} has a shape named {min(taken)} too; rename the [[tool]]")
    return replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, *shapes))) if shapes else arm


def _tool_shape(tool: ToolBox | ToolCapsule | ToolMesh, link: int, cell: Cell) -> ToolShape:
    name, where = f"{TOOL}{tool.name}", f"{cell.path}: tool {tool.name}"
    if isinstance(tool, ToolCapsule):
        first, last = (np.array(end, dtype=float) for end in tool.ends)
        length = float(np.linalg.norm(last - first))
        if length < 1e-9:
            return ToolShape(link, name, "sphere", (tool.radius, 0.0, 0.0), np.eye(3), first)
        rotation = _towards((last - first) / length)
        return ToolShape(link, name, "capsule", (tool.radius, length / 2, 0.0), rotation, (first + last) / 2)
    rotation, position = pin.rpy.rpyToMatrix(*tool.rpy), np.array(tool.position, dtype=float)
    if isinstance(tool, ToolBox):
        return ToolShape(link, name, "box", tuple(x / 2 for x in tool.size), rotation, position)
    vertices = mesh_vertices(cell.mesh(tool.file, where), tool.file, where)
    return ToolShape(link, name, "mesh", (0.0, 0.0, 0.0), rotation, position, vertices)


def _towards(direction: np.ndarray) -> np.ndarray:
    """A rotation whose third column is the unit vector `direction`."""
    across = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    across /= np.linalg.norm(across)
    return np.column_stack((across, np.cross(direction, across), direction))


def _check_sizes(size: np.ndarray, where: str) -> None:
    if not np.all((size > 0) & (size <= LARGEST)):
        raise ConfigError(
            f"{where}: size {size.tolist()} m; every size must be above 0 and at most {LARGEST:g} m (millimetres?)"
        )


def mesh_vertices(content: bytes, name: str, where: str) -> np.ndarray:
    """Vertices (V, 3) m of the content of an STL or OBJ file, read by MuJoCo."""
    name = Path(name).name
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh", file=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    try:
        spec.assets = {name: content}
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"{where}: {name} is not a mesh that MuJoCo can read: {str(error).strip()}") from error
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    return np.asarray(model.mesh_vert, dtype=float) @ rotation.reshape(3, 3).T + model.mesh_pos[0]


def hull(vertices: np.ndarray, where: str) -> coal.CollisionGeometry:
    """The convex hull of (V, 3) points; ConfigError if they are not finite, lie in one plane, or are not in metres."""
    if not (vertices.ndim == 2 and vertices.shape[1] == 3 and len(vertices) >= 4 and np.all(np.isfinite(vertices))):
        raise ConfigError(
            f"{where}: {vertices.shape} points, all finite: {bool(np.all(np.isfinite(vertices)))}; at least 4 are needed"
        )
    extent = np.ptp(vertices, axis=0)
    if not (np.all(extent <= LARGEST) and np.all(extent > 0)):
        raise ConfigError(
            f"{where}: extends over {extent.tolist()} m; a body has three dimensions, at most {LARGEST:g} m (millimetres?)"
        )
    thickness = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)[-1]
    if not thickness > 1e-9:
        raise ConfigError(f"{where}: all points lie in one plane; a body has a volume")
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return coal.Convex.convexHull(points, False, "Qt")
