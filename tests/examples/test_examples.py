import re
from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES, PAPER


def truncate(value: float, digits: int) -> float:
    return np.trunc(value * 10**digits) / 10**digits


@pytest.mark.parametrize(
    # six digits measured independently by prototypes of the same settings
    ("name", "energy"),
    [("6.1", -1.124602), ("6.2", -4.854190), ("6.3", -0.609981)],
)
def test_initial_energies_are_those_of_the_paper(name: str, energy: float) -> None:
    problem = EXAMPLES[name]()
    found = ContactSolver(problem).solve(problem.mesh.p).energy
    assert found == pytest.approx(energy, abs=2e-6)
    assert truncate(found, 4) == pytest.approx(PAPER[name].energy_initial, abs=1e-12)


def test_extremes_of_61_are_those_of_the_paper() -> None:
    problem = EXAMPLES["6.1"]()
    u = ContactSolver(problem).solve(problem.mesh.p).u
    # the paper's digits are rounded up or truncated, so one unit in the last place
    assert u.min() == pytest.approx(PAPER["6.1"].u_min_initial, abs=1e-4)
    assert u.max() == pytest.approx(PAPER["6.1"].u_max_initial, abs=1e-4)


def test_printed_closed_form_of_the_exact_energy() -> None:
    assert pytest.approx(-1.9456096613, abs=1e-10) == EXACT_ENERGY_61


def test_exact_energy_of_61_by_integration() -> None:
    # J(u) = -1/2 (f, u) for the exact solution, since a(u, u) = (f, u)
    problem = EXAMPLES["6.1"]()
    points, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for low in (0.0, 0.5):  # the exact solution is smooth on each half
        x, y = np.meshgrid((points + 1) / 2, low + (points + 1) / 4)
        w = np.outer(weights / 4, weights / 2)
        for xi, yi, wi in zip(x.ravel(), y.ravel(), w.ravel(), strict=True):
            total -= 0.5 * wi * float(problem.law.source(xi, yi)) * float(problem.exact.value(xi, yi))
    assert total == pytest.approx(EXACT_ENERGY_61, abs=1e-9)


@pytest.mark.parametrize(("n", "energy"), [(16, -1.699532), (32, -1.881162)])
def test_refined_initial_energies(n: int, energy: float) -> None:
    problem = EXAMPLES["6.1"](n)
    assert ContactSolver(problem).solve(problem.mesh.p).energy == pytest.approx(energy, abs=2e-6)


@pytest.mark.slow
def test_energy_error_of_fixed_meshes_is_of_second_order() -> None:
    # accurate quadrature, so that J_h - J is the discretisation error alone (Theorem 4.1)
    errors = []
    for n in (16, 32, 64):
        problem = replace(EXAMPLES["6.1"](n), quadrature=8)
        errors.append(ContactSolver(problem).solve(problem.mesh.p).energy - EXACT_ENERGY_61)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 2) < 0.2), orders


@pytest.mark.parametrize("n", [1, 0, -3, 2.5, (8, 8, 8), "8"])
def test_bad_sizes_name_the_value(n: object) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(n))):
        EXAMPLES["6.1"](n)


def test_odd_columns_cannot_carry_the_load() -> None:
    with pytest.raises(ValueError, match="got 11"):
        EXAMPLES["6.2"]((11, 6))


def test_rows_lower_than_the_bottom_row_are_refused() -> None:
    assert np.min(EXAMPLES["6.2"]((36, 19)).mesh.p[1]) == 0.05
    with pytest.raises(ValueError, match="beyond the next one of 20 rows"):
        EXAMPLES["6.2"]((40, 20))


def test_a_folded_mesh_is_refused() -> None:
    problem = EXAMPLES["6.3"]((4, 2))
    p = problem.mesh.p.copy()
    (middle,) = np.flatnonzero((p[0] == 1) & (p[1] == 0.5))
    p[1, middle] = -0.25
    with pytest.raises(ValueError, match="the mesh is folded at the edge between nodes"):
        replace(problem, mesh=replace(problem.mesh, doflocs=p))
