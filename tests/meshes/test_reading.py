"""Mesh files: names survive, files of unknown origin are refused in one line, readers without end stopped."""

from __future__ import annotations

import contextlib
import re
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from skfem import MeshQuad

from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.meshes import MeshRepairWarning, named
from rmesh_nlp.meshes.groups import check_groups
from rmesh_nlp.meshes.reading import read_file, read_mesh
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, PlaneStrain
from support.formulations import joint

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("suffix", ["msh", "vtu", "vtk"])
def test_names_survive_a_file(tmp_path: Path, suffix: str) -> None:
    halves = {"west": lambda p: p[0] < 0.5, "east": lambda p: p[0] > 0.5}
    mesh = named(rectangle(4, 3), {"part": lambda p: (p[1] == 1) & (p[0] > 0.5)}, halves)
    path = tmp_path / f"a.{suffix}"
    write_mesh(mesh, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", MeshRepairWarning)
        back = read_mesh(path)

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
        mesh = read_mesh(tmp_path / name)
        edges = {name: mesh.facets[:, facets].T.tolist() for name, facets in mesh.boundaries.items()}
        assert edges == {"boundary-7": [[0, 1]], "boundary-8": [[2, 3]]}
        assert {name: t.tolist() for name, t in mesh.subdomains.items()} == {"subdomain-5": [0]}


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    MeshQuad().refined(1).save(tmp_path / "quads.vtu")
    bent = SQUARE + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0]])
    meshio.Mesh(bent, [("triangle", HALVES)]).write(tmp_path / "bent.vtu")
    meshio.Mesh(SQUARE, [("line", [[0, 1]])]).write(tmp_path / "points.vtu")
    tags = {"gmsh:physical": [np.array([1])], "gmsh:geometrical": [np.array([1])]}
    lines = meshio.Mesh(SQUARE, [("line", np.array([[0, 1]]))], cell_data=tags)
    lines.write(tmp_path / "lines.msh", file_format="gmsh22", binary=False)
    (tmp_path / "a.xyz").write_text("$MeshFormat")
    (tmp_path / "folder.vtk").mkdir()
    for name, message in {
        "quads.vtu": r"has 4 cells of type 'quad': only triangles with straight edges",
        "bent.vtu": r"is not plane: z runs from 0\.0 to 1\.0",
        "points.vtu": "has no triangles$",
        "lines.msh": "has no triangles: gmsh saves only what is in a physical group",
        "no.msh": "cannot be read as a mesh: there is no such file",
        "folder.vtk": "cannot be read as a mesh: there is no such file",
        "a.xyz": r"cannot be read as a mesh: the extension '\.xyz' is none of",
    }.items():
        with pytest.raises(ValueError, match=f"{name}: {message}"):
            read_mesh(tmp_path / name)


INP = "*NODE\n1, 0, 0\n2, 1, 0\n3, 0, 1\n*ELEMENT, TYPE=CPS3, ELSET=BODY\n1, 1, 2, 3\n"
INP_READ, XDMF_READ = "of the format abaqus: ", "of the format xdmf: "


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.inp", INP.replace("2, 1, 0", "2, 1, x"), INP_READ + "could not convert string to float: ' x'"),
        ("a.inp", INP.replace("1, 1, 2, 3", "1, 1, 2, 9"), INP_READ + "9 is missing in it"),
        ("a.inp", INP.replace("CPS3", "FOO"), INP_READ + "Element type not available: FOO"),
        ("a.inp", INP + "*ELSET, ELSET=A\n1\n*ELSET, ELSET=B\nA, A\n", "the set 'B' is no list of cells"),
        ("a.inp", "\xff\x00", INP_READ + "'utf-8' codec can't decode byte 0xff"),
        ("a.xdmf", "", "it is empty"),
        ("a.xdmf", "<Xdmf>", XDMF_READ + "no element found: line 1, column 6"),
        ("a.xdmf", "<Xdmf/>", XDMF_READ + "Version is missing in it"),
        ("a.xdmf", '<Xdmf Version="9.0"/>', XDMF_READ + "Unknown XDMF version 9.0"),
        ("a.h5m", "x", "of the format h5m: this format needs the package h5py: pip install h5py"),
    ],
)
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "content"),
    [("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"), ("a.off", "OFF\n"), ("a.msh", "garbage")],
)
def test_a_reader_that_never_ends_is_stopped(
    tmp_path: Path, name: str, content: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.3)
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match="cannot be read as a mesh"):
        read_file(tmp_path / name)


def test_readers_are_limited_by_time_of_the_processor_and_run_in_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.02)
    monkeypatch.setattr("meshio.read", lambda *_: time.sleep(0.05) or "a mesh")
    path = tmp_path / "a.vtk"
    path.write_text("x")
    assert read_file(path) == "a mesh"  # it only waited
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(read_file, path).result() == "a mesh"
        monkeypatch.setattr("meshio.read", lambda *_: {}["x"])
        with pytest.raises(ValueError, match="x is missing in it"):
            pool.submit(read_file, path).result()


@pytest.mark.slow
def test_joint_beats_the_published_energy_of_a_stretched_plate_with_valid_elements() -> None:
    """The mesh of the h- and r-adaptivity tests of NeuROM-Py, which stops at 0.8375033 with two slivers."""
    bottom, right, top, left, hole = (f"boundary-{i}" for i in (111, 112, 113, 114, 115))
    problem = ContactProblem(
        mesh=read_mesh(Path(__file__).parents[1] / "data" / "plate_484.msh"),
        law=PlaneStrain(lame_lambda=1.25, lame_mu=1.0),
        dirichlet=(bottom, Dirichlet(top, (0.0, 1.0))),
        motion=Motion(None, pinned=(bottom, right, top, left, hole), min_area_fraction=0.01),
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
    nodes = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 1, 1, 0\n4, 0, 1, 0\n"
    edges = "".join(f"*ELEMENT, type=T3D2, ELSET=Line{k}\n{k}, {k}, {k + 1}\n" for k in (1, 2, 3))
    faces = "".join(
        f"*ELEMENT, type=CPS3, ELSET=Surface{k}\n{k}, {corners}\n"
        for k, corners in ((4, "1, 2, 3"), (5, "1, 3, 4"))
    )
    path = tmp_path / "a.inp"
    path.write_text(
        f"{nodes}{edges}{faces}*ELSET, ELSET=held\n1, 3\n*ELSET, ELSET=body\n4, 5\n", encoding="utf-8"
    )
    mesh = read_mesh(path)
    assert mesh.facets[:, mesh.boundaries["held"]].T.tolist() == [[0, 1], [2, 3]]
    assert mesh.subdomains["body"].tolist() == [0, 1]


def test_a_set_of_nodes_is_the_boundary_of_the_outer_edges_between_them(tmp_path) -> None:
    """The diagonal from node 1 to node 3 is inside; one node makes no edge."""
    path = tmp_path / "a.inp"
    path.write_text(
        "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 1, 1, 0\n4, 0, 1, 0\n*ELEMENT, TYPE=CPS3, ELSET=BODY\n"
        "1, 1, 2, 3\n2, 1, 3, 4\n*NSET, NSET=CORNER\n1, 2, 3\n*NSET, NSET=ONE\n4\n",
        encoding="utf-8",
    )
    mesh = read_mesh(path)
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
    path = tmp_path / "a.msh"
    path.write_text(MSH.format(names=NAMES.format(curve="foot")))
    mesh = read_mesh(path)
    assert {name: part.size for name, part in mesh.boundaries.items()} == {"foot": 1, "low": 2}
    assert {name: part.size for name, part in mesh.subdomains.items()} == {"half": 1, "whole": 2}
    path.write_text(MSH.format(names=""))
    with pytest.raises(ValueError, match=r"a\.msh: one entity is in the physical groups \[1, 2\]: name all"):
        read_mesh(path)
    path.write_text(MSH.format(names=NAMES.format(curve="whole")))
    with pytest.warns(MeshRepairWarning, match="physical groups have one name, whole"):
        read_mesh(path)


def test_entities_are_read_in_both_formats_and_turned_curves_are_in_their_groups(tmp_path: Path) -> None:
    """A point is a place in 4.1 and a box in 4.0; the group of a curve that runs against it is negative."""
    names = '$PhysicalNames\n2\n1 1 "a"\n1 2 "b"\n$EndPhysicalNames\n'
    point_and_curve = "$Entities\n1 1 0 0\n7 {} 0\n1 0 0 0 1 0 0 2 -1 2 0\n$EndEntities\n"
    path = tmp_path / "a.msh"
    for version, place, is_complete in (("4.1", "0 0 0", True), ("4.0", "0 0 0 0 0 0", False)):
        path.write_text(f"$MeshFormat\n{version} 0 8\n$EndMeshFormat\n{names}{point_and_curve.format(place)}")
        refused = pytest.raises(ValueError, match=r"groups \[-1, 2\]")
        with contextlib.nullcontext() if is_complete else refused:
            check_groups("gmsh", path)


CORNERS = "*NODE\n1, 0, 0\n2, 1, 0\n3, 1, 1\n4, 0, 1\n"
INP = CORNERS + "*ELEMENT, TYPE=CPS3{0}\n1, 1, 2, 3\n*ELEMENT, type=CPS3{1}\n2, 1, 3, 4\n{2}"
ONE, TWO = ", ELSET=a", ", elset = b"


@pytest.mark.parametrize(
    ("first", "second", "more", "said"),
    [
        (ONE, TWO, "", ""),
        (ONE, "", "", ""),
        ("", TWO, "", "ELEMENT blocks without ELSET before others"),
        (ONE, ONE.lower(), "", "has the set A twice"),
        (ONE, "", "*ELSET, ELSET=a\n2\n", "has the set A twice"),
        (ONE, "", "*NSET, NSET=n\n1\n*NSET, NSET=N\n2\n", "has the set N twice"),
        (ONE, "", CORNERS, "has 2 blocks of"),
        (ONE, "", "*NSET, NSET=n, ELSET=a\n*SURFACE, NAME=s\na, S1\n", "left out: N, S"),
    ],
)
def test_sets_of_abaqus_are_of_their_elements_or_told(
    tmp_path: Path, first: str, second: str, more: str, said: str
) -> None:
    path = tmp_path / "a.inp"
    path.write_text(INP.format(first, second, more))
    if said and "left out" not in said:
        with pytest.raises(ValueError, match=said):
            read_mesh(path)
        return
    with pytest.warns(MeshRepairWarning, match=said) if said else contextlib.nullcontext():
        found = read_mesh(path).subdomains
    assert {name: part.tolist() for name, part in found.items()} == {"a": [0]} | (
        {"b": [1]} if second else {}
    )
