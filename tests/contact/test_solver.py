"""Contact systems of problems: against scikit-fem, turned, and with unknowns in another order."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from skfem import Basis, ElementTriP1, ElementVector, FacetBasis, LinearForm, asm
from skfem.models.elasticity import linear_elasticity

from rmesh_nlp.contact import solver as of_solver
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import LEAF, ContactSystem, Equilibrium, dissected, elimination_order
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, PlaneStrain
from support.contact_geometry import block_on_a_circle, block_sliding_on_a_circle
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


def test_turned_problem_has_the_same_energy_and_forces() -> None:
    # the contact normal is then parallel to no axis: gaps are no components of the displacement
    straight = sloped_block()

    def solved(angle: float) -> Equilibrium:
        Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        problem = replace(
            straight,
            law=PlaneStrain(straight.law.lame_lambda, straight.law.lame_mu),
            mesh=replace(straight.mesh, doflocs=Q @ straight.mesh.p),
            obstacle=replace(straight.obstacle, offset=0.01, normal=tuple(Q @ [0.0, 1.0])),
            tractions=(replace(straight.tractions[0], value=tuple(Q @ [-20.0, -30.0])),),
        )
        return ContactSolver(problem).solve(problem.mesh.p)

    one, two = solved(0.0), solved(0.4)
    assert two.energy == pytest.approx(one.energy, rel=1e-10)
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-9)
    np.testing.assert_allclose(two.tangential_force, one.tangential_force, atol=1e-9)
    assert np.any(one.active.touching)
    assert np.any(one.tangential_force != 0)


def test_where_two_walls_meet_both_gaps_are_unknowns() -> None:
    """The slip along one wall is the gap of the other, up to a sign; the last node has one component."""
    N = np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, np.sqrt(0.5)]])
    T = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, np.sqrt(0.5)]])
    system = ContactSystem(
        sp.csc_array(np.eye(3)), np.ones(3), 0.0, sp.csr_array(N), sp.csr_array(T), np.zeros(3), np.ones(3)
    )
    rotated = system.rotated
    w = np.array([1.0, 2.0, 3.0])
    u = rotated.back(w)
    np.testing.assert_allclose(N @ u, w[rotated.normal])
    np.testing.assert_array_equal(rotated.slips, [False, True, False])
    np.testing.assert_allclose((T @ u)[1], w[rotated.tangent[1]])


def test_every_unknown_is_eliminated_once_and_a_separator_after_what_it_separates() -> None:
    mesh = rectangle(24, 10, x=(0, 4))
    for degree in (1, 2):
        space = DisplacementSpace.of(ContactProblem(mesh, Laplace(), ("left",), order=degree))
        points = space.points(mesh.p)
        order = dissected(points, space.elements)
        assert np.array_equal(np.sort(order), np.arange(space.n_nodes))
        # without the first separator, which is last, nothing connects the two halves
        separator = np.isclose(points[0], 2.0)
        assert np.argsort(order)[separator].min() == space.n_nodes - separator.sum()
    np.testing.assert_array_equal(dissected(mesh.p, mesh.facets), dissected(mesh.p, mesh.t))
    n = 3 * LEAF  # points that no line separates
    assert dissected(np.zeros((2, n)), np.array([[0], [1]])).size == n

    given_and_tied = np.array([[0, CONSTANT, 0], [1, 2, CONSTANT]])
    points = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    assert np.array_equal(
        np.sort(elimination_order(points, np.array([[0, 1], [1, 2]]), given_and_tied)), [0, 1, 2]
    )


@pytest.mark.parametrize("make", [sloped_block, block_sliding_on_a_circle, block_on_a_circle])
def test_solutions_do_not_depend_on_the_order(make, monkeypatch: pytest.MonkeyPatch) -> None:
    problem: ContactProblem = make()
    results = []
    for large in (5000, 10):
        monkeypatch.setattr(of_solver, "LARGE", large)
        solver = ContactSolver(problem)
        system, state = solver.system(problem.mesh.p), solver.solve(problem.mesh.p)
        assert (system.order is None) == (large == 5000)
        results.append(state)
    one, two = results
    assert one.active.key() == two.active.key()
    assert np.any(one.active.touching)
    np.testing.assert_allclose(two.u, one.u, atol=1e-9 * np.max(np.abs(one.u)))
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-8 * one.normal_force.max())
