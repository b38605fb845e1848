"""Contact systems against scikit-fem, and factors of their stiffness by SuperLU and by CHOLMOD."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from skfem import Basis, ElementTriP1, ElementVector, FacetBasis, LinearForm, asm
from skfem.models.elasticity import linear_elasticity

from rmesh_nlp.contact import factorisation
from rmesh_nlp.contact.factorisation import HAS_CHOLMOD, factorised
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Obstacle, PlaneStrain
from rmesh_nlp.solving.entries import versions
from support.problems import sloped_block


def test_forces_are_measured_by_the_load_or_by_what_an_overlap_would_take() -> None:
    problem = EXAMPLES["6.3"]((4, 2))
    loaded = ContactSolver(problem).system(problem.mesh.p)
    assert loaded.force_scale == max(np.abs(loaded.load).max(), loaded.slip_bound.max())
    free = replace(loaded, load=0 * loaded.load, slip_bound=0 * loaded.slip_bound)
    pressed = replace(free, offset=np.where(np.arange(free.offset.size) == 1, -0.02, 0.1))
    assert pressed.force_scale == 0.02 * free.stiffness.diagonal().max()
    assert replace(free, offset=0 * free.offset + 0.1).force_scale == 1e-300


def test_elastic_system_is_that_of_scikit_fem() -> None:
    problem = replace(sloped_block(), quadrature=4)
    solver = ContactSolver(problem)
    system = solver.system(problem.mesh.p)
    element = ElementVector(ElementTriP1())
    basis = Basis(problem.mesh, element, intorder=4)
    K = asm(linear_elasticity(problem.law.lame_lambda, problem.law.lame_mu), basis)
    top = FacetBasis(problem.mesh, element, facets=problem.mesh.boundaries["top"], intorder=4)
    F = asm(LinearForm(lambda v, w: -20 * w.x[0] * v[1]), basis)
    F += asm(LinearForm(lambda v, w: -20 * v[0] - 30 * w.x[0] * v[1]), top)
    index, dofs = solver.displacement.index, np.zeros(solver.n_u, dtype=int)
    dofs[index[index >= 0]] = basis.nodal_dofs[index >= 0]
    scale = np.abs(K).max()
    np.testing.assert_allclose(system.stiffness.toarray(), K[dofs][:, dofs].toarray(), atol=1e-12 * scale)
    np.testing.assert_allclose(system.load, F[dofs], atol=1e-11)


def test_gaps_of_order_2_have_the_coefficients_of_the_distance() -> None:
    """Those of ``x^2 / 10`` on an edge from a to b are that at its ends and ``a b / 10`` in its middle."""
    foundation = Obstacle.graph("bottom", lambda x, y: -(x**2) / 10)
    problem = ContactProblem(rectangle(4, 2, x=(0, 2)), PlaneStrain(1.0, 1.0), "top", foundation, order=2)
    solver = ContactSolver(problem)
    nodes, vertices = solver.contact_nodes, problem.mesh.p.shape[1]
    middles = nodes >= vertices
    ends = np.stack([nodes, nodes])
    ends[:, middles] = problem.mesh.facets[:, nodes[middles] - vertices]
    assert np.sum(middles) == 4
    expected = np.prod(problem.mesh.p[0, ends], axis=0) / 10
    np.testing.assert_allclose(solver.system(problem.mesh.p).offset, expected, atol=1e-15)


def test_where_two_walls_meet_both_gaps_are_unknowns() -> None:
    """No slip is an unknown there, since problems refuse friction there; the last node has one component."""
    N = np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, np.sqrt(0.5)]])
    T = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, np.sqrt(0.5)]])
    system = ContactSystem(
        sp.csc_array(np.eye(3)), np.ones(3), 0.0, sp.csr_array(N), sp.csr_array(T), np.zeros(3), np.ones(3)
    )
    rotated = system.rotated
    w = np.array([1.0, 2.0, 3.0])
    u = rotated.back(w)
    np.testing.assert_allclose(N @ u, w[rotated.normal])
    assert not np.any(rotated.slips)


@pytest.fixture(
    params=[False, pytest.param(True, marks=pytest.mark.skipif(not HAS_CHOLMOD, reason="no CHOLMOD"))]
)
def by_cholmod(request, monkeypatch) -> bool:
    monkeypatch.setattr(factorisation, "HAS_CHOLMOD", request.param)
    return request.param


def test_an_indefinite_matrix_is_solved_too(by_cholmod) -> None:
    K = sp.csc_array(np.diag([2.0, -1.0, 3.0]))
    np.testing.assert_allclose(factorised(K)(np.ones(3)), [0.5, -1.0, 1 / 3])


def test_the_record_says_what_factorised() -> None:
    assert ("scikit-sparse" in versions()) == HAS_CHOLMOD
