"""Loads that jump or kink within edges and triangles: exact on any mesh, and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.energy import load_vector
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.cells import Straight
from rmesh_nlp.fem.energy import load_energy
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import where
from rmesh_nlp.solving.outer import Outer

JUMPS = (
    lambda x, y: where(x > 1.51787, -5.62, -1.3534646),
    lambda x, y: where(ca.logic_and(x > 0.3, x < 0.35), -7.0, ca.fabs(x - 0.9)),
)
SOURCES = (
    lambda x, y: where(x + 0.7 * y > 1.1, -3.5, 2.0 * y),
    lambda x, y: ca.fmax(y - 0.6 * x, 0.0),
)


def pulled(order: int) -> rm.ContactProblem:
    return rm.ContactProblem(
        rm.shapes.rectangle(3, 2, x=(0, 2)),
        rm.PlaneStrain.from_young(1000.0, 0.3, SOURCES),
        ("left",),
        rm.Obstacle.line("bottom", (0.0, -0.01), (0.0, 1.0)),
        rm.Motion(None),
        (rm.Traction("top", JUMPS),),
        order=order,
    )


@pytest.mark.parametrize("order", [1, 2])
def test_nodal_loads_are_exact_wherever_the_nodes_are(order: int) -> None:
    problem = pulled(order)
    mesh, rng = problem.mesh, np.random.default_rng(1)
    p = np.array(mesh.p)
    for k, end in enumerate((2, 1)):
        inner = (p[k] > 0) & (p[k] < end)
        p[k, inner] += rng.uniform(-0.1, 0.1, np.count_nonzero(inner))
    moved = replace(problem, mesh=replace(mesh, doflocs=p))
    space = DisplacementSpace(moved)
    exact, doubt = load_vector(Body(moved, p), space)
    held = space.given()[0].T.ravel()
    system = ContactSolver(moved).system(p)
    assert np.max(doubt) < 1e-12
    np.testing.assert_allclose(np.sort(system.load), np.sort(exact[~held]), atol=1e-11)


@pytest.mark.parametrize("order", [1, 2])
def test_the_energy_has_no_gain_by_quadrature_and_a_gradient(order: int) -> None:
    outer = Outer.of(pulled(order))
    rng, q = np.random.default_rng(1), np.zeros(outer.n)
    q = 0.1 * rng.uniform(-1, 1, outer.n)
    d, step = rng.uniform(-1, 1, outer.n), 1e-5
    ends = [outer.energy(q + sign * step * d) for sign in (1, -1)]
    slope = (ends[0].value - ends[1].value) / (2 * step)
    assert outer.energy(q).gradient @ d == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(
    ("law", "order"), [(rm.PlaneStrain(1.3, 0.7, SOURCES), 1), (rm.Laplace(SOURCES[1]), 2)]
)
def test_sums_of_triangles_that_a_jump_cuts_have_the_derivatives_of_their_function(law, order: int) -> None:
    sums = load_energy(law, Straight(3, law.components, order), 5)[1]
    X = np.array([[0.0, 0.1, 1.9, 0.2, 0.6, 1.4], [2.0, 1.3, 3.0, 1.3, 2.5, 2.0]]).T  # cut, and on one side

    def matrices(X: np.ndarray, k: int) -> np.ndarray:
        numbers = sums.evaluated(X, 3)[k]
        column = ca.SX.sym("numbers", len(numbers))
        return np.asarray(ca.Function("matrix", [column], [sums.in_matrix(column, k)]).map(2)(numbers))

    X_symbols = ca.SX.sym("X", 6)
    whole = ca.Function("whole", [X_symbols], [sums(X_symbols)]).map(2)
    np.testing.assert_allclose(matrices(X, 0), whole(X), rtol=1e-11)
    for k in range(2):
        d = np.random.default_rng(k).uniform(-1, 1, 6)
        ends = [matrices(X + sign * 1e-5 * d[:, None], k) for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-5
        derivatives = matrices(X, k + 1).reshape(len(slope), 2, 6**k, 6) @ d
        np.testing.assert_allclose(derivatives.reshape(slope.shape), slope, rtol=0, atol=1e-7)
