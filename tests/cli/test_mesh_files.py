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
    text = " ".join(re.sub("[│┌─┬┐]", " ", said.out).split())
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


@pytest.mark.parametrize("command", ["solve body.msh", "solve b", "advise body.msh", "advise b", "check 6.1"])
def test_what_is_no_problem_file_is_told_what_is_meant(rmesh, command: str) -> None:
    Path("b.toml").write_text("")
    write_mesh(rectangle(1, 1), "body.msh")
    said = rmesh(command)
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert f"as {command.split()[1]}.toml (of a mesh: rmesh new my.toml --mesh MESH writes one)" in said.err
