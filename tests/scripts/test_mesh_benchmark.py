"""What the benchmark of meshes measures with: the plain loop of scikit-fem, references, the tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skfem import MeshTri

import benchmark_mesh
import benchmark_order
from best_mesh import adaptive as plain
from best_mesh import cases, order_tables, predict, rows
from best_mesh.rows import Row
from rmesh_nlp.contact.solver import ContactSolver


def rows_of(method: str, nodes: list[int], factor: float, rate: float = 1.0) -> list:
    return [Row("6.3", method, n, n, factor * n**-rate, seconds=2.0 * n) for n in nodes]


def test_table_compares_at_equal_nodes_with_goals_and_what_is_attainable() -> None:
    found = [
        *rows_of(rows.GIVEN, [100, 400], 8.0),
        *rows_of(rows.ADAPTIVE, [50, 900], 4.0),
        *rows_of(rows.REMESHED, [400], 2.0),
        *rows_of(rows.ATTAINABLE, [400], 1.0),
    ]
    # a mesh with 2 % more nodes and as much less error has the same factor
    found += [replace(found[-2], method=rows.METRIC, nodes=408, error=found[-2].error / 1.02)]
    last = rows.table(found, {("6.3", 400): 6.0}).splitlines()[-1]
    assert last == "| 6.3 | 400 | - | 2 | 4 | - | 4 | 5.6 | no | 8 | 0.5 | - | 800 |"
    enough = rows.table([replace(r, case="6.1") for r in found], {("6.1", 400): 4.0}).splitlines()[-1]
    assert "| 4 | yes |" in enough


def test_times_are_compared_at_equal_error() -> None:
    found = [*rows_of(rows.ADAPTIVE, [50, 4000], 4.0), *rows_of(rows.LOOP, [100, 400], 1.0)]
    # the adaptive mesh of this error has 1600 nodes
    assert rows.times(found).splitlines()[2:] == ["| 6.3 | metric, adaptive loop | 400 | 8e+02 | 0.25 |"]


def test_predicted_factors_are_compared_at_equal_nodes_unless_refining_is_advised() -> None:
    def rows_at(case: str, way: str, error: float, predicted: float) -> list:
        made = [("uniform", 100, 8.0), ("remeshed, relocated", 100, 2.0), ("as advised", 400, error)]
        made.append(("predicted", 100, predicted))
        return [Row(case, method, 0, nodes, size, status=way) for method, nodes, size in made]

    found = [
        *rows_at("a", "remesh", 0.5, 4.0),
        *rows_at("b", "refine", 2.0, 5.0),
        *rows_at("c", "x, not known", 1, 1),
    ]
    first, second, _, last = predict.summary(found).splitlines()[2:]
    assert first == "| a | 100 | 8 | remesh | 4 | 4 | 1.00 | 4 |"
    assert second == "| b | 100 | 8 | refine | 5 | 4 | 1.25 | 4 |"
    assert last == "1 of 2 within 20%; not compared: c"


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "name", ["6.1", "L-shape", "free boundary", "Signorini", "jNO's L-shape, held", "wedge"]
)
def test_plain_solver_agrees_with_the_package(name: str, order: int) -> None:
    case = cases.CASES[name]
    problem = replace(case.problem(case.sizes[0]), order=order)
    mesh = MeshTri(problem.mesh.p, problem.mesh.t)
    found, own = plain.solve(case.equations, mesh, order), ContactSolver(problem).given
    assert found.energy == pytest.approx(own.energy, rel=1e-10)
    if case.slope is not None:
        assert case.error_of(found) == pytest.approx(case.error(problem), rel=1e-6)


def test_plain_elements_converge_with_their_orders() -> None:
    case = cases.CASES["6.1"]
    grids = [MeshTri(grid.p, grid.t) for grid in (case.problem(n).mesh for n in (16, 32))]
    errors = [case.error_of(plain.solve(case.equations, grid, 2)) for grid in grids]
    assert errors[0] / errors[1] > 12  # of the energy: 16 in the limit
    last = list(plain.adaptive(case.equations, grids[0], 1, 1100))[-1]
    uniform = plain.solve(case.equations, grids[1], 1, last)
    assert case.error_of(last) < 0.5 * case.error_of(uniform)


@pytest.mark.parametrize(("name", "rate"), [("L-shape r^(2/3)", 1.7), ("wedge", 1.7)])
def test_refinement_gives_the_rate_of_order_2_to_singular_solutions(name: str, rate: float) -> None:
    case = {**cases.CASES, **cases.MORE}[name]
    mesh = case.problem(4).mesh
    found = list(plain.adaptive(case.equations, MeshTri(mesh.p, mesh.t), 2, 2500))
    if case.slope is None:  # falls of the energy have the rate of errors
        errors = [one.energy - found[-1].energy for one in found[:-3]]
    else:
        errors = [case.error_of(one) for one in found]
    nodes = [one.nodes for one in found[: len(errors)]]
    assert np.log(errors[2] / errors[-1]) > rate * np.log(nodes[-1] / nodes[2])


@pytest.mark.slow
def test_a_reference_extrapolates_the_energy_and_bounds_the_error_of_as_many_triangles() -> None:
    case = cases.CASES["L-shape"]
    given = case.problem(0)
    fine = cases.reference(given, 2000)
    error = case.error(given)
    assert abs(fine.limit - case.equations.exact) < 0.05 * error
    assert fine.least(given.mesh.t.shape[1]) < 0.5 * error  # a corner: graded meshes are far better
    refined = fine.problem  # what refinement reaches is above it
    assert fine.least(refined.mesh.t.shape[1]) < case.error(refined)


@pytest.mark.slow
def test_benchmark_measures_each_mesh_once_and_writes_its_table(tmp_path: Path) -> None:
    arguments = ["--cases", "6.1", "--levels", "1", "--out", str(tmp_path)]
    assert benchmark_mesh.main(arguments) == 0
    assert "| 6.1 | 81 |" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "best_mesh.png").stat().st_size > 0
    kept = (tmp_path / "rows.jsonl").read_text()
    assert '"remeshed, relocated"' in kept
    assert benchmark_mesh.main(arguments) == 0
    assert (tmp_path / "rows.jsonl").read_text() == kept


@pytest.mark.slow
def test_benchmark_of_orders_measures_both_and_writes_its_tables(tmp_path: Path) -> None:
    arguments = ["--cases", "L-shape r^(2/3)", "--levels", "1", "--out", str(tmp_path)]
    assert benchmark_order.main(arguments) == 0
    table, kept = (tmp_path / "table.md").read_text(), (tmp_path / "rows.jsonl").read_text()
    assert "| L-shape r^(2/3) | 225 |" in table
    assert '"P1 remeshed, relocated"' in kept
    assert benchmark_order.main(["--tables", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "table.md").read_text() == table
    assert (tmp_path / "rows.jsonl").read_text() == kept


def test_factors_and_rates_of_orders_are_at_equal_unknowns() -> None:
    def falling(method: str, nodes: list[int], factor: float, rate: float) -> list:
        return [Row("6.3", method, 0, n, factor * n**-rate, 1e-3 * n) for n in nodes]

    found = [
        *falling("P2 uniform", [100, 400, 1600, 6400], 1.0, 1.0),
        *falling("P2 h-adaptive", [100, 6400], 5.0, 2.0),
        *falling("P2 relocated", [100, 1600], 10.0, 2.0),
        *falling("P2 remeshed, relocated", [102, 1600], 5.0, 2.0),
        Row("6.3", "reference", 0, 1000, 5.0),
        Row("6.3", "reference", 0, 2000, 2.0),
    ]
    assert order_tables.limit(found, "6.3", "reference", 0) == (1.0, 1.0)
    # a mesh with 2 % more nodes and 4 % less error is as good
    first, last = order_tables.factors(found).splitlines()[2:]
    assert first == "| 6.3 | 100 | 0.01 | 1 | 20 | 10 | 20 | - | - | - |"
    assert last == "| 6.3 | 1600 | 0.000625 | 1 | 320 | 160 | 320 | 1.00 | 2.00 | 2.00 |"
    # of 1600 nodes and 10 / 1600^2: the adaptive mesh has 1131, uniform ones 256 000
    first, last = order_tables.times(found).splitlines()[2:]
    assert first == "| 6.3 | relocated | 1600 | < 0.00625 | 1.41 |"
    assert last == "| 6.3 | remeshed, relocated | 1600 | < 0.00313 | 1 |"


def test_what_fails_is_a_row() -> None:
    def fails():  # type: ignore[no-untyped-def]
        yield rows.Row("6.1", "metric", 8, 81, 1.0)
        raise ValueError("no mesh")

    (row,) = benchmark_mesh.attempted(fails, rows.Row("6.1", "metric", 8, 0, float("nan")))
    assert row.status == "ValueError: no mesh"
    assert np.isnan(row.error)
