"""What the benchmark of relocation measures with, and the claim of a solve checked from outside."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.refining import refined

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture(autouse=True)
def scripts_are_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS / "gallery"))
    monkeypatch.syspath_prepend(str(SCRIPTS))


def script(name: str) -> ModuleType:
    return importlib.import_module(name)


def rows_of(method: str, nodes: list[int], factor: float, rate: float = 1.0) -> list:
    row = script("worth.rows").Row
    return [row("6.1", method, str(n), n, factor * n**-rate, seconds=float(n)) for n in nodes]


def test_rates_and_nodes_at_equal_error_are_those_of_power_laws() -> None:
    goals = script("worth.goals")
    rows = rows_of("uniform", [100, 400, 1600], 7.0, 2 / 3)
    assert goals.rate(rows) == pytest.approx(2 / 3)
    assert goals.at_nodes(rows, 250) == pytest.approx(7 * 250 ** (-2 / 3))
    assert goals.at_nodes(rows, 3000) == pytest.approx(7 * 3000 ** (-2 / 3))
    assert goals.at_error(rows, 7 * 250 ** (-2 / 3)) == pytest.approx(250)
    assert goals.at_error(rows, 7 * 900 ** (-2 / 3), "seconds") == pytest.approx(900)


def test_a_goal_is_met_only_where_every_figure_reaches_it() -> None:
    goals = script("worth.goals")
    grid = rows_of("uniform", [100, 400], 8.0)
    good = rows_of("large moves", [100, 400], 0.98)
    one_bad = [good[0], replace(good[1], error=1.2 * good[1].error)]
    texts = [goals.goals([*grid, *found]) for found in (good, one_bad)]
    assert "at 100, 400 nodes | 8 at each | 8.16, 8.16 | yes |" in texts[0]
    assert "at 100, 400 nodes | 8 at each | 8.16, 6.80 | no |" in texts[1]


def test_rows_are_kept_and_not_measured_again(tmp_path: Path) -> None:
    rows = script("worth.rows")
    path, measured = tmp_path / "rows.jsonl", []

    def measure() -> Iterator:
        measured.append(1)
        yield from rows_of("uniform", [81], 1.0)

    for _ in range(2):
        store = rows.Store(path)
        store.measured("6.1", "uniform", "81", measure)
        store.measured("6.1", "uniform", "81", measure)
    assert len(measured) == 1
    assert store.rows == rows_of("uniform", [81], 1.0) or np.isnan(store.rows[0].least_area)
    assert json.loads(path.read_text())["nodes"] == 81


def test_exact_errors_element_by_element_sum_to_the_error_of_the_energy() -> None:
    # without contact half the squared energy norm of the difference to a solution on a refinement is the
    # difference of their energies
    reference = script("worth.reference")
    problem = ContactProblem(rectangle(4, 4), Laplace(1.0), ("left", "bottom"), motion=Motion(None))
    fine = refined(refined(problem))
    model = ContactModel(fine)
    state = model.solve(fine.mesh.p)
    known = reference.Reference(fine, model.displacement.values(state.u), state.energy, state.energy)
    local = reference.local_errors(problem, known)
    here = ContactModel(problem).solve(problem.mesh.p).energy
    assert local.shape == (32,)
    assert local.sum() == pytest.approx(here - state.energy, rel=1e-9)


@pytest.mark.slow
def test_a_reference_extrapolates_the_energy_of_a_singular_solution() -> None:
    cases, reference = script("worth.cases"), script("worth.reference")
    found = reference.reference(cases.CASES["L-shape"].problem(0), 2000)
    exact = -0.2140758036 / 2
    assert abs(found.limit - exact) < 0.2 * abs(found.energy - exact)


@pytest.mark.slow
def test_quadratic_elements_from_outside_agree_with_refined_linear_ones() -> None:
    outside = script("worth.second_order")
    mesh = named(rectangle(8, 4, x=(0, 2)), {"load": lambda x: (x[1] == 1) & (x[0] > 1)})
    stated = outside.Plate(100.0, 0.3, (0.0, -5.0), -0.02)
    problem = ContactProblem(
        mesh,
        PlaneStrain.from_young(100.0, 0.3),
        ("left",),
        Obstacle.graph("bottom", -0.02),
        tractions=(Traction("load", (0.0, -5.0)),),
        motion=Motion(None),
    )
    energies = []
    for _ in range(3):
        energies.append(ContactModel(problem).solve(problem.mesh.p).energy)
        problem = refined(problem)
    first, second = -np.diff(energies)
    limit = energies[2] - second / (first / second - 1)
    exact = outside.energy(mesh, stated, 0)
    assert exact < energies[2]
    assert exact == pytest.approx(limit, abs=0.1 * (energies[2] - exact) + 0.02 * first)


@pytest.mark.slow
def test_the_command_line_is_better_by_the_factor_that_it_claims(tmp_path: Path) -> None:
    # an unprepared gmsh mesh; loads, supports and contact stated, and nothing else
    pytest.importorskip("gmsh")
    (row,) = script("worth.acceptance").accepted(0.8, tmp_path)
    assert "motion" not in (tmp_path / "two_holes.toml").read_text()
    found = row.figures
    assert found["success"]
    assert found["factor"] > 1.4
    assert 0.7 * found["factor"] < found["claimed"] <= 1.05 * found["factor"]
    least, most = found["claimed_before"]
    assert least <= found["error_before"] <= most


@pytest.mark.slow
def test_the_benchmark_writes_its_tables_and_its_figure(tmp_path: Path) -> None:
    benchmark = script("benchmark_worth")
    arguments = ["--sizes", "8", "--methods", "uniform", "boxes", "large", "residual", "--out", str(tmp_path)]
    assert benchmark.main(arguments) == 0
    assert "| 6.1, large moves: times less error" in (tmp_path / "goals.md").read_text()
    assert len((tmp_path / "rows.md").read_text().splitlines()) == 2 + 3
    assert (tmp_path / "worth.png").stat().st_size > 0
    kept = (tmp_path / "rows.jsonl").read_text()
    assert benchmark.main(arguments) == 0
    assert (tmp_path / "rows.jsonl").read_text() == kept


def test_the_page_takes_its_table_between_its_marks() -> None:
    goals = script("worth.goals")
    rows = rows_of("uniform", [100, 400], 8.0) + rows_of("large moves", [100, 400], 0.98)
    page = f"before\n{goals.BEGIN}\nstale\n{goals.END}\nafter\n"
    new = goals.on_page(page, rows)
    assert new == f"before\n{goals.BEGIN}\n{goals.goals(rows)}{goals.END}\nafter\n"
    assert goals.on_page(new, rows) == new
