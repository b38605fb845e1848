"""Parts between jumps and kinks of data: exact for lines, close for curves, and what is known for certain."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.assessment.integrals import over_edges, over_triangles
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, PiecewiseLinear
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import Coefficient, on_points, where
from rmesh_nlp.problem.switches import switches

TALL = 1.0  # of the strip (0, 2) x (0, TALL)


def body(n: int = 3) -> Body:
    problem = ContactProblem(rectangle(n, 2, x=(0, 2)), Laplace(1.0), ("left",))
    return Body(problem, problem.mesh.p)


def integrand(coefficient: Coefficient) -> Callable[..., Array]:
    return lambda _, __, x: on_points(coefficient, x)[None]


def disc(x, y):
    return where((x - 1) ** 2 + (y - 0.5) ** 2 < 0.09, 1.0, 0.0)


@pytest.mark.parametrize(
    ("coefficient", "exact", "within", "is_certain"),
    [
        # where x + y / 2 > 1.1 x is integrated: (4 - (1.1 - y / 2)^2) / 2 over y
        (lambda x, y: where(x + y / 2 > 1.1, x, 0.0), 2 - (1.1**3 - 0.6**3) / 3, 1e-12, True),
        (
            lambda x, y: ca.fabs(x - 0.77) + ca.fmax(y - 0.31, 0),
            0.77**2 / 2 + 1.23**2 / 2 + 0.69**2,
            1e-12,
            True,
        ),
        (lambda x, y: where(ca.logic_and(x > 0.4, y < 0.3), 2.0, 0.0), 2 * 1.6 * 0.3, 1e-12, True),
        (lambda x, y: ca.sign(x - 1) + ca.floor(x), 1.0, 1e-4, False),
        (lambda x, y: where(ca.sin(3 * x) > 0, 1.0, 0.0), np.pi / 3, 1e-5, False),
        (disc, np.pi * 0.09, 1e-3, False),
        (lambda x, y: x * x * y, 8 / 6, 1e-12, True),
    ],
)
def test_triangles_are_split_along_jumps_and_kinks(
    coefficient: Coefficient, exact: float, within: float, is_certain: bool
) -> None:
    whole = body()
    total = over_triangles(whole, np.arange(12), integrand(coefficient), coefficients=(coefficient,))
    assert total.value.sum() == pytest.approx(exact, rel=within)
    assert total.is_certain is is_certain


@pytest.mark.parametrize(
    ("coefficient", "exact", "is_certain"),
    [
        (lambda x, y: where(x > 1.97, -60.0, 0.0), -1.8, True),
        (lambda x, y: where((x - 0.3) * (x - 0.31) < 0, 1.0, 0.0), 0.01, True),
        (PiecewiseLinear((0.0, 0.7, 2.0), (0.0, 0.7, 0.7)), 0.7**2 / 2 + 0.7 * 1.3, True),
        (lambda x, y: where(ca.cos(2 * x) > 0, 1.0, 0.0), np.pi / 4, False),
        (lambda x, y: where(x > 2 / 3, 3.0, 0.0), 4.0, True),  # at a node
    ],
)
def test_edges_are_split_at_jumps_and_kinks(coefficient: Coefficient, exact: float, is_certain: bool) -> None:
    top = body().edges("top")
    total = over_edges(top, integrand(coefficient), (coefficient,))
    assert total.value.sum() == pytest.approx(exact, rel=1e-12)
    assert total.is_certain is is_certain
    assert total.doubt.sum() < 1e-12


def test_what_is_smooth_or_a_number_has_no_switches_and_what_is_unknown_is_said() -> None:
    assert switches(3.0) is None
    assert switches(lambda x, y: ca.sin(x) / (2 + y)) is None
    unknown = switches(lambda x, y: ca.fmod(x, 0.3))
    assert unknown is not None
    assert not unknown.are_all
    found = switches(lambda x, y: where(ca.logic_or(x > 1, x * y > 2), 1.0, ca.fabs(y)))
    assert found is not None
    assert sorted(degree or 0 for degree in found.degrees) == [1, 1, 2]
