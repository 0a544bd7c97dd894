"""The union of the capsules holds every point of a mesh, and is smaller than one capsule where the mesh is bent."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from sim.enclosing import SAMPLE, enclosing_capsules


def _held(points, capsules):
    inside = np.zeros(len(points), dtype=bool)
    for c in capsules:
        along = c.ends[1] - c.ends[0]
        share = np.clip((points - c.ends[0]) @ along / max(along @ along, 1e-18), 0, 1)
        inside |= np.linalg.norm(points - c.ends[0] - share[:, None] * along, axis=1) <= c.radius + 1e-9
    return inside


def _bent():
    a, b = trimesh.creation.box((0.05, 0.05, 0.5)), trimesh.creation.box((0.4, 0.05, 0.05))
    b.apply_translation((0.2, 0, 0.25))
    return trimesh.util.concatenate([a, b])


MESHES = {
    "box": lambda: trimesh.creation.box((0.1, 0.2, 0.6)),
    "bent": _bent,
    "flat": lambda: trimesh.creation.box((0.3, 0.2, 0.001)),
    "fine": lambda: trimesh.creation.icosphere(subdivisions=5, radius=0.3),
    "can": lambda: trimesh.creation.cylinder(0.08, 0.4),
    "tetrahedron": lambda: trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    ),
}


@pytest.mark.parametrize("name", MESHES)
def test_every_point_of_the_surface_is_held(name):
    mesh = MESHES[name]()
    rng = np.random.default_rng(3)
    turn = Rotation.random(random_state=5).as_matrix()
    vertices = mesh.vertices @ turn.T + [0.3, -0.1, 0.2]
    corners = vertices[mesh.faces]
    weights = rng.dirichlet((1, 1, 1), (20, len(corners)))
    points = np.concatenate([vertices, np.einsum("stk,tkx->stx", weights, corners).reshape(-1, 3)])
    capsules = enclosing_capsules(vertices, mesh.faces)
    assert _held(points, capsules).all()
    if name == "can":
        assert capsules[0].radius < 0.085
    if name == "fine":
        assert len(mesh.faces) > 10 * SAMPLE
        assert sum(c.volume for c in capsules) < 1.3 * 4 / 3 * np.pi * 0.3**3


def test_a_bent_body_takes_more_than_one_and_less_room():
    mesh = _bent()
    one, more = enclosing_capsules(mesh.vertices, mesh.faces, most=1), enclosing_capsules(mesh.vertices, mesh.faces)
    assert len(more) > 1
    assert sum(c.volume for c in more) < 0.25 * one[0].volume
