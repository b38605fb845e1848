"""The problem of a solve is kept beside its solution, with the mesh file that it names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.export import write_mesh, write_solution
from rmesh_nlp.io.kept_problem import keep, names, read_kept
from rmesh_nlp.io.problem_file import load_problem, read_table
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.report.pictures import after
from support.formulations import fixed, joint
from support.orders import ORDERS
from support.problem_files import VALID

SHAPE = VALID[VALID.index("[mesh]") : VALID.index("[boundaries]")]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("mesh", [SHAPE, '[mesh]\nfile = "body.msh"\n\n'])
def test_a_kept_solution_is_read_back_from_its_folder_alone(tmp_path, mesh, order):
    path, folder = tmp_path / "my.toml", tmp_path / "out"
    write_mesh(rectangle(8, 3, x=(0, 4)), tmp_path / "body.msh")
    path.write_text(f"order = {order}\n{VALID.replace(SHAPE, mesh)}")
    table = read_table(path)
    assert [*names(table)] == ["problem.toml"] + ["given-mesh.msh"] * ("file" in mesh)
    keep(table, folder)
    solution = joint.solve(load_problem(path), limits={"iterations": 5})
    write_solution(solution, folder / "solution.vtu")
    path.unlink()
    (tmp_path / "body.msh").unlink()
    assert sorted(one.name for one in folder.iterdir()) == sorted([*names(table), "solution.vtu"])
    kept = read_kept(folder, {"quadrature": 7})
    assert (kept.problem.name, kept.problem.quadrature, kept.is_remeshed) == ("block", 7, False)
    assert read_kept(folder, {}).problem.quadrature == 4
    assert kept.problem.order == order
    np.testing.assert_array_equal(kept.problem.mesh.p, solution.problem.mesh.p)
    np.testing.assert_array_equal(kept.mesh.p, solution.mesh.p)
    for name in ("displacement", "pressure"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(solution, name))
    for name in ("limit", "area", "angle"):
        np.testing.assert_array_equal(getattr(kept.multipliers, name), getattr(solution.multipliers, name))
    conditions = replace(solution.assessment.first_order, multipliers=None)
    unlimited = replace(solution, assessment=replace(solution.assessment, first_order=conditions))
    write_solution(unlimited, folder / "solution.vtu")
    assert read_kept(folder, {}).multipliers is None
    (folder / "problem.toml").unlink()
    assert read_kept(folder, {}) is None


@pytest.mark.parametrize("order", ORDERS)
def test_an_order_of_the_command_line_is_that_of_the_record(tmp_path, order):
    path = tmp_path / "my.toml"
    path.write_text(f"order = {3 - order}\n{VALID}")
    solution = fixed.solve(load_problem(path, order))
    keep(read_table(path), tmp_path / "out")
    write_solution(solution, tmp_path / "out" / "solution.vtu")
    kept = read_kept(tmp_path / "out", solution.record())
    assert kept.problem.order == order
    np.testing.assert_array_equal(kept.displacement, solution.displacement)
    pictured = after(kept), after(solution)
    np.testing.assert_array_equal(pictured[0].displacement, pictured[1].displacement)
    np.testing.assert_array_equal(pictured[0].pressure, pictured[1].pressure)
    assert read_kept(tmp_path / "out", {}) is None  # of another space
    path.write_text(path.read_text().replace("ny = 3", "ny = 2"))
    keep(read_table(path), tmp_path / "out")
    assert read_kept(tmp_path / "out", solution.record()) is None  # on another mesh


@pytest.mark.parametrize("order", ORDERS)
def test_a_solution_on_a_new_mesh_is_read_back_with_it(tmp_path, order):
    path, folder = tmp_path / "my.toml", tmp_path / "out"
    path.write_text(f"order = {order}\n" + VALID.replace('["top", 0]', '["top"]'))
    problem = load_problem(path)
    new = refined(problem)
    solution = joint.solve(new, limits={"iterations": 5})
    keep(read_table(path), folder)
    write_solution(solution, folder / "solution.vtu")
    assert read_kept(folder, {}) is None  # without the mesh
    write_mesh(solution.mesh, folder / "mesh.msh")
    kept = read_kept(folder, {})
    assert kept.is_remeshed
    np.testing.assert_allclose(kept.problem.mesh.p, new.mesh.p, atol=1e-14)
    np.testing.assert_array_equal(kept.mesh.p, solution.mesh.p)
    elements = [DisplacementSpace(one).elements for one in (kept.problem, new)]
    np.testing.assert_array_equal(*elements)
    for name, facets in new.mesh.boundaries.items():
        assert np.size(kept.problem.mesh.boundaries[name]) == np.size(facets)
    for name, elements in (new.mesh.subdomains or {}).items():
        np.testing.assert_array_equal(np.sort(kept.problem.mesh.subdomains[name]), np.sort(elements))
    write_mesh(problem.mesh, folder / "mesh.msh")  # another one
    assert read_kept(folder, {}) is None
    write_mesh(solution.mesh, folder / "mesh.msh")
    (folder / "problem.toml").write_text(VALID)  # node 0 is one of the given mesh
    assert read_kept(folder, {}) is None
