"""Newton-CG within walls: projections, element validity as walls, and descents that end at them."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import ROUNDING, least_angles
from rmesh_nlp.models.energy_nlp import ElementConstraints
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.solving.clock import TOLERANCE
from rmesh_nlp.solving.outer import Outer
from support.formulations import joint, nested

LARGE_BOXES = {
    # a rule of high degree: with the midpoint rule the gain is one of the rule
    "6.1, boxes of 0.6 edges": lambda: replace(EXAMPLES["6.1"](8, 0.6 / 8), quadrature=8),
    "6.2, boxes of 0.9 edges": lambda: EXAMPLES["6.2"]((12, 6), (0.3, 0.15)),
    "6.2 refined": lambda: EXAMPLES["6.2"]((24, 12)),
}
"""Problems at whose minimisers element areas are at their bounds."""


def with_angles() -> ContactProblem:
    return replace(EXAMPLES["6.1"](6, 0.08), motion=Motion(0.08, min_angle=30.0))


@pytest.mark.parametrize("make", [LARGE_BOXES["6.2, boxes of 0.9 edges"], with_angles])
def test_validity_rows_have_their_derivatives(make) -> None:
    relocation = Outer(make()).relocation
    validity = ElementConstraints(relocation)
    rng = np.random.default_rng(2)
    q, d = 0.2 * rng.uniform(-1, 1, (2, relocation.n_q))
    multipliers = rng.random(relocation.n_valid)
    there, here, before = (validity.at(q + t * d) for t in (1.0, 0.0, -1.0))
    # the rows are quadratic: these differences are exact
    np.testing.assert_allclose((there.slack - before.slack) / 2, here.jacobian @ d, atol=1e-12)
    change = (there.jacobian - before.jacobian).T @ multipliers / 2
    np.testing.assert_allclose(change, validity.hessian(q, multipliers) @ d, atol=1e-12)


def test_inverted_elements_come_back_to_their_floor() -> None:
    outer = Outer(LARGE_BOXES["6.2, boxes of 0.9 edges"]())
    validity, n = ElementConstraints(outer.relocation), outer.relocation.n_q
    q = 0.6 * np.random.default_rng(0).uniform(-1, 1, n)
    assert not outer.is_valid(q)
    back = validity.back(q, validity.at(np.zeros(n)), -np.ones(n), np.ones(n), np.ones(n))
    assert back is not None
    assert outer.is_valid(back)
    assert np.max(np.abs(back)) <= 1
    assert np.array_equal(validity.back(back, validity.at(back), -np.ones(n), np.ones(n), np.ones(n)), back)


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE_BOXES)
def test_newton_converges_where_areas_are_at_their_bounds(name: str) -> None:
    problem = LARGE_BOXES[name]()
    solution = nested.solve(problem)
    assert solution.success, solution.status
    assert solution.stationarity_residual <= TOLERANCE
    fraction = problem.motion.min_area_fraction
    assert fraction * (1 - 1e-9) <= solution.audit.min_area_ratio <= fraction + 10 * ROUNDING
    assert np.any(solution.multipliers.area > 0)
    # boxes of nearly an edge have many local minima; joint's is another one, here the better by up to 12 %
    best = joint.solve(problem)
    assert solution.energy_initial - solution.energy >= 0.8 * (best.energy_initial - best.energy)


@pytest.mark.slow
def test_newton_converges_where_angles_are_at_their_bounds() -> None:
    problem = with_angles()
    solution = nested.solve(problem, outer="newton")
    assert solution.success
    assert solution.stationarity_residual <= TOLERANCE
    angle = np.min(least_angles(solution.mesh.p, problem.triangles))
    assert 30 - np.rad2deg(ROUNDING) <= angle < 30 + 1e-4
    assert solution.energy <= joint.solve(problem).energy * (1 - 0.01)
