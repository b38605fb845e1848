"""Meshes from arrays and of simple shapes: repairs are said, errors, overlaps and cracks are named."""

import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.meshes import MeshRepairWarning, from_arrays, named, shapes
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import signed_areas

SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
HALVES = [[0, 1, 2], [0, 2, 3]]


def test_arrays_become_a_mesh_with_names() -> None:
    mesh = from_arrays(SQUARE, HALVES, {"left": [(3, 0)], "low": lambda x: x[1] == 0}, {"upper": [1]})
    assert isinstance(mesh, MeshTri)
    mesh = named(mesh, {"diagonal": [(0, 2)]}, {"lower": lambda x: x[1] < 0.5})
    edges = {name: mesh.facets[:, facets].T.tolist() for name, facets in mesh.boundaries.items()}
    assert edges == {"left": [[0, 3]], "low": [[0, 1]], "diagonal": [[0, 2]]}
    assert {name: t.tolist() for name, t in mesh.subdomains.items()} == {"upper": [1], "lower": [0]}


def test_repairs_are_said_and_keep_names() -> None:
    # node 4 is used by no triangle, node 5 is node 2, the first triangle is clockwise
    nodes = [*SQUARE, [7.0, 7.0], [1.0, 1.0 + 1e-13]]
    with pytest.warns(MeshRepairWarning) as caught:
        mesh = from_arrays(nodes, [[0, 2, 1], [0, 5, 3]], {"top": [(5, 3)]})
    assert [str(w.message) for w in caught] == [
        "merged 1 duplicate nodes",
        "dropped 1 nodes that belong to no triangle",
        "turned 1 clockwise triangles",
    ]
    assert mesh.p.T.tolist() == SQUARE
    assert signed_areas(mesh.p, mesh.t).tolist() == [0.5, 0.5]
    assert mesh.p[:, mesh.facets[:, mesh.boundaries["top"]]].mean(axis=1).ravel().tolist() == [0.5, 1.0]


def test_only_rounding_of_the_size_is_no_area() -> None:
    assert from_arrays([[0, 0], [1, 0], [0.5, 1e-5]], [[0, 1, 2]]).t.shape[1] == 1
    with pytest.raises(ValueError, match="element 0 has no area"):
        from_arrays([[0, 0], [1, 0], [0.5, 1e-14]], [[0, 1, 2]])


@pytest.mark.filterwarnings("ignore::rmesh_nlp.meshes.MeshRepairWarning")
@pytest.mark.parametrize(("gap", "left"), [(0.9e-9, 4), (1.1e-9, 5)])
def test_nodes_closer_than_rounding_of_the_size_are_one(gap: float, left: int) -> None:
    nodes = 1e3 * np.array([*SQUARE, [1.0, 1.0 + gap]])
    assert from_arrays(nodes, [[0, 1, 2], [0, 4, 3]]).p.shape[1] == left


@pytest.mark.filterwarnings("ignore::rmesh_nlp.meshes.MeshRepairWarning")
@pytest.mark.parametrize(
    ("nodes", "triangles", "names", "message"),
    [
        ([[0, 0, 0]], HALVES, {}, r"shape \(nodes, 2\), got \(1, 3\)"),
        ([[0, 0], [1, np.nan], [1, 1], [0, 1]], HALVES, {}, r"node 1 is at \(1.0, nan\)"),
        (SQUARE, [[0, 1, 2, 3]], {}, r"shape \(elements, 3\), got \(1, 4\)"),
        (SQUARE, [], {}, r"shape \(elements, 3\), got \(0,\)"),
        (SQUARE, [[0, 1, 2], [0, 1, 4]], {}, r"triangle 1 has nodes \[0, 1, 4\], but nodes run from 0 to 3"),
        (SQUARE, [[0, 1, -1]], {}, r"triangle 0 has nodes \[0, 1, -1\]"),
        (SQUARE, [[0.0, 1.0, 2.0]], {}, "node numbers, got values of type float64"),
        (SQUARE, [[0, 1, 1]], {}, "triangle 0 has a repeated node"),
        ([[0, 0], [1, 0], [2, 0], [0, 1]], [[0, 1, 2], [0, 1, 3]], {}, "element 0 has no area"),
        (SQUARE, [[0, 1, 2], [0, 1, 3]], {}, "elements overlap at the edge between nodes 0 and 1"),
        (SQUARE, HALVES, {"up": []}, "the boundary 'up' is empty"),
        (SQUARE, HALVES, {"up": lambda x: x[1] > 2}, "the boundary 'up' is empty"),
        (SQUARE, HALVES, {"up": [1, 2]}, r"'up' must be an array of shape \(edges, 2\), got \(2,\)"),
        (SQUARE, HALVES, {"up": [(0, 1), (1, 3)]}, r"has the edge \(1, 3\), which is no edge of a triangle"),
    ],
)
def test_bad_arrays_are_named(nodes: object, triangles: object, names: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_arrays(nodes, triangles, names)


@pytest.mark.parametrize(("members", "message"), [([2], "a triangle that the mesh"), ([], "is empty")])
def test_bad_subdomains_are_named(members: list[int], message: str) -> None:
    with pytest.raises(ValueError, match=f"the subdomain 'x' (has )?{message}"):
        named(from_arrays(SQUARE, HALVES), subdomains={"x": members})


@pytest.mark.parametrize(
    ("make", "area", "names"),
    [
        (lambda: shapes.l_shape(0.3), 3.0, "corner outer"),
        (lambda: shapes.plate_with_hole(1.0), 100 - np.pi * 2.5**2, "left right bottom top hole"),
        (lambda: shapes.half_disc(0.1, contact=0.2, h_contact=0.05), np.pi / 4, "axis top arc contact"),
        (lambda: shapes.wedge_block(0.3, rise=0.2), 4 * (1 - 0.1), "left right top wedge"),
        (lambda: shapes.polygon([(0, 0), (2, 0), (0, 2)], 0.5), 2.0, "edge-0 edge-1 edge-2"),
        (
            lambda: shapes.polygon([(0, 0), (2, 0), (2, 1), (1, 0.5), (0, 1)], 1),
            1.5,
            "edge-0 edge-1 edge-2 edge-3 edge-4",
        ),
    ],
)
def test_shapes_have_their_names_and_the_right_areas(make, area, names):
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError):  # its library needs libGLU
        pytest.skip("gmsh is not installed")
    mesh = make()
    assert np.abs(signed_areas(mesh.p, mesh.t)).sum() == pytest.approx(area, rel=2e-2)  # chords for arcs
    assert set(mesh.boundaries) == set(names.split())
    facets = np.concatenate(list(mesh.boundaries.values()))
    assert sorted(facets) == sorted(mesh.boundary_facets())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rm.shapes.rectangle(0, 2), "nx must be a whole number of at least 1, got 0"),
        (lambda: rm.shapes.rectangle(2, 1.5), "ny must be a whole number of at least 1, got 1.5"),
        (lambda: rm.shapes.rectangle(2, 2, x=(1, 1)), "x must be two increasing numbers"),
        (lambda: rm.shapes.rectangle(2, 2, diagonal="both"), "got 'both'"),
        (lambda: rm.shapes.rectangle(10**3, 501), "about 1.002e[+]06 triangles, more than 1e"),
        (lambda: shapes.plate_with_hole(1.0, radius=5.0), "radius 5.0 does not fit"),
        (lambda: shapes.half_disc(0.1, contact=1.0), "contact half-length 1.0 must be smaller"),
        (lambda: shapes.wedge_block(0.1, rise=1.0), "rise 1.0 must be at least 0 and smaller"),
        (lambda: shapes.l_shape(0.0), "h must be positive and finite, got 0.0"),
        (lambda: shapes.l_shape(2.6e-3), "more than 1e"),
        (lambda: shapes.plate_with_hole(0.015), "more than 1e"),
        (lambda: shapes.wedge_block(3e-3), "more than 1e"),
        (lambda: shapes.half_disc(0.1, h_contact=1.5e-4), "more than 1e"),
        (lambda: shapes.polygon([(0, 0), (1, 0)], 0.1), "3 or more finite points"),
        (lambda: shapes.polygon([(0, 0), (1, 0), (0, 1)], 0.1, {"a": [3]}), "edge 3; edges run to 2"),
        (lambda: shapes.polygon([(0, 0), (1, 1), (1, 0), (0, 1)], 0.3), "edges 0 and 2 of the polygon cross"),
        (
            lambda: shapes.polygon([(0, 0), (4, 0), (4, 4), (2, -1), (0, 4)], 1),
            "edges 0 and 2 of the polygon",
        ),
        (lambda: shapes.polygon([(0, 0), (1, 0), (1, 1), (0, 1)], 1e-9), "more than 1e"),
    ],
)
def test_bad_shapes_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_boundaries_of_meshes_whose_edges_32_bits_do_not_number() -> None:
    n = 47_000  # most of these nodes belong to no triangle
    assert n**2 > 2**31
    mesh = MeshTri(np.random.default_rng(0).uniform(size=(2, n)), np.array([[0], [n - 2], [n - 1]], np.int32))
    found = named(mesh, {"side": [(n - 1, n - 2)]})
    assert found.facets[:, found.boundaries["side"]].ravel().tolist() == [n - 2, n - 1]


SIDE_2 = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
PARTS = np.array([[0, 1, 2], [0, 2, 3]])

# the square next to one whose common side has one node more, at (2, 1)
HANGING = (
    np.vstack([SIDE_2, [[2, 1], [4, 0], [4, 2]]]),
    np.vstack([PARTS, [[1, 5, 4], [4, 5, 6], [4, 6, 2]]]),
)
# a triangle that comes in from outside and shares no node
CROSSING = (np.vstack([SIDE_2, [[1.5, 0.9], [3, 0.8], [3, 1.3]]]), np.vstack([PARTS, [[4, 5, 6]]]))
# the same within one element
WITHIN = (np.vstack([SIDE_2, [[1.5, 0.5], [1.6, 0.5], [1.5, 0.6]]]), np.vstack([PARTS, [[4, 5, 6]]]))


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
    "winding": (twice_around(), "elements 4 and 9 overlap: their edges cross"),
}


@pytest.mark.parametrize("name", WRONG)
def test_arrays_and_problems_are_refused(name: str) -> None:
    (nodes, triangles), message = WRONG[name]
    with pytest.raises(ValueError, match=message):
        from_arrays(nodes, triangles)
    mesh = MeshTri(np.ascontiguousarray(nodes.T), np.ascontiguousarray(triangles.T))
    with pytest.raises(rm.ProblemError, match=message) as caught:
        rm.ContactProblem(mesh.with_boundaries({"left": [0]}), rm.Laplace(1.0), ("left",))
    assert caught.value.place == ("mesh",)


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


def test_pieces_in_holes_beside_each_other_and_touching_in_a_node_are_sound() -> None:
    ring = rm.shapes.rectangle(6, 6)
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
