"""What the benchmark of meshes measures with: the plain loop of scikit-fem, references, the table."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from skfem import ElementTriP1, MeshTri

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.problem.contact_problem import refined

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture(autouse=True)
def scripts_are_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS / "gallery"))
    monkeypatch.syspath_prepend(str(SCRIPTS))


def script(name: str) -> ModuleType:
    return importlib.import_module(name)


def rows_of(method: str, nodes: list[int], factor: float, rate: float = 1.0) -> list:
    row = script("best_mesh.rows").Row
    return [row("6.1", method, str(n), n, factor * n**-rate, seconds=2.0 * n) for n in nodes]


def test_table_compares_at_equal_nodes_and_at_equal_error() -> None:
    rows = script("best_mesh.rows")
    grid = rows_of(rows.GIVEN, [100, 400], 8.0)
    adaptive = rows_of(rows.ADAPTIVE, [50, 900], 4.0)
    table = rows.table([*grid, *adaptive, *rows_of("relocated", [200], 1.0)])
    # at 200 nodes 1/8 and 1/4 of the error; the adaptive mesh of this error has 800 nodes
    assert table.endswith("| 6.1 | relocated | 200 | 0.005 | 0.12 | 0.25 | 4e+02 | 0.25 |\n")


def test_plain_loop_agrees_with_the_package_on_example_61() -> None:
    cases, plain = script("best_mesh.cases"), script("best_mesh.adaptive")
    case = cases.CASES["6.1"]
    problem = case.problem(8)
    mesh = MeshTri(problem.mesh.p, problem.mesh.t)
    found = plain.solve(case.laplacian, mesh, ElementTriP1(), np.zeros((2, 0)))
    assert found.energy - case.exact == pytest.approx(case.error(problem), rel=1e-6)


def test_plain_elements_converge_with_their_orders() -> None:
    cases, plain = script("best_mesh.cases"), script("best_mesh.adaptive")
    case = cases.CASES["6.1"]
    grids = [case.problem(n).mesh for n in (16, 32)]
    errors = [plain.quadratic(case.laplacian, MeshTri(g.p, g.t)).energy - case.exact for g in grids]
    assert errors[0] / errors[1] > 12  # of the energy: 16 in the limit
    last = list(plain.adaptive(case.laplacian, MeshTri(grids[0].p, grids[0].t), 1100))[-1]
    uniform = plain.solve(case.laplacian, MeshTri(grids[1].p, grids[1].t), ElementTriP1(), last.active)
    assert last.energy - case.exact < 0.5 * (uniform.energy - case.exact)


def test_exact_errors_element_by_element_sum_to_the_error_of_the_energy() -> None:
    # without contact half the squared energy norm of the difference to a solution on a refinement is the
    # difference of their energies
    cases = script("best_mesh.cases")
    problem = ContactProblem(rectangle(4, 4), Laplace(1.0), ("left", "bottom"), motion=Motion(None))
    fine = refined(refined(problem))
    energies = [ContactSolver(one).solve(one.mesh.p).energy for one in (problem, fine)]
    local = cases.local_errors(problem, fine)
    assert local.shape == (32,)
    assert local.sum() == pytest.approx(energies[0] - energies[1], rel=1e-9)


@pytest.mark.slow
def test_a_reference_extrapolates_the_energy_of_a_singular_solution() -> None:
    cases = script("best_mesh.cases")
    problem = cases.CASES["L-shape"].problem(0)
    exact = -0.2140758036 / 2
    assert abs(cases.reference(problem, 2000).limit - exact) < 0.05 * abs(cases.energy(problem) - exact)


@pytest.mark.slow
def test_benchmark_measures_each_mesh_once_and_writes_its_table(tmp_path: Path) -> None:
    benchmark = script("benchmark_mesh")
    arguments = ["--cases", "6.1", "--levels", "1", "--out", str(tmp_path)]
    assert benchmark.main(arguments) == 0
    assert "| 6.1 | remeshed, relocated | 81 |" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "best_mesh.png").stat().st_size > 0
    kept = (tmp_path / "rows.jsonl").read_text()
    assert benchmark.main(arguments) == 0
    assert (tmp_path / "rows.jsonl").read_text() == kept
