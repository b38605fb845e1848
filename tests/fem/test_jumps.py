"""Loads that jump or kink within edges and triangles: exact on any mesh, and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.energy import load_vector
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.second_derivatives import curvature_of
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import where
from rmesh_nlp.solving.outer import Outer
from support.taylor import difference_order, taylor_order

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
def test_the_energy_has_both_derivatives(order: int) -> None:
    outer = Outer.of(pulled(order))
    q, d = np.random.default_rng(1).uniform(-1, 1, (2, outer.n)) * [[0.1], [1]]
    assert taylor_order(outer.energy, q, d, 1e-4) == pytest.approx(2, abs=0.02)
    product = curvature_of(outer.energy)(outer.energy(q))(d)
    order_of = difference_order(lambda at: outer.energy(at).gradient, product, q, d, 1e-3)
    assert order_of == pytest.approx(2, abs=0.05)
