"""What is attainable before anything moves, and how near a solution comes to it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction, on_refined
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.metric import nodal_areas
from rmesh_nlp.fem.recovery import Recovered
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.attainable import LeastErrors
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion
from rmesh_nlp.solving.advice import Advice, advise, recommended
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.refinement import attained


def parabola(n: int, **changes: Any) -> ContactProblem:
    """``u = x^2 / 2`` on the unit square, given on its sides ``x = 0`` and ``x = 1``."""
    given = Dirichlet("left", (0.0,)), Dirichlet("right", (0.5,))
    problem = ContactProblem(rectangle(n, n), Laplace(-1.0), given, motion=Motion(None), name="parabola")
    return replace(problem, **changes)


@pytest.mark.slow
def test_a_parabola_is_best_meshed_by_strips() -> None:
    # right triangles of width h have the error h^2 / 24 of interpolation, on any grid
    n = 3
    found = advise(parabola(n))
    assert found.error == pytest.approx(1 / (24 * n**2), rel=1e-6)
    assert found.rate == pytest.approx(1.0, abs=1e-6)
    # strips across: as thin as triangles may be
    assert found.attainable_factor > 10
    assert found.attainable_by_refinement < 1.5
    assert found.attainable_same_connectivity >= 1.0
    assert found.recommended == "remesh"
    assert found.predicted_factor == found.remeshing_factor <= found.attainable_factor
    assert "rmesh solve --remesh" in dict(found.rows())


@pytest.mark.slow
def test_a_linear_solution_leaves_nothing_to_gain() -> None:
    found = advise(parabola(2, law=Laplace(0.0), motion=Motion(0.1)))
    assert "rmesh solve --delta none --remesh" in dict(found.rows())  # limits are not regarded
    assert (found.error, found.attainable_factor, found.recommended) == (0.0, 1.0, "refine")
    assert (found.record()["second_order_factor"], np.isfinite(found.predicted_factor)) == (1.0, True)


@pytest.mark.slow
def test_the_error_is_known_where_energies_of_meshes_do_not_compare() -> None:
    """Data that vary along the boundary are represented better by each finer mesh."""
    exact = (lambda x, y: (x * x - y * y) / 2,)
    sides = ("left", "right", "top", "bottom")
    problem = parabola(6, law=Laplace(0.0), dirichlet=tuple(Dirichlet(side, exact) for side in sides))
    found = advise(problem)
    assert found.error == pytest.approx(2 / (24 * 6**2), rel=0.05)
    # right triangles are the best ones of a saddle, so only four times as many lower the error
    assert (found.recommended, found.predicted_factor) == ("refine", pytest.approx(4, rel=0.1))


def test_least_errors_are_those_of_the_best_triangles_at_each_place() -> None:
    """A saddle beside a bowl: equilateral triangles are best for the bowl, right ones for the saddle."""
    mesh = rectangle(10, 4)
    triangles, steep = counter_clockwise(mesh.p, mesh.t), mesh.p[0] < 0.45
    second = np.where(steep, [[2.0], [0.0], [-2.0]], [[1.0], [0.0], [1.0]])[None]
    region = Recovered(Laplace(), np.arange(mesh.t.shape[1]), np.arange(steep.size), triangles, second)
    areas = nodal_areas(mesh.p, triangles)
    found, bowl = LeastErrors.of(mesh.p, [region], 50), 1 / np.sqrt(108)
    for value, saddle in ((found.equilateral, 4 / np.sqrt(27)), (found.any_mesh, 4 / 6)):
        expected = (areas @ np.sqrt(np.where(steep, saddle, bowl))) ** 2 / 50
        assert value == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_least_errors_are_quadratic_in_the_derivatives_and_fall_like_the_order() -> None:
    mesh = rectangle(1, 1)
    triangles = counter_clockwise(mesh.p, mesh.t)
    derivatives = np.random.default_rng(3).uniform(1, 2, (1, 4, mesh.p.shape[1]))

    def found(factor: float, count: int) -> np.ndarray:
        every = np.arange(mesh.t.shape[1]), np.arange(mesh.p.shape[1]), triangles
        least = LeastErrors.of(mesh.p, [Recovered(Laplace(), *every, factor * derivatives)], count)
        return np.array([*vars(least).values()])

    once = found(1.0, 100)
    np.testing.assert_allclose(found(2.0, 100), 4 * once, rtol=1e-9)
    np.testing.assert_allclose(found(1.0, 200), once / 2**2, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("order", "error"), [(1, 1 / (24 * 4**2)), (2, 1 / (1440 * 4**4))])
def test_what_is_attained_is_over_the_error_of_the_last_mesh(order: int, error: float) -> None:
    """Of ``x^2 / 2`` and ``x^3 / 6``, by derivatives on the last mesh and on its refinement."""
    source, right = ((-1.0, 1 / 2), (lambda x, y: -x, 1 / 6))[order - 1]
    given = Dirichlet("left", (0.0,)), Dirichlet("right", (right,))
    last = admissible(parabola(4, law=Laplace(source), dirichlet=given, order=order))
    unknown = ErrorReduction((0.0, np.inf), (0.0, np.inf), 1.0, np.inf, "refinement", 25, 1)
    ends = [attained(2 * error, unknown, last, finest) for finest in (None, on_refined(last))]
    for end in ends:
        # third derivatives are recovered to a few percent
        assert end.attainable_factor * end.share_of_attainable == pytest.approx(3, rel=0.05)
    assert order == 2 or ends[1].share_of_attainable == pytest.approx(ends[0].share_of_attainable)


@pytest.mark.slow
def test_advice_on_example_61_holds() -> None:
    problem = replace(EXAMPLES["6.1"](n=24), motion=Motion(None))
    found = advise(problem)
    row = solve(problem, remesh=True).record()
    initial, last = (row[name] - EXACT_ENERGY_61 for name in ("energy_initial_audited", "energy_audited"))
    assert found.error == pytest.approx(initial, rel=0.1)
    assert found.predicted_factor == pytest.approx(initial / last, rel=0.2)
    # 20.2 by the exact second derivatives
    assert found.attainable_factor == pytest.approx(20.2, rel=0.1)
    assert row["attainable_factor"] == pytest.approx(20.2, rel=0.15)
    assert row["attainable_factor"] * row["share_of_attainable"] == pytest.approx(initial / last, rel=1e-6)
    assert found.attainable_by_refinement == pytest.approx(4.2, rel=0.1)
    assert 4 < found.attainable_same_connectivity < 9


def test_a_new_mesh_is_recommended_where_it_is_worthwhile() -> None:
    factors = (1.24, 1.24), (1.26, 1.0), (1.0, 1.26), (1.26, 9.0)  # of a new mesh, and of relocation
    assert [recommended(*both) for both in factors] == ["refine", "remesh", "relocate", "remesh"]


def test_rows_say_factors_and_what_they_cost() -> None:
    advice = Advice(0.25, 0.5, 12.0, 3.0, 2.5, 9.0, "remesh", 9.0)
    rows = dict(advice.rows())
    assert rows["error of the energy"] == "0.25"
    assert rows["best mesh of as many triangles"].startswith("12 times")
    assert rows["rmesh solve --remesh"].startswith("9 times less, for about")
    assert rows["refined uniformly, four times as many"].startswith("2 times less, for about 5 contact")
    assert "--remesh" in advice.sentence
    assert dict(replace(advice, is_rough=True).rows())["rmesh solve --remesh"].startswith("3 to 9 times less")
    assert replace(advice, recommended="refine").sentence.startswith("refine")


@pytest.mark.slow
def test_a_factor_is_an_interval_where_errors_and_energies_fall_at_other_rates() -> None:
    """On 20 nodes 26 is predicted for a new mesh, and 3.4 is reached."""
    advice = advise(replace(random_problem(91022), motion=Motion(None)))
    assert advice.is_rough
    assert dict(advice.rows())["rmesh solve --remesh"].startswith("1.2 to 26 times less")
    assert advice.second_order_remeshing_factor is None
