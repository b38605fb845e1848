"""Newton-CG within walls: projections, element validity as walls, and descents that end at them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mapping.validity import ROUNDING, least_angles
from rmesh_nlp.models.energy_nlp import ElementConstraints
from rmesh_nlp.optimize.constraints import Polyhedron, Wall
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import minimise
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.solving.clock import TOLERANCE
from rmesh_nlp.solving.outer import Outer
from support.formulations import joint, nested
from support.quadratics import quadratic

LARGE_BOXES = {
    # a rule of high degree: with the midpoint rule the gain is one of the rule
    "6.1, boxes of 0.6 edges": lambda: replace(EXAMPLES["6.1"](8, 0.6 / 8), quadrature=8),
    "6.2, boxes of 0.9 edges": lambda: EXAMPLES["6.2"]((12, 6), (0.3, 0.15)),
    "6.2 refined": lambda: EXAMPLES["6.2"]((24, 12)),
}
"""Problems at whose minimisers element areas are at their bounds."""


def random_polyhedron(rng: np.random.Generator) -> Polyhedron:
    """Rows with six entries each, as of triangles, through or near 0."""
    n, rows = 30, 25
    jacobian = np.zeros((rows, n))
    for row in jacobian:
        row[rng.choice(n, 6, replace=False)] = rng.standard_normal(6)
    slack = np.maximum(rng.uniform(-0.3, 0.5, rows), 0.0)
    return Polyhedron(-rng.random(n), rng.random(n), slack, sp.csr_array(jacobian), rng.uniform(0.1, 10, n))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_projections_obey_the_variational_inequality(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = random_polyhedron(rng)
    d = 2 * rng.standard_normal(steps.scale.size)
    near = steps.nearest(d)
    assert steps.active(near).size > 0
    assert np.all((steps.lower <= near) & (near <= steps.upper))
    assert np.all(steps.slack + steps.jacobian @ near >= -1e-9)
    others = [steps.nearest(2 * rng.standard_normal(d.size)) for _ in range(12)]
    # no other point of a convex set lies on the side of d
    assert max((d - near) @ (steps.scale * (y - near)) for y in others) <= 1e-7


def test_a_face_holds_its_rows_and_fits_their_multipliers() -> None:
    rng = np.random.default_rng(3)
    steps = random_polyhedron(rng)
    rows, inside = np.arange(4), rng.random(steps.scale.size) < 0.8
    face, r = steps.face(rows, inside), rng.standard_normal(steps.scale.size)
    direction = face.precondition(r)
    np.testing.assert_allclose(steps.jacobian[rows] @ direction, 0, atol=1e-8)
    assert np.all(direction[~inside] == 0)
    pull = np.array([1.0, 0.5, 2.0, 0.1])
    np.testing.assert_allclose(face.multipliers(steps.jacobian[rows].T @ pull), pull, rtol=1e-7)


class Circle:
    """The wall ``side (|x|^2 - 1) >= 0``, and the way back along its radius."""

    def __init__(self, side: float) -> None:
        self.side = side

    def at(self, x: np.ndarray) -> Wall:
        slack = np.array([self.side * (x @ x - 1)])
        return Wall(slack, np.minimum(slack, 0), sp.csr_array(2 * self.side * x[None, :]))

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> sp.csc_array:
        return sp.csc_array(2 * self.side * multipliers[0] * np.eye(2))

    def back(self, x: np.ndarray, *_: object) -> np.ndarray:
        return x if self.side * (x @ x - 1) >= 0 else x / np.linalg.norm(x) * (1 + self.side * 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_newton_follows_a_curved_wall_and_converges_there(side: float) -> None:
    # the nearest point of the circle to one inside it, or outside
    target = (0.2 if side > 0 else 2.0) * np.array([np.cos(1), np.sin(1)])
    wall = Circle(side)
    points = []
    result = minimise(
        lambda x: quadratic(2 * np.eye(2), 2 * target, x),
        np.array([-1.5, 0.2]) if side > 0 else np.array([-0.7, 0.2]),
        np.full(2, -3.0),
        np.full(2, 3.0),
        walls=wall,
        gain_tolerance=1e-8,
        tolerance=2e-5,  # the way back costs 1e-12 in the value, what a move by 1e-6 along the circle gives
        on_step=lambda iteration, x, here: points.append(x),
    )
    assert result.status is Status.CONVERGED
    np.testing.assert_allclose(result.x, [np.cos(1), np.sin(1)], atol=3e-5)
    # half way round the circle or less; held back by the wall it would creep for hundreds
    assert result.iterations <= 25
    assert min(side * (x @ x - 1) for x in points) >= 0


def test_a_wall_that_is_not_met_changes_nothing() -> None:
    class Far(Circle):
        def at(self, x: np.ndarray) -> Wall:
            return Wall(np.ones(1), np.zeros(1), sp.csr_array(np.zeros((1, 2))))

        def back(self, x: np.ndarray, *_: object) -> np.ndarray:
            return x

    A, b = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([9.0, 1.0])
    arguments = (lambda x: quadratic(A, b, x), np.zeros(2), -np.ones(2), np.ones(2))
    free, walled = minimise(*arguments), minimise(*arguments, walls=Far(1.0))
    np.testing.assert_allclose(walled.x, free.x, rtol=1e-9)
    assert walled.iterations == free.iterations


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
