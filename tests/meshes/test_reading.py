"""Meshes in and out: repairs are said, errors are named, names survive."""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
from skfem import MeshQuad, MeshTri

from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.meshes import MeshRepairWarning, from_arrays, named, read_mesh
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import half_disc, l_shape, plate_with_hole, polygon, rectangle, wedge_block

SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
HALVES = [[0, 1, 2], [0, 2, 3]]


def test_arrays_become_a_mesh_with_names() -> None:
    mesh = from_arrays(SQUARE, HALVES, {"left": [(3, 0)], "low": lambda x: x[1] == 0}, {"upper": [1]})
    assert isinstance(mesh, MeshTri)
    assert mesh.facets[:, mesh.boundaries["left"]].T.tolist() == [[0, 3]]
    assert mesh.facets[:, mesh.boundaries["low"]].T.tolist() == [[0, 1]]
    assert mesh.subdomains["upper"].tolist() == [1]


def test_repairs_are_said_and_keep_names() -> None:
    nodes = [*SQUARE, [7.0, 7.0], [1.0, 1.0 + 1e-13]]
    with pytest.warns(MeshRepairWarning) as caught:
        mesh = from_arrays(nodes, [[0, 2, 1], [0, 5, 3]], {"top": [(5, 3)]})
    said = " | ".join(str(w.message) for w in caught)
    assert "merged 1 duplicate node" in said
    assert "dropped 1 node" in said
    assert "turned 1 clockwise triangle" in said
    assert mesh.p.shape == (2, 4)
    assert np.all(np.abs(signed_areas(mesh.p, mesh.t)) == 0.5)
    assert mesh.p[:, mesh.facets[:, mesh.boundaries["top"]]].mean(axis=1).ravel().tolist() == [0.5, 1.0]


@pytest.mark.filterwarnings("ignore::rmesh_nlp.meshes.MeshRepairWarning")
@pytest.mark.parametrize(
    ("nodes", "triangles", "names", "message"),
    [
        ([[0, 0, 0]], HALVES, {}, r"shape \(nodes, 2\), got \(1, 3\)"),
        ([[0, 0], [1, np.nan], [1, 1], [0, 1]], HALVES, {}, "node 1 is at"),
        (SQUARE, [[0, 1, 2, 3]], {}, r"shape \(elements, 3\), got \(1, 4\)"),
        (SQUARE, [[0, 1, 9]], {}, r"triangle 0 has nodes \[0, 1, 9\]"),
        (SQUARE, [[0.0, 1.0, 2.0]], {}, "node numbers"),
        (SQUARE, [[0, 1, 1]], {}, "triangle 0 has a repeated node"),
        ([[0, 0], [1, 0], [2, 0], [0, 1]], [[0, 1, 2], [0, 1, 3]], {}, "triangle 0 has no area"),
        (SQUARE, [[0, 1, 2], [0, 1, 3]], {}, "triangles overlap at the edge between nodes 0 and 1"),
        (SQUARE, HALVES, {"up": []}, "the boundary 'up' is empty"),
        (SQUARE, HALVES, {"up": lambda x: x[1] > 2}, "the boundary 'up' is empty"),
        (SQUARE, HALVES, {"up": [(1, 3)]}, r"has the edge \(1, 3\), which is no edge of a triangle"),
    ],
)
def test_bad_arrays_are_named(nodes: object, triangles: object, names: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_arrays(nodes, triangles, names)


def sample() -> MeshTri:
    mesh = named(rectangle(4, 3), {"part_of_top": lambda p: (p[1] == 1) & (p[0] > 0.5)})
    return named(mesh, subdomains={"west": lambda p: p[0] < 0.5, "east": lambda p: p[0] > 0.5})


@pytest.mark.parametrize("suffix", ["msh", "vtu", "vtk"])
def test_names_survive_a_file(tmp_path: Path, suffix: str) -> None:
    mesh, path = sample(), tmp_path / f"mesh.{suffix}"
    write_mesh(mesh, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", MeshRepairWarning)
        back = read_mesh(path)
    for before, after, cells in (
        (mesh.boundaries, back.boundaries, (mesh.facets, back.facets)),
        (mesh.subdomains, back.subdomains, (mesh.t, back.t)),
    ):
        assert set(before) == set(after)
        for name in before:
            # cells may be numbered anew, places may not
            places = [p[:, c[:, i]].mean(axis=1) for p, c, i in
                      ((mesh.p, cells[0], before[name]), (back.p, cells[1], after[name]))]  # fmt: skip
            np.testing.assert_allclose(*(np.array(sorted(map(tuple, x.T))) for x in places))


def test_groups_of_gmsh_without_names_get_numbers(tmp_path: Path) -> None:
    path = tmp_path / "plain.msh"
    cells = [("triangle", np.array(HALVES)), ("line", np.array([[0, 1], [2, 3]]))]
    tags = [np.array([5, 5]), np.array([7, 8])]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    points = np.column_stack([SQUARE, np.zeros(4)])
    meshio.Mesh(points, cells, cell_data=data).write(path, file_format="gmsh22", binary=False)
    mesh = read_mesh(path)
    assert set(mesh.boundaries) == {"boundary-7", "boundary-8"}
    assert mesh.subdomains["subdomain-5"].tolist() == [0, 1]


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    quads = tmp_path / "quads.vtu"
    MeshQuad().refined(1).save(quads)
    with pytest.raises(ValueError, match=r"quads.vtu: has 4 cells of type 'quad'"):
        read_mesh(quads)
    bent = tmp_path / "bent.vtu"
    meshio.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]], [("triangle", HALVES)]).write(bent)
    with pytest.raises(ValueError, match=r"is not plane: z runs from 0\.0 to 1\.0"):
        read_mesh(bent)
    points = tmp_path / "points.vtu"
    meshio.Mesh([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])]).write(points)
    with pytest.raises(ValueError, match="has no triangles"):
        read_mesh(points)
    for name in ("no.msh", "no.txt"):
        with pytest.raises(ValueError, match=f"{name}: cannot be read as a mesh"):
            read_mesh(tmp_path / name)


INP = "*NODE\n1, 0, 0\n2, 1, 0\n3, 0, 1\n*ELEMENT, TYPE=CPS3, ELSET=BODY\n1, 1, 2, 3\n"
INP_READ, XDMF_READ = "of the format abaqus: ", "of the format xdmf: "


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.inp", INP.replace("2, 1, 0", "2, 1, x"), INP_READ + "' x' stands where a number is expected"),
        ("a.inp", INP.replace("1, 1, 2, 3", "1, 1, 2, 9"), INP_READ + "9 is missing in it"),
        ("a.inp", INP.replace("CPS3", "FOO"), INP_READ + "Element type not available: FOO"),
        ("a.inp", INP + "*ELSET, ELSET=A\n1\n*ELSET, ELSET=B\nA, A\n", "the set 'B' is no list of cells"),
        ("a.inp", "\xff\x00", INP_READ + "it is not a text file"),
        ("a.xdmf", "", "it is empty"),
        ("a.xdmf", "<Xdmf>", XDMF_READ + "it is no XML at line 1, column 6"),
        ("a.xdmf", "<Xdmf/>", XDMF_READ + "Version is missing in it"),
        ("a.xdmf", '<Xdmf Version="9.0"/>', XDMF_READ + "Unknown XDMF version 9.0"),
        ("a.h5m", "x", "of the format h5m: this format needs the package h5py: pip install h5py"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_says_why_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    name: str, content: str, reason: str,
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / name).write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=re.escape(reason)) as caught:
        read_mesh(tmp_path / name)
    said = str(caught.value)
    assert said.startswith(str(tmp_path / name))
    assert "\n" not in said
    assert re.search("export it again|pip install|leave it out", said)
    assert capfd.readouterr() == ("", "")  # nor by meshio


def test_shapes_have_their_names_and_the_right_areas() -> None:
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError):  # its library needs libGLU
        pytest.skip("gmsh is not installed")
    cases = [
        (l_shape(0.3), 3.0, {"corner", "outer"}),
        (plate_with_hole(1.0), 100 - np.pi * 2.5**2, {"left", "right", "bottom", "top", "hole"}),
        (half_disc(0.1, contact=0.2, h_contact=0.05), np.pi / 4, {"axis", "top", "arc", "contact"}),
        (wedge_block(0.3, rise=0.2), 4 * (1 - 0.1), {"left", "right", "top", "wedge"}),
        (polygon([(0, 0), (2, 0), (0, 2)], 0.5), 2.0, {"edge-0", "edge-1", "edge-2"}),
    ]
    for mesh, area, names in cases:
        found = np.abs(signed_areas(mesh.p, mesh.t)).sum()
        assert found == pytest.approx(area, rel=2e-2)  # chords for arcs
        assert set(mesh.boundaries) == names
        facets = np.concatenate([mesh.boundaries[name] for name in names])
        assert set(facets) == set(mesh.boundary_facets())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rectangle(0, 2), "nx must be a whole number of at least 1, got 0"),
        (lambda: rectangle(2, 2, x=(1, 0)), "x must be two increasing numbers"),
        (lambda: rectangle(2, 2, diagonal="both"), "got 'both'"),
        (lambda: rectangle(10**4, 10**4), "more than 1e"),
        (lambda: plate_with_hole(1.0, radius=6.0), "radius 6.0 does not fit"),
        (lambda: l_shape(-1.0), "h must be positive, got -1.0"),
        (lambda: polygon([(0, 0), (1, 1), (1, 0), (0, 1)], 1e-9), "more than 1e"),
    ],
)
def test_bad_shapes_are_named(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
