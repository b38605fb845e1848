"""Mesh files: names survive, files of unknown origin are refused in one line, readers without end stopped."""

import contextlib
import re
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.meshes import MeshRepairWarning, named
from rmesh_nlp.meshes.geometry import signed_areas
from support.formulations import joint

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("write", "suffix"),  # scikit-fem keeps names in data of elements, in files of gmsh as well
    [
        *((write_mesh, suffix) for suffix in ("msh", "vtu", "vtk")),
        (MeshTri.save, "msh"),
        (MeshTri.save, "vtk"),
    ],
)
def test_names_survive_a_file(tmp_path: Path, write: Any, suffix: str) -> None:
    halves = {"west": lambda p: p[0] < 0.5, "east": lambda p: p[0] > 0.5}
    mesh = named(rm.shapes.rectangle(4, 3), {"part": lambda p: (p[1] == 1) & (p[0] > 0.5)}, halves)
    path = tmp_path / f"a.{suffix}"
    write(mesh, path)
    with pytest.raises(rm.BadInputError, match="nowhere"):
        write_mesh(mesh, tmp_path / "nowhere" / path.name)
    with warnings.catch_warnings():
        warnings.simplefilter("error", MeshRepairWarning)
        back = rm.read_mesh(path)

    def places(m: Any) -> dict[str, list]:
        """Middles of what has a name: cells may be numbered anew."""
        groups = [(m.boundaries, m.facets), (m.subdomains, m.t)]
        cells = {name: m.p[:, c[:, i]].mean(axis=1) for names, c in groups for name, i in names.items()}
        return {name: sorted(map(tuple, np.round(middle.T, 12).tolist())) for name, middle in cells.items()}

    assert places(back) == places(mesh)


def test_groups_without_names_get_numbers(tmp_path: Path) -> None:
    cells = [("triangle", HALVES), ("line", np.array([[0, 1], [2, 3]]))]
    tags = [np.array([5, 0]), np.array([7, 8])]
    gmsh = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.Mesh(SQUARE, cells, cell_data=gmsh).write(tmp_path / "a.msh", file_format="gmsh22", binary=False)
    meshio.Mesh(SQUARE, cells, cell_data={"medit:ref": tags}).write(tmp_path / "a.mesh")
    for name in ("a.msh", "a.mesh"):
        mesh = rm.read_mesh(tmp_path / name)
        edges = {name: mesh.facets[:, facets].T.tolist() for name, facets in mesh.boundaries.items()}
        assert edges == {"boundary-7": [[0, 1]], "boundary-8": [[2, 3]]}
        assert {name: t.tolist() for name, t in mesh.subdomains.items()} == {"subdomain-5": [0]}


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    meshio.Mesh(np.eye(4, 3), [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "solid.vtu")
    bent = SQUARE + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0]])
    meshio.Mesh(bent, [("triangle", HALVES)]).write(tmp_path / "bent.vtu")
    meshio.Mesh(SQUARE, [("line", [[0, 1]])]).write(tmp_path / "points.vtu")
    tags = {"gmsh:physical": [np.array([1])], "gmsh:geometrical": [np.array([1])]}
    lines = meshio.Mesh(SQUARE, [("line", np.array([[0, 1]]))], cell_data=tags)
    lines.write(tmp_path / "lines.msh", file_format="gmsh22", binary=False)
    (tmp_path / "a.xyz").write_text("$MeshFormat")
    (tmp_path / "folder.vtk").mkdir()
    for name, message in {
        "solid.vtu": r"has cells of type 'tetra': only points, lines, triangles and quadrilaterals",
        "bent.vtu": r"is not plane: z runs from 0\.0 to 1\.0",
        "points.vtu": "has no triangles or quadrilaterals: export the surface too",
        "lines.msh": "has no triangles or quadrilaterals: .*gmsh saves only what is in a physical group",
        "no.msh": "cannot be read as a mesh: there is no such file",
        "folder.vtk": "cannot be read as a mesh: there is no such file",
        "a.xyz": r"cannot be read as a mesh: unknown extension '\.xyz': choose from",
    }.items():
        with pytest.raises(ValueError, match=f"{name}: {message}"):
            rm.read_mesh(tmp_path / name)


CORNERS = "*NODE\n1, 0, 0\n2, 1, 0\n3, 1, 1\n4, 0, 1\n"
INP = CORNERS + "*ELEMENT, TYPE=CPS3, ELSET=body\n1, 1, 2, 3\n2, 1, 3, 4\n"
XDMF_READ = "of the format xdmf ("
OLD = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n"
OLD += "$Elements\n1\n1 2 0 1 2 3\n$EndElements\n"


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.inp", INP.replace("2, 1, 0", "2, 1, x"), "*NODE: could not convert string to float: 'x'"),
        ("a.inp", INP.replace("1, 1, 2, 3", "1, 1, 2, 9"), "the node 9 of an element is missing"),
        ("a.inp", INP.replace("CPS3", "C3D4"), "*ELEMENT: elements of the type C3D4: only points, lines"),
        ("a.inp", INP + "*ELSET, ELSET=B\nA\n", "*ELSET B: there is no ELSET A before it"),
        ("a.inp", INP + "*ELGEN\n1, 2\n", "*ELGEN: makes or moves nodes or elements"),
        ("a.inp", INP + "*INSTANCE, NAME=a\n1, 0\n", "*INSTANCE: makes or moves nodes"),
        ("a.inp", "*PART\n*END PART\n*Part\n", "*PART: is there twice: one part with one instance"),
        ("a.inp", "*INCLUDE, INPUT=b.inp\n", "b.inp: put this file there"),
        ("a.inp", "*INCLUDE, INPUT=a.inp\n", "let none include itself"),
        ("a.inp", "\xff\x00", "has no triangles or quadrilaterals: export the surface too"),
        ("a.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n2 1", "is damaged or ends early"),
        ("a.msh", "$MeshFormat\n4 0 8\n$EndMeshFormat\n", "is damaged or ends early"),
        ("a.msh", "$MeshFormat\n4 1 8\n\1\0\0\0\n$EndMeshFormat\n", "gmsh OLD.msh -save -format msh41"),
        ("a.msh", OLD.replace("0 0 0\n2", "0 0\n2"), "cannot be read: "),
        ("a.msh", OLD.replace("2 1 0 0", "2 nan 0 0"), "node 1 is at (nan, 0.0)"),
        ("a.msh", OLD.replace("1 2 0 1 2 3", "1 2 0 1 2 9"), "the node 9 of an element is missing"),
        ("a.msh", OLD.replace("1 2 0 1 2 3", "1 2 7 1 2 3"), "cannot be read: "),
        ("a.msh", OLD.replace("1 2 0 1 2 3", "1 4 0 1 2 3"), "has elements of gmsh's type 4: only points"),
        ("a.msh", OLD.replace("Nodes", "Node"), "is damaged or ends early"),
        ("a.msh", OLD.replace("\n1\n1 2 0", "\n2\n1 2 0"), "is damaged or ends early"),
        ("a.msh", OLD.partition("$EndElements")[0], "is damaged or ends early: write it again with gmsh"),
        ("a.msh", '(0 "Fluent")\n(2 2)', "of the format ansys ("),
        ("a.unv", "    -1\n  2411\n", "of the format unv (BadInputError: it ends within a section)"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "the node 9 of an element is missing"),
        ("a.xdmf", "", "it is empty: write it again"),
        ("a.xdmf", "<Xdmf>", XDMF_READ + "ParseError: no element found"),
        ("a.xdmf", '<Xdmf Version="9.0"/>', XDMF_READ + "ReadError: Unknown XDMF version 9.0"),
        ("a.h5m", "x", "of the format h5m (ModuleNotFoundError: No module named 'h5py')"),
    ],
)
def test_a_file_that_cannot_be_read_says_why_in_one_line(tmp_path, capfd, name, content, reason):
    if name == "a.h5m" and find_spec("h5py"):
        pytest.skip("h5py is installed")
    (tmp_path / name).write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=re.escape(reason)) as caught:
        rm.read_mesh(tmp_path / name)
    said = str(caught.value)
    assert said.startswith(str(tmp_path / name))
    assert "\n" not in said
    assert capfd.readouterr() == ("", "")  # nor by meshio


@pytest.mark.slow
def test_joint_beats_the_published_energy_of_a_stretched_plate_with_valid_elements() -> None:
    """The mesh of the h- and r-adaptivity tests of NeuROM-Py, which stops at 0.8375033 with two slivers."""
    bottom, right, top, left, hole = (f"boundary-{i}" for i in (111, 112, 113, 114, 115))
    problem = rm.ContactProblem(
        mesh=rm.read_mesh(Path(__file__).parents[1] / "data" / "plate_484.msh"),
        law=rm.PlaneStrain(lame_lambda=1.25, lame_mu=1.0),
        dirichlet=(bottom, rm.Dirichlet(top, (0.0, 1.0))),
        motion=rm.Motion(None, pinned=(bottom, right, top, left, hole), min_area_fraction=0.01),
    )
    solution = joint.solve(problem)
    assert solution.success
    assert solution.energy_initial == pytest.approx(0.8419724, abs=5e-8)
    assert solution.energy <= 0.83739
    # no body force, so no quadrature: the audited energy is the same number
    assert solution.energy_audited == pytest.approx(solution.energy, rel=1e-12)
    assert solution.assessment.final.min_area_ratio >= 0.01


def test_a_set_of_several_blocks_is_read_whole(tmp_path) -> None:
    """gmsh writes a block for each curve to .inp, and a set for the group of them."""
    edges = "".join(f"*ELEMENT, type=T3D2, ELSET=Line{k}\n{k}, {k}, {k + 1}\n" for k in (1, 2, 3))
    faces = "".join(
        f"*ELEMENT, type=CPS3, ELSET=Surface{k}\n{k}, {corners}\n"
        for k, corners in ((4, "1, 2, 3"), (5, "1, 3, 4"))
    )
    path = tmp_path / "a.inp"
    path.write_text(f"{CORNERS}{edges}{faces}*ELSET, ELSET=held\n1, 3\n*ELSET, ELSET=body\n4, 5\n")
    mesh = rm.read_mesh(path)
    assert mesh.facets[:, mesh.boundaries["held"]].T.tolist() == [[0, 1], [2, 3]]
    assert mesh.subdomains["body"].tolist() == [0, 1]


def test_a_set_of_nodes_is_the_boundary_of_the_outer_edges_between_them(tmp_path) -> None:
    """The diagonal from node 1 to node 3 is inside; one node makes no edge."""
    path = tmp_path / "a.inp"
    path.write_text(f"{INP}*NSET, NSET=CORNER\n1, 2, 3\n*NSET, NSET=ONE\n4\n")
    mesh = rm.read_mesh(path)
    assert {*mesh.boundaries} == {"CORNER"}
    assert sorted(mesh.facets[:, mesh.boundaries["CORNER"]].T.tolist()) == [[0, 1], [1, 2]]


NAMES = '$PhysicalNames\n4\n1 1 "{curve}"\n1 2 "low"\n2 3 "half"\n2 4 "whole"\n$EndPhysicalNames\n'
MSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
{names}$Entities
0 2 2 0
1 0 0 0 1 0 0 2 1 2 0
2 1 0 0 1 1 0 1 2 0
1 0 0 0 1 1 0 2 3 4 0
2 0 0 0 1 1 0 1 4 0
$EndEntities
$Nodes
1 4 1 4
2 1 0 4
1
2
3
4
0 0 0
1 0 0
1 1 0
0 1 0
$EndNodes
$Elements
4 4 1 4
1 1 1 1
1 1 2
1 2 1 1
2 2 3
2 1 2 1
3 1 2 3
2 2 2 1
4 1 3 4
$EndElements
"""


def test_entities_in_two_groups_of_gmsh_are_in_both(tmp_path: Path) -> None:
    """Groups that have one name are joined, in one dimension alone."""
    path = tmp_path / "a.msh"
    for names, edges, elements in (
        (NAMES.format(curve="foot"), {"foot": 1, "low": 2}, {"half": 1, "whole": 2}),
        (NAMES.format(curve="whole"), {"whole": 1, "low": 2}, {"half": 1, "whole": 2}),
        ("", {"boundary-1": 1, "boundary-2": 2}, {"subdomain-3": 1, "subdomain-4": 2}),
    ):
        path.write_text(MSH.format(names=names))
        mesh = rm.read_mesh(path)
        assert {name: part.size for name, part in mesh.boundaries.items()} == edges
        assert {name: part.size for name, part in mesh.subdomains.items()} == elements


KINDS_OF_FILES = {
    "text": {},
    "binary": {"Mesh.Binary": 1},
    "with all elements": {"Mesh.SaveAll": 1},
    "with parameters": {"Mesh.SaveParametric": 1},
    "of version 1": {"Mesh.MshFileVersion": 1, "Mesh.SaveParametric": 1},
    "of version 2.2": {"Mesh.MshFileVersion": 2.2},
    "binary of version 2.2": {"Mesh.MshFileVersion": 2.2, "Mesh.Binary": 1},
    "of version 2.2 with parameters": {"Mesh.MshFileVersion": 2.2, "Mesh.SaveParametric": 1},
        "of version 4.0": {"Mesh.MshFileVersion": 4.0},
    "of version 4.0 with parameters": {"Mesh.MshFileVersion": 4.0, "Mesh.SaveParametric": 1},
    "UNV": {"suffix": "unv"},
    "MED": {"suffix": "med"},
}  # fmt: skip


@pytest.mark.parametrize("options", KINDS_OF_FILES.values(), ids=KINDS_OF_FILES)
@pytest.mark.parametrize(
    "made", ["triangles", "quadrilaterals", "order 2", "order 3", "partitioned", "upright"]
)
def test_files_of_gmsh_are_read_with_all_groups(tmp_path: Path, made: str, options: dict) -> None:
    """A square in two halves: the foot is a part of the bottom, both halves are the body."""
    if made == "order 3" and "suffix" in options:
        pytest.skip("UNV and MED end at order 2")
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for name, value in ((name, value) for name, value in options.items() if "." in name):
            gmsh.option.setNumber(name, value)
        gmsh.option.setNumber("Mesh.RecombineAll", made == "quadrilaterals")
        geo, add = gmsh.model.geo, gmsh.model.addPhysicalGroup
        places = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)]
        points = [
            geo.addPoint(x, 0, y, 0.5) if made == "upright" else geo.addPoint(x, y, 0, 0.5) for x, y in places
        ]
        lines = [geo.addLine(a, b) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
        middle = geo.addLine(points[1], points[4])
        left = geo.addPlaneSurface([geo.addCurveLoop([lines[0], middle, lines[4], lines[5]])])
        right = geo.addPlaneSurface([geo.addCurveLoop([lines[1], lines[2], lines[3], -middle])])
        geo.synchronize()
        groups = {
            (1, "bottom"): lines[:2],
            (1, "foot"): lines[:1],
            (2, "body"): [left, right],
            (2, "foot"): [left],
        }
        for (dimension, name), entities in groups.items():
            add(dimension, entities, name=name)
        gmsh.model.mesh.generate(2)
        if made.startswith("order"):
            gmsh.model.mesh.setOrder(int(made[-1]))
        if made == "partitioned":
            gmsh.model.mesh.partition(2)
        gmsh.write(str(path := tmp_path / f"a.{options.get('suffix', 'msh')}"))
    finally:
        gmsh.finalize()
    said = {
        "quadrilaterals": "cut",
        "order 2": "took of elements of higher order the corners",
        "order 3": "took of elements of higher order the corners",
        "upright": "its x-z plane is taken",
    }
    with pytest.warns(MeshRepairWarning, match=said[made]) if made in said else contextlib.nullcontext():
        mesh = rm.read_mesh(path)
    has_names = options.get("Mesh.MshFileVersion") != 1
    bottom, foot, body, half = [
        ("boundary-1", "boundary-2", "subdomain-3", "subdomain-4"), ("bottom", "foot", "body", "foot")
    ][has_names]  # fmt: skip
    assert {name: part.size for name, part in mesh.boundaries.items()} == {bottom: 4, foot: 2}
    areas = np.abs(signed_areas(mesh.p, mesh.t))
    assert np.sum(areas) == pytest.approx(2)
    assert {name: np.sum(areas[part]) for name, part in mesh.subdomains.items()} == pytest.approx(
        {body: 2, half: 1}
    )


@pytest.mark.slow
def test_a_reader_that_finds_no_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """meshio reads .off to its end or for ever; of a whole one there are no names."""
    whole = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"
    path = tmp_path / "a.off"
    path.write_text(whole)
    assert rm.read_mesh(path).nelements == 2
    monkeypatch.setattr("rmesh_nlp.by_meshio.SECONDS", 0.1)
    path.write_text("OFF\n")
    with pytest.raises(ValueError, match=r"of the format off \(time_limit\): if it is not damaged, write it"):
        rm.read_mesh(path)


NASTRAN = """GRID    1               0.      0.      0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
CROD,9,4,1,2
CTRIA3  1       7       1       2       3       0.0
ENDDATA
"""
SU2 = """% a comment
NDIME= 2
NELEM= 1 % another one
5 0 1 2 0
NPOIN = 3 3
0 0 0\n1 0 1\n1 1 2
NMARK= 3
MARKER_TAG= 2\nMARKER_ELEMS= 1\n3 0 1
MARKER_TAG= lower wall\nMARKER_ELEMS= 1\n3 1 2
MARKER_TAG= 1\nMARKER_ELEMS = 1\n3 2 0
"""


@pytest.mark.parametrize(
    ("name", "content", "edges"),
    [
        ("a.bdf", NASTRAN, {"boundary-4": [0, 1]}),
        ("a.nas", f"SOL 101\nCEND\nBEGIN BULK\n{NASTRAN}", {"boundary-4": [0, 1]}),
        ("a.su2", SU2, {"2": [0, 1], "lower wall": [1, 2], "1": [0, 2]}),
    ],
)
def test_names_of_nastran_and_su2(tmp_path: Path, name: str, content: str, edges: dict) -> None:
    """Properties are numbers, markers words or numbers; what ends early is refused."""
    (tmp_path / name).write_text(content)
    mesh = rm.read_mesh(tmp_path / name)
    assert {name: mesh.facets[:, one].ravel().tolist() for name, one in mesh.boundaries.items()} == edges
    (tmp_path / name).write_text(content[:-9])
    with pytest.raises(ValueError, match=r"no line ENDDATA|of the format su2"):
        rm.read_mesh(tmp_path / name)


@pytest.mark.parametrize(
    "card",
    ["CPLSTN3 2       7       1       2       3", "GRID    4       2       2.      0.", "GRID,4,2,2.,0."],
)
def test_cards_of_nastran_that_would_be_passed_over_are_refused(tmp_path: Path, card: str) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(f"{card}\n{NASTRAN}")
    with pytest.raises(ValueError, match="write CTRIA3 or CQUAD4, and GRID in the global system"):
        rm.read_mesh(path)


def test_a_file_of_one_part_of_a_mesh_of_gmsh_is_refused(tmp_path: Path) -> None:
    """Surfaces 1 and 2 have the group 7, the elements of the second are in another file."""
    entities = "0 0 2 0\n1 0 0 0 1 1 0 1 7 0\n2 1 0 0 2 1 0 1 7 0"
    nodes = "1 3 1 3\n2 1 0 3\n1\n2\n3\n0 0 0\n1 0 0\n1 1 0"
    sections = {"MeshFormat": "4.1 0 8", "Entities": entities, "Nodes": nodes}
    sections["Elements"] = "1 1 1 1\n2 1 2 1\n1 1 2 3"
    path = tmp_path / "a.msh"
    text = "".join(f"${name}\n{content}\n$End{name}\n" for name, content in sections.items())
    path.write_text(text)
    with pytest.raises(ValueError, match="surface 2 of a physical group has no elements"):
        rm.read_mesh(path)
    path.write_text(text.replace("2 1 0 1 7 0", "2 1 0 0 0"))  # it is in no group
    assert rm.read_mesh(path).nelements == 1


def test_names_that_no_edge_has_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    path.write_text(MSH.format(names=NAMES.format(curve="foot").replace("4\n1 1", '5\n0 9 "corner"\n1 1')))
    with pytest.warns(MeshRepairWarning, match="left out what names no edge or triangle: corner"):
        rm.read_mesh(path)


def test_quadrilaterals_are_cut_along_the_shorter_diagonal(tmp_path: Path) -> None:
    skewed = np.array([[0, 0, 0], [1, 0, 0], [1.5, 1, 0], [0.5, 1, 0]])
    meshio.Mesh(skewed, [("quad", [[0, 1, 2, 3]])]).write(tmp_path / "a.vtu")
    with pytest.warns(MeshRepairWarning, match="cut 1 quadrilaterals into triangles"):
        mesh = rm.read_mesh(tmp_path / "a.vtu")
    assert [1, 3] in mesh.facets.T.tolist()


PART = """*Heading
*Part, name=P
*Node, nset="Every node"
1, 0., 0.
2, 1., 0.
*NODE
3, 1., 1.
4,   , 1.
*Element, type=CPE3,
 elset=half
7, 1, 2, 3
*Element, type=CPE3R
8, 1, 3, 4
*Element, TYPE=T2D2, ELSET=bar
9, 3, 4
*Elset, elset=both, generate
7, 8
*ELSET, ELSET=ALL
both
*Nset, nset=low, elset=half
*End Part
*Instance, name=P-1, part=P
*End Instance
*Nset, nset=left, instance=P-1
1, 4
*Nset, nset=left
P-1.4
*Surface, type=ELEMENT, name=right
half, S2
*Surface, name=free
ALL,
*Surface, type=NODE, name=top
bar_nodes
*Step
*Node Print, nset=left
"""


def test_files_of_abaqus_are_read_with_all_sets(tmp_path: Path) -> None:
    """Any case, continued lines, sets of sets, surfaces, a part with an instance, an included file."""
    (tmp_path / "more.inp").write_text("** comment\n*NSET, NSET=bar_nodes, ELSET=bar\n")
    path = tmp_path / "a.inp"
    path.write_text(
        PART.replace("*Surface, type=ELEMENT", "*Include, input=more.inp\n*Surface, type=ELEMENT")
    )
    mesh = rm.read_mesh(path)
    edges = {
        name: sorted(map(tuple, mesh.facets[:, part].T.tolist())) for name, part in mesh.boundaries.items()
    }
    around = [(0, 1), (0, 3), (1, 2), (2, 3)]
    assert edges == {
        "Every node": [(0, 1)], "low": [(0, 1), (1, 2)], "left": [(0, 3)], "right": [(1, 2)],
        "free": around, "top": [(2, 3)], "bar": [(2, 3)], "bar_nodes": [(2, 3)],
    }  # fmt: skip
    assert {name: part.tolist() for name, part in mesh.subdomains.items()} == {
        "half": [0], "both": [0, 1], "ALL": [0, 1],
    }  # fmt: skip
    path.write_text(PART.split("*Surface")[0] + "*Nset, nset=low\nP-1.1\n")
    with pytest.raises(ValueError, match="low is a set of the part too"):
        rm.read_mesh(path)
