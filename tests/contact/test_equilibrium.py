from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from skfem import Basis, BilinearForm, ElementTriP1, ElementVector, FacetBasis, LinearForm, asm
from skfem.helpers import dot, grad
from skfem.models.elasticity import linear_elasticity

from rmesh_nlp.assessment.assessor import equilibrium_residual, law_residual
from rmesh_nlp.contact import active_set as equilibrium
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, PlaneStrain
from support.problems import sloped_block


def test_scalar_system_is_that_of_scikit_fem() -> None:
    problem = replace(EXAMPLES["6.1"](), quadrature=8)
    model = ContactSolver(problem)
    system = model.system(problem.mesh.p)
    basis = Basis(problem.mesh, ElementTriP1(), intorder=8)
    source = ca.Function("f", [x := ca.SX.sym("x"), y := ca.SX.sym("y")], [problem.law.source(x, y)])

    def f(x: np.ndarray) -> np.ndarray:
        return source(x[0].ravel(), x[1].ravel()).full().reshape(x[0].shape)

    K = asm(BilinearForm(lambda u, v, w: dot(grad(u), grad(v))), basis)
    F = asm(LinearForm(lambda v, w: f(w.x) * v), basis)
    free = model.displacement.index[0] >= 0
    order = np.argsort(model.displacement.index[0][free])
    nodes = np.flatnonzero(free)[order]
    np.testing.assert_allclose(system.stiffness.toarray(), K[nodes][:, nodes].toarray(), atol=1e-13)
    np.testing.assert_allclose(system.load, F[nodes], atol=1e-13)


def test_elastic_system_is_that_of_scikit_fem(sloped: ContactProblem) -> None:
    problem = replace(sloped, quadrature=4)
    model = ContactSolver(problem)
    system = model.system(problem.mesh.p)
    element = ElementVector(ElementTriP1())
    basis = Basis(problem.mesh, element, intorder=4)
    K = asm(linear_elasticity(problem.law.lame_lambda, problem.law.lame_mu), basis)
    top = FacetBasis(problem.mesh, element, facets=problem.mesh.boundaries["top"], intorder=4)
    F = asm(LinearForm(lambda v, w: -20 * w.x[0] * v[1]), basis)
    F += asm(LinearForm(lambda v, w: -20 * v[0] - 30 * w.x[0] * v[1]), top)
    index = model.displacement.index
    dofs = np.zeros(model.n_u, dtype=int)
    moving = index >= 0
    dofs[index[moving]] = basis.nodal_dofs[moving]
    scale = np.abs(K).max()
    np.testing.assert_allclose(system.stiffness.toarray(), K[dofs][:, dofs].toarray(), atol=1e-12 * scale)
    np.testing.assert_allclose(system.load, F[dofs], atol=1e-11)


def ipopt_reference(system: ContactSystem) -> tuple[np.ndarray, float]:
    """The same quadratic program by Ipopt, friction by slip magnitudes."""
    m, n_t = system.load.size, system.slip_bound.size
    x = ca.MX.sym("x", m + n_t)
    u, s = x[:m], x[m:]
    K, N = (ca.sparsify(ca.DM(m.toarray())) for m in (system.stiffness, system.normals))
    f = ca.dot(u, K @ u) / 2 - ca.dot(system.load, u) + system.constant
    g = [N @ u + system.offset]
    if n_t:
        T = ca.sparsify(ca.DM(system.tangents.toarray()))
        f += ca.dot(system.slip_bound, s)
        g += [s - T @ u, s + T @ u]
    g = ca.vertcat(*g)
    free, rows = np.full(m + n_t, np.inf), int(g.shape[0])
    nlp = NLP(x, ca.MX(0, 1), f, g, -free, free, np.zeros(rows), np.full(rows, np.inf))
    result = Solver(nlp, options={"tol": 1e-11})(np.zeros(m + n_t))
    assert result.converged
    return result.x[:m], result.f


def test_active_set_agrees_with_ipopt(example: ContactProblem) -> None:
    model = ContactSolver(example)
    system = model.system(example.mesh.p)
    ours = equilibrium.solve(system)
    u, energy = ipopt_reference(system)
    assert ours.status is Status.CONVERGED
    # an interior point stays a distance of about tol / force off each touching bound
    assert ours.energy == pytest.approx(energy, rel=1e-8)
    assert np.max(np.abs(ours.u - u)) <= 1e-5 * np.max(np.abs(u))


def test_sloped_block_sticks_and_slips_and_agrees_with_ipopt(sloped: ContactProblem) -> None:
    model = ContactSolver(sloped)
    system = model.system(sloped.mesh.p)
    ours = equilibrium.solve(system)
    _, energy = ipopt_reference(system)
    assert ours.energy == pytest.approx(energy, rel=1e-8)
    assert np.any(ours.active.sliding == 0)
    assert np.any(ours.active.sliding != 0)


def test_gaps_of_touching_nodes_are_exactly_zero(example: ContactProblem) -> None:
    model = ContactSolver(example)
    system, solution = model.system(example.mesh.p), model.solve(example.mesh.p)
    gap = system.normals @ solution.u + system.offset
    assert np.all(gap[solution.active.touching] == 0)
    assert np.all(gap[~solution.active.touching] > 0)
    assert np.any(solution.active.touching)
    assert law_residual(system, solution.u, solution.normal_force, solution.tangential_force) == 0
    residual = equilibrium_residual(system, solution.u, solution.normal_force, solution.tangential_force)
    assert residual < 1e-9


def test_warm_start_at_the_solution_takes_one_factorisation(example: ContactProblem) -> None:
    model = ContactSolver(example)
    cold = model.solve(example.mesh.p)
    warm = model.solve(example.mesh.p, cold.active)
    assert warm.iterations == 1
    assert warm.energy == pytest.approx(cold.energy, rel=1e-10)


def test_any_warm_start_leads_to_the_same_solution(sloped: ContactProblem) -> None:
    model = ContactSolver(sloped)
    system = model.system(sloped.mesh.p)
    cold = equilibrium.solve(system)
    rng = np.random.default_rng(1)
    for _ in range(10):
        n = system.offset.size
        start = ActiveSet(rng.random(n) < 0.5, rng.integers(-1, 2, n).astype(np.int8))
        warm = equilibrium.solve(system, start)
        assert warm.status is Status.CONVERGED
        assert warm.energy == pytest.approx(cold.energy, rel=1e-10)


def test_random_dense_problems_agree_with_ipopt() -> None:
    # stiffness matrices that are far from M-matrices, where block changes alone may cycle
    import scipy.sparse as sp

    rng = np.random.default_rng(3)
    for _ in range(10):
        m, n = 24, 10
        A = rng.standard_normal((m, m))
        dofs = rng.permutation(m)[: 2 * n]
        rows = sp.csr_array((np.ones(2 * n), (np.arange(2 * n), dofs)), shape=(2 * n, m))
        system = ContactSystem(
            stiffness=sp.csc_array(A @ A.T + 1e-2 * np.eye(m)),
            load=rng.standard_normal(m),
            constant=0.0,
            normals=rows[:n],
            tangents=rows[n:],
            offset=rng.standard_normal(n),
            slip_bound=rng.random(n),
        )
        ours = equilibrium.solve(system)
        assert ours.status is Status.CONVERGED
        assert ours.energy == pytest.approx(ipopt_reference(system)[1], abs=1e-6, rel=1e-6)


def test_the_iteration_limit_is_reported() -> None:
    problem = EXAMPLES["6.2"]()
    system = ContactSolver(problem).system(problem.mesh.p)
    n = system.offset.size
    far_off = ActiveSet(np.ones(n, dtype=bool), np.zeros(0, dtype=np.int8))
    assert equilibrium.solve(system, far_off, max_iterations=2).status is Status.ITERATION_LIMIT


def test_turned_problem_has_the_same_energy_and_forces() -> None:
    # the contact normal is then parallel to no axis, which exercises the change of basis
    straight = sloped_block()
    flat = replace(
        straight,
        law=PlaneStrain(straight.law.lame_lambda, straight.law.lame_mu),
        obstacle=replace(straight.obstacle, offset=0.01),
    )
    angle = 0.4
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    load = Q @ np.array([-20.0, -30.0])
    upright = replace(flat, tractions=(replace(flat.tractions[0], value=(-20.0, -30.0)),))
    turned = replace(
        flat,
        mesh=replace(flat.mesh, doflocs=Q @ flat.mesh.p),
        obstacle=replace(flat.obstacle, normal=tuple(Q @ [0, 1])),
        tractions=(replace(flat.tractions[0], value=tuple(load)),),
    )
    one = ContactSolver(upright).solve(upright.mesh.p)
    two = ContactSolver(turned).solve(turned.mesh.p)
    assert two.energy == pytest.approx(one.energy, rel=1e-10)
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-9)
    np.testing.assert_allclose(two.tangential_force, one.tangential_force, atol=1e-9)
    assert np.any(one.active.touching)
