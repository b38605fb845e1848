"""The examples of the paper: sizes, printed values, exact and reference solutions."""

import re
from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES, PAPER
from rmesh_nlp.examples.paper import truncated
from rmesh_nlp.examples.reference import reference_solution, with_reference
from rmesh_nlp.problem.coefficients import on_points


@pytest.mark.parametrize(
    # six digits measured independently by prototypes of the same settings
    ("name", "n", "energy"),
    [
        ("6.1", 8, -1.124602),
        ("6.1", 16, -1.699532),
        ("6.1", 32, -1.881162),
        ("6.2", (12, 6), -4.854190),
        ("6.3", (12, 6), -0.609981),
    ],
)
def test_initial_energies_are_those_of_the_paper(name: str, n: int, energy: float) -> None:
    problem = EXAMPLES[name](n)
    given = ContactSolver(problem).given
    found = given.energy
    assert found == pytest.approx(energy, abs=2e-6)
    if n == 8:  # the paper's digits are rounded up or truncated, so one unit in the last place
        extremes = PAPER[name].u_min_initial, PAPER[name].u_max_initial
        assert (given.u.min(), given.u.max()) == pytest.approx(extremes, abs=1e-4)
    if n in (8, (12, 6)):
        assert truncated(found) == truncated(PAPER[name].energy_initial)
        assert problem.motion.delta == pytest.approx(PAPER[name].delta)


@pytest.mark.parametrize("name", ["6.1", "6.2", "6.3"])
def test_examples_of_order_2_have_lower_energies_by_a_better_rule(name: str) -> None:
    one, two = EXAMPLES[name](2), EXAMPLES[name](2, order=2)
    assert (one.order, two.order, one.quadrature, two.quadrature) == (1, 2, "midpoint", "auto")
    assert one.motion == two.motion
    accurate = replace(one, quadrature=8)
    energies = [ContactSolver(problem).given.energy for problem in (accurate, two)]
    assert energies[1] < energies[0]  # linear displacements are quadratic ones
    if name == "6.1":
        assert energies[1] > EXACT_ENERGY_61


def test_figures_are_truncated_as_the_paper_does() -> None:
    assert [truncated(value) for value in (-1.124602, -1.12469, 0.1)] == [-11246, -11246, 1000]
    assert all(truncated(k / 1e4) == k for k in range(-20_000, 20_000))  # no binary fractions


def test_move_limits_follow_the_mesh_width_unless_given() -> None:
    with pytest.raises(BadInputError, match=r"unknown example '6\.4': did you mean"):
        EXAMPLES["6.4"]
    assert EXAMPLES["6.1"]((16, 4)).motion.delta == pytest.approx((0.01375, 0.055))
    assert EXAMPLES["6.2"]((6, 12)).motion.delta == pytest.approx((0.31334, 0.036665))
    assert EXAMPLES["6.1"]("16x4").motion == EXAMPLES["6.1"]((16, 4)).motion
    assert EXAMPLES["6.1"](4, "0.1,0.2").motion.delta == (0.1, 0.2)
    assert EXAMPLES["6.1"](4, 0.01).motion.delta == (0.01, 0.01)
    assert EXAMPLES["6.3"]((4, 2), (0.1, 0.2)).motion.delta == (0.1, 0.2)
    assert EXAMPLES["6.1"](4, "none").motion.delta is None
    for bad in ("x", (1, 2, 3)):
        with pytest.raises(ValueError, match=re.escape(f"two of them, or none, got {bad!r}")):
            EXAMPLES["6.1"](4, bad)


def test_exact_energy_of_61_by_integration() -> None:
    # J(u) = -1/2 (f, u) for the exact solution, since a(u, u) = (f, u)
    problem = EXAMPLES["6.1"]()
    points, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for low in (0.0, 0.5):  # the exact solution is smooth on each half
        at = np.stack(np.meshgrid((points + 1) / 2, low + (points + 1) / 4, indexing="ij")).reshape(2, -1)
        f, u = on_points(problem.law.source, at), on_points(problem.exact.value, at)
        total -= 0.5 * np.outer(weights / 2, weights / 4).ravel() @ (f * u)
    assert total == pytest.approx(EXACT_ENERGY_61, abs=1e-9)


def test_bad_sizes_grids_that_do_not_fit_and_folded_meshes_are_refused() -> None:
    for n in (1, 0, -3, 2.5, (8, 8, 8), "8x"):
        with pytest.raises(ValueError, match=re.escape(repr(n))):
            EXAMPLES["6.1"](n)
    assert np.min(EXAMPLES["6.2"]((36, 19)).mesh.p[1]) == 0.05
    for n, message in (((11, 6), "got 11"), ((40, 20), "beyond the next one of 20 rows")):
        with pytest.raises(ValueError, match=message):
            EXAMPLES["6.2"](n)
    problem = EXAMPLES["6.3"]((4, 2))
    p = problem.mesh.p.copy()
    (middle,) = np.flatnonzero((p[0] == 1) & (p[1] == 0.5))
    p[1, middle] = -0.25
    with pytest.raises(ValueError, match="elements overlap at the edge between nodes"):
        replace(problem, mesh=replace(problem.mesh, doflocs=p))


@pytest.mark.parametrize("order", [1, 2])
def test_splines_reproduce_the_fine_solution_at_its_nodes_and_the_exact_one_between(order: int) -> None:
    fine = EXAMPLES["6.1"](32 // order, order=order)
    reference = reference_solution(replace(fine, quadrature=6))
    for x, y in [(0.3, 0.2), (0.77, 0.13), (0.5, 0.9)]:
        exact = float(fine.exact.value(x, y))
        assert float(reference.value(x, y)) == pytest.approx(exact, abs=5e-3)
    assert reference.energy > fine.exact.energy


def test_scattered_nodes_are_refused() -> None:
    problem = EXAMPLES["6.1"](4)
    assert with_reference(problem) is problem  # exact solutions are kept
    p = problem.mesh.p.copy()
    p[:, 12] += 0.01
    with pytest.raises(ValueError, match="rectangular grid: 25 nodes lie on 6 x 6 grid lines"):
        reference_solution(replace(problem, mesh=replace(problem.mesh, doflocs=p)))
