"""Capsules, and convex pieces, enclose every point of a mesh. For a bent mesh they are smaller than one capsule or hull."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from sim.arm import load_arm
from sim.enclosing import SAMPLE, enclosing_capsules, with_pieces
from sim.tree import Shape


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


@pytest.mark.parametrize("name", MESHES)
def test_every_point_of_the_surface_is_in_a_convex_piece(name, ur10e_tree):
    mesh = MESHES[name]()
    turn, place = Rotation.from_rotvec([0.3, -0.4, 0.7]).as_matrix(), np.array([0.1, 0.2, 0.3])
    link = Shape(2, "link", "mesh", (0.0, 0.0, 0.0), turn, place, np.asarray(mesh.vertices), np.asarray(mesh.faces))
    pieces = with_pieces(replace(ur10e_tree, shapes=(link,)), hulls=True).shapes
    assert all(piece.link == 2 for piece in pieces)
    corners = mesh.vertices[mesh.faces]
    points = np.einsum("stk,tkx->stx", np.random.default_rng(3).dirichlet((1, 1, 1), (20, len(corners))), corners).reshape(
        -1, 3
    )
    points = points @ turn.T + place
    assert np.any([_in(piece, points) for piece in pieces], axis=0).all()
    if name == "can":  # its flat ends are not hemispheres
        assert [piece.kind for piece in pieces] == ["mesh"]


def test_a_bent_body_falls_into_convex_pieces_that_are_no_larger_than_it(ur10e_tree):
    mesh = _bent()
    link = Shape(2, "link", "mesh", (0.0, 0.0, 0.0), np.eye(3), np.zeros(3), np.asarray(mesh.vertices), np.asarray(mesh.faces))
    pieces = with_pieces(replace(ur10e_tree, shapes=(link,)), hulls=True).shapes
    assert len(pieces) > 1
    assert sum(ConvexHull(piece.vertices).volume for piece in pieces) < 0.5 * ConvexHull(mesh.vertices).volume


def _in(piece, points):
    own = (points - piece.position) @ piece.rotation
    if piece.kind == "mesh":
        faces = ConvexHull(piece.vertices).equations
        return (own @ faces[:, :3].T + faces[:, 3] < 1e-6).all(axis=1)
    along = np.clip(own[:, 2], -piece.size[1], piece.size[1])
    return np.linalg.norm(own - along[:, None] * [0.0, 0.0, 1.0], axis=1) < piece.size[0] + 1e-9


@pytest.fixture(scope="module")
def ur10e_tree():
    return load_arm("ur10e").tree
