"""Meshes that cover a part of the plane twice, or have a crack, are refused by name."""

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace

SQUARE = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])

# the square next to one whose common side has one node more, at (2, 1)
HANGING = (
    np.vstack([SQUARE, [[2, 1], [4, 0], [4, 2]]]),
    np.vstack([HALVES, [[1, 5, 4], [4, 5, 6], [4, 6, 2]]]),
)
# a triangle that comes in from outside and shares no node
CROSSING = (np.vstack([SQUARE, [[1.5, 0.9], [3, 0.8], [3, 1.3]]]), np.vstack([HALVES, [[4, 5, 6]]]))
# the same within one element
WITHIN = (np.vstack([SQUARE, [[1.5, 0.5], [1.6, 0.5], [1.5, 0.6]]]), np.vstack([HALVES, [[4, 5, 6]]]))


def twice_around() -> tuple[np.ndarray, np.ndarray]:
    """Ten triangles around a node, each with an angle of 72 degrees: two turns, no edge used twice."""
    angle = np.deg2rad(72) * np.arange(10)
    radius = np.where(np.arange(10) < 5, 1.0, 1.2)
    nodes = np.vstack([[[0, 0]], (radius * [np.cos(angle), np.sin(angle)]).T])
    return nodes, np.array([[0, 1 + k, 1 + (k + 1) % 10] for k in range(10)])


WRONG = {
    "hanging": (HANGING, "node 4 hangs on the edge between nodes 1 and 2 of element 0,"),
    "crossing": (CROSSING, "elements 0 and 2 overlap: their edges cross"),
    "within": (WITHIN, "elements 2 and 0 overlap: a piece lies on another"),
    "winding": (twice_around(), "elements overlap around node 0: 0, 1, 2, 3, ... wind around it"),
}


@pytest.mark.parametrize("name", WRONG)
def test_arrays_and_problems_are_refused(name: str) -> None:
    (nodes, triangles), message = WRONG[name]
    with pytest.raises(ValueError, match=message):
        from_arrays(nodes, triangles)
    mesh = MeshTri(np.ascontiguousarray(nodes.T), np.ascontiguousarray(triangles.T))
    with pytest.raises(ProblemError, match=message) as caught:
        ContactProblem(mesh.with_boundaries({"left": [0]}), Laplace(1.0), ("left",))
    assert caught.value.part == "mesh"


@pytest.mark.parametrize(("beside", "hangs"), [(0.0, True), (1e-6, True), (-1e-6, True), (4e-6, False)])
def test_node_hangs_on_an_edge_within_a_millionth_of_its_length(beside: float, hangs: bool) -> None:
    nodes = HANGING[0].copy()
    nodes[4, 0] += beside  # the edge is 2 long
    found = fault(MeshTri(nodes.T.copy(), HANGING[1].T.copy())) or ""
    assert ("hangs" in found) == hangs


@pytest.mark.parametrize(("factor", "seed"), [(1.0, 0), (1.0, 1), (1e-6, 2), (1e6, 3)])
def test_the_same_is_found_wherever_the_mesh_lies(factor: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.standard_normal((2, 2)))[0]
    shift = rng.uniform(-3, 3, (2, 1))
    for (nodes, triangles), _ in WRONG.values():
        mesh = MeshTri(factor * (turn @ nodes.T + shift), np.ascontiguousarray(triangles.T))
        assert fault(mesh) is not None
    nodes = np.delete(HANGING[0], 4, axis=0).T
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]).T
    sound = MeshTri(factor * (turn @ nodes + shift), triangles)
    assert fault(sound) is None


def test_a_small_piece_beside_long_edges_is_found() -> None:
    # edges a thousand times longer than those that cross them: the classes of length must meet
    p = np.vstack([1000 * SQUARE, [[1999.5, 3], [2000.5, 3], [2000.2, 4]]])
    assert "overlap" in (fault(MeshTri(p.T.copy(), np.vstack([HALVES, [[4, 5, 6]]]).T.copy())) or "")


def test_pieces_in_holes_beside_each_other_and_touching_in_a_node_are_sound() -> None:
    ring = rectangle(6, 6)
    middle = ring.p[:, ring.t].mean(axis=1)
    hole = np.max(np.abs(middle - 0.5), axis=0) < 1 / 6
    kept = ring.t[:, ~hole]
    inner = np.array([[0.45, 0.45], [0.55, 0.45], [0.5, 0.55]]).T
    p = np.hstack([ring.p, inner, inner + np.array([[2], [0]])])
    n = ring.p.shape[1]
    t = np.hstack([kept, [[n, n + 3], [n + 1, n + 4], [n + 2, n + 5]]])
    assert fault(MeshTri(p, t)) is None
    bow = np.array([[0.0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    assert fault(MeshTri(bow.T.copy(), np.array([[0, 1, 2], [0, 3, 4]]).T.copy())) is None


@pytest.mark.parametrize("seed", range(4))
def test_random_meshes_are_sound_before_and_after_random_moves(seed: int) -> None:
    problem = random_problem(seed)
    assert fault(problem.mesh) is None
    rng = np.random.default_rng(seed)
    p = problem.mesh.p.copy()
    inside = problem.mesh.interior_nodes()
    p[:, inside] += 0.02 * rng.standard_normal((2, inside.size)) * np.sqrt(np.min(np.ptp(p, axis=1)))
    moved = MeshTri(p, problem.mesh.t)
    corner = p[:, moved.t]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    if np.min(a[0] * b[1] - a[1] * b[0]) > 0:
        assert fault(moved) is None
