"""Mesh files on the command line: what is in one, and a problem with its names."""

import re
from pathlib import Path

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle


@pytest.mark.slow
def test_check_lists_what_is_in_a_mesh_file(rmesh) -> None:
    parts = {"rim": lambda p: p[0] == p[0]}, {"west": lambda p: p[0] < 0}
    write_mesh(named(MeshTri.init_circle(2), *parts), "body.msh")
    said = rmesh("check body.msh --picture body.png")
    assert said.code == 0
    text = " ".join(said.out.split())
    assert "body.msh: a mesh, by its size in m" in text
    length = 32 * np.sin(np.pi / 16)
    assert f"rim (16, {length:.6g})" in text
    assert re.search(r"west \(\d+\)", text)
    assert "[curves] rim = 'circle'" in text
    assert Path("body.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_problem_of_a_mesh_file_has_its_names_and_runs(rmesh) -> None:
    """Of boundaries without names conditions say which they are."""
    Path("meshes").mkdir()
    mesh = rectangle(4, 2)
    for name, given, lowest in (("a", mesh, "bottom"), ("b", MeshTri(mesh.p, mesh.t), "lowest-tenth")):
        write_mesh(given, f"meshes/{name}.msh")
        assert rmesh(f"new {name}.toml --mesh meshes/{name}.msh").code == 0
        assert load_problem(f"{name}.toml").obstacles[0].boundary == lowest
        assert rmesh(f"solve {name}.toml -f fixed --no-figures --out {name}").code == 0


def test_a_template_leaves_an_axis_aside_and_moves_every_part(rmesh) -> None:
    """The middle of an axis is lower than that of a top, but nothing upright meets a foundation below."""
    low, high = rectangle(2, 2), rectangle(2, 2, y=(2, 3))
    both = MeshTri(np.hstack([low.p, high.p]), np.hstack([low.t, 9 + high.t]))
    parts = {"axis": lambda p: p[0] == 0} | {f"at {y}": lambda p, y=y: p[1] == y for y in (0, 1, 2, 3)}
    write_mesh(named(both, parts), "two.msh")
    assert rmesh("new two.toml --mesh two.msh").code == 0
    problem = load_problem("two.toml")
    assert problem.obstacles[0].boundary == "at 0"
    assert [part.boundary for part in problem.supports] == ["at 1", "at 3"]
    write_mesh(named(MeshTri(low.p, low.t), {"axis": parts["axis"], "at 1": parts["at 1"]}), "one.msh")
    assert rmesh("new one.toml --mesh one.msh").code == 0
    assert load_problem("one.toml").obstacles[0].boundary == "lowest-tenth"


@pytest.mark.parametrize("command", ["solve body.msh", "solve b", "advise body.msh", "advise b", "check 6.1"])
def test_what_is_no_problem_file_is_told_what_is_meant(rmesh, command: str) -> None:
    Path("b.toml").write_text("")
    write_mesh(rectangle(1, 1), "body.msh")
    said = rmesh(command)
    assert said.code == 2
    assert said.err.count("\n") == 1
    name = command.split()[1]
    meant = f"as {name}.toml (of a mesh: rmesh new my.toml --mesh MESH writes one)"
    assert ("rmesh new body.toml --mesh body.msh" if name == "body.msh" else meant) in said.err
