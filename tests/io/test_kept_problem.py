"""The problem of a solve is kept beside its solution, with the mesh file that it names."""

from __future__ import annotations

import pytest

from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.io.kept_problem import keep, names
from rmesh_nlp.io.problem_file import read_table
from rmesh_nlp.meshes.shapes import rectangle
from support.problem_files import VALID

SHAPE = VALID[VALID.index("[mesh]") : VALID.index("[boundaries]")]


@pytest.mark.parametrize("mesh", [SHAPE, '[mesh]\nfile = "body.msh"\n\n'])
def test_a_problem_file_and_its_mesh_are_copied(tmp_path, mesh):
    path, folder = tmp_path / "my.toml", tmp_path / "out"
    write_mesh(rectangle(8, 3, x=(0, 4)), tmp_path / "body.msh")
    path.write_text(VALID.replace(SHAPE, mesh))
    table = read_table(path)
    assert [*names(table)] == ["problem.toml"] + ["given-mesh.msh"] * ("file" in mesh)
    keep(names(table), folder)
    assert {one.name: one.read_bytes() for one in folder.iterdir()} == {
        name: source.read_bytes() for name, source in names(table).items()
    }
