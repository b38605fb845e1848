"""Contact systems against scikit-fem, the active set that solves them, and nodes that are weakly active."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from skfem import Basis, ElementTriP1, ElementVector, FacetBasis, LinearForm, asm
from skfem.models.elasticity import linear_elasticity

import rmesh_nlp as rm
from rmesh_nlp.contact import factorisation
from rmesh_nlp.contact.active_set import at_rest, first_set, solve
from rmesh_nlp.contact.factorisation import HAS_CHOLMOD, factorised
from rmesh_nlp.contact.next_set import holding
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.entries import versions
from support.contact_geometry import (
    block_between_two_foundations,
    block_in_a_corner,
    block_sliding_on_a_circle,
)
from support.problems import sloped_block


def random_system(seed: int) -> ContactSystem:
    """A stiffness that is far from an M-matrix."""
    rng, m, n = np.random.default_rng(seed), 24, 10
    A = rng.standard_normal((m, m))
    rows = sp.csr_array((np.ones(2 * n), (np.arange(2 * n), rng.permutation(m)[: 2 * n])), shape=(2 * n, m))
    return ContactSystem(
        stiffness=sp.csc_array(A @ A.T + 1e-2 * np.eye(m)),
        load=rng.standard_normal(m),
        constant=0.3,
        normals=rows[:n],
        tangents=rows[n:],
        offset=rng.standard_normal(n),
        slip_bound=rng.random(n),
        frictional=np.ones(n, dtype=bool),
    )


def on_all_unknowns(K: sp.sparray, load: Array, height: Array) -> ContactSystem:
    """Contact on every unknown of a problem with one component, without friction."""
    rows = sp.csr_array(sp.eye_array(load.size))
    return ContactSystem(
        sp.csc_array(K), load, 0.0, rows, 0 * rows, height, 0 * height, np.zeros(height.size, dtype=bool)
    )


def string(n: int) -> ContactSystem:
    """A string over a parabola: its stiffness is an M-matrix, and Newton's method opens a node a step."""
    x, step = np.linspace(0, 1, n + 2)[1:-1], 1 / (n + 1)
    K = sp.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]) / step
    return on_all_unknowns(K, np.full(n, -8 * step), 0.2 + 0.5 * (x - 0.5) ** 2)


def beam(n: int) -> ContactSystem:
    """A beam over an uneven obstacle under a load that turns: Newton's method cycles."""
    x, step = np.linspace(0, 1, n + 2)[1:-1], 1 / (n + 1)
    bend = sp.diags_array([np.ones(n - 1), -2 * np.ones(n), np.ones(n - 1)], offsets=[-1, 0, 1]) / step**2
    rough = 1 + 0.5 * np.random.default_rng(1).standard_normal(n)
    load = -50 * step * rough * np.sign(np.sin(3 * np.pi * x) + 0.3)
    return on_all_unknowns(step * bend.T @ bend, load, 0.05 + 0.03 * np.cos(7 * x + 1))


def of(make: Callable[..., ContactProblem], *size: object) -> Callable[[], ContactSystem]:
    def system() -> ContactSystem:
        problem = make(*size)
        return ContactSolver(problem).system(problem.mesh.p)

    return system


SYSTEMS = {
    "6.1": of(EXAMPLES["6.1"], 6),
    "6.2": of(EXAMPLES["6.2"], (8, 4)),
    "6.3": of(EXAMPLES["6.3"], (8, 4)),
    "slope, stick and slip": of(sloped_block),
    "circle, stick and slip": of(block_sliding_on_a_circle),
    "corner of two foundations": of(block_between_two_foundations),
    "string": lambda: string(200),
    "beam": lambda: beam(50),
    **{f"random {seed}": (lambda seed=seed: random_system(seed)) for seed in range(3)},
}


@pytest.fixture(scope="module", params=SYSTEMS)
def system(request: pytest.FixtureRequest) -> ContactSystem:
    return SYSTEMS[request.param]()


def test_the_laws_hold_at_every_node_so_that_the_energy_is_least(system: ContactSystem) -> None:
    state = solve(system)
    assert state.status is Status.CONVERGED
    assert state.energy == pytest.approx(system.energy(state.u), rel=1e-14)
    gap, slip = system.normals @ state.u + system.offset, system.tangents @ state.u
    unit, length = system.force_scale, np.max(np.abs(state.u))
    out_of_balance = system.stiffness @ state.u - system.load - system.normals.T @ state.normal_force
    touching = state.active.touching
    assert np.any(touching)
    np.testing.assert_allclose(gap[touching], 0, atol=1e-13 * length)
    assert np.all(gap >= -1e-13 * length)
    assert np.all(state.normal_force >= -1e-12 * unit)
    assert np.all(state.normal_force[~touching] == 0)
    if system.slip_bound.size:
        force, bound, acts = state.tangential_force, system.slip_bound, system.slip_bound > 0
        out_of_balance -= system.tangents.T @ force
        sticks = state.active.sliding == 0
        assert np.all(np.abs(force) <= bound * (1 + 1e-9) + 1e-12 * unit)
        if system.rotated.slips.all():
            np.testing.assert_allclose(slip[sticks], 0, atol=1e-13 * length)
        np.testing.assert_allclose((force * slip)[~sticks & acts], -(bound * np.abs(slip))[~sticks & acts])
    np.testing.assert_allclose(out_of_balance, 0, atol=1e-9 * unit)


def test_any_start_ends_at_the_same_solution_or_at_the_iteration_limit(system: ContactSystem) -> None:
    cold, n, rng = solve(system), system.offset.size, np.random.default_rng(1)
    assert solve(system, cold.active).iterations == 1
    for _ in range(2):
        sliding = rng.integers(-1, 2, system.slip_bound.size).astype(np.int8)
        warm = solve(system, ActiveSet(rng.random(n) < 0.5, sliding))
        assert warm.status is Status.CONVERGED
        assert warm.energy == pytest.approx(cold.energy, rel=1e-10)
    far_off = ActiveSet(~cold.active.touching, cold.active.sliding)
    limited = solve(system, far_off, max_iterations=1)
    assert (limited.status, limited.iterations) == (Status.ITERATION_LIMIT, 1)


@pytest.mark.parametrize("seed", range(3))
def test_nodes_without_gap_and_force_that_slip_at_no_distance_are_solved_too(seed: int) -> None:
    """Strict complementarity fails everywhere: in the gaps and in the slips, with friction at its bound."""
    system, rng = random_system(seed), np.random.default_rng(seed)
    n, u = system.offset.size, rng.standard_normal(system.load.size)
    u -= system.tangents.T @ (system.tangents @ u)
    friction = system.slip_bound * rng.choice([-1, 1], n)
    load = system.stiffness @ u - system.tangents.T @ friction
    biactive = replace(system, load=load, offset=-system.normals @ u)
    sliding = rng.integers(-1, 2, n).astype(np.int8)
    for start in (None, ActiveSet(rng.random(n) < 0.5, sliding)):
        state = solve(biactive, start)
        assert state.status is Status.CONVERGED
        np.testing.assert_allclose(state.u, u, atol=1e-10)


@pytest.mark.parametrize(("system", "at_most"), [(string(2000), 40), (beam(50), 30), (beam(400), 60)])
@pytest.mark.parametrize("touching", [False, True])
def test_factorisations_hardly_grow_with_the_mesh(system, at_most: int, touching: bool) -> None:
    """Newton's method alone takes hundreds for the string, and does not end for the beam."""
    state = solve(
        system, ActiveSet(np.full(system.offset.size, touching), np.zeros(system.offset.size, dtype=np.int8))
    )
    assert state.status is Status.CONVERGED
    assert state.iterations <= at_most


def test_units_of_single_unknowns_do_not_matter() -> None:
    """Interior-point steps are the same with each unknown in a unit of its own."""
    system, rng = beam(50), np.random.default_rng(0)
    units = sp.diags_array(10 ** rng.uniform(-4, 4, system.load.size))
    K, offset = sp.csc_array(units @ system.stiffness @ units), system.offset / units.diagonal()
    scaled = replace(system, stiffness=K, load=units @ system.load, offset=offset)
    assert abs(solve(scaled).iterations - solve(system).iterations) <= 2


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_units_of_forces_do_not_matter(factor: float) -> None:
    """Whether a node touches is read off forces and gaps, which have no common unit."""
    system = beam(50)
    scaled = replace(system, stiffness=factor * system.stiffness, load=factor * system.load)
    assert abs(solve(scaled).iterations - solve(system).iterations) <= 2


def test_a_node_that_pulls_is_let_go_where_another_one_holds_the_body() -> None:
    """Newton's method stops with nodes in touch that pull, without which the first guess is a mechanism."""
    problem = replace(
        block_in_a_corner(2), tractions=(Traction("top", (-13.0, -108.0)), Traction("right", (-88.0, 2.0)))
    )
    state = ContactSolver(problem).given
    assert state.status is Status.CONVERGED
    assert np.all(state.normal_force >= 0)


def test_of_nodes_that_leave_the_one_that_presses_most_holds_the_body() -> None:
    """Three nodes over one foundation under a body that only contact holds: one of them is enough."""
    string_of_three = replace(string(3), rigid=np.ones((3, 1)))
    before = ActiveSet(np.ones(3, dtype=bool), np.zeros(3, dtype=np.int8))
    none = replace(before, touching=np.zeros(3, dtype=bool))
    for forces in ([1.0, 3.0, 2.0], [-1.0, -2.0, -0.5]):
        state = replace(string_of_three.equilibrium(before), normal_force=np.array(forces))
        kept = holding(string_of_three, before, state, none).touching
        assert kept.tolist() == [force == max(forces) for force in forces]
    # a body that turns as well: of two nodes at one place the second holds nothing
    turning = replace(string_of_three, rigid=np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 2.0]]))
    state = replace(state, normal_force=np.array([3.0, 2.0, 1.0]))
    assert holding(turning, before, state, none).touching.tolist() == [True, False, True]


def test_a_contact_solve_that_fails_has_no_forces_to_show(monkeypatch: pytest.MonkeyPatch) -> None:
    def limited(*given: Any) -> Equilibrium:
        return replace(solve(*given), status=Status.ITERATION_LIMIT)

    problem = EXAMPLES["6.1"](4)
    assert rm.solve(problem, "fixed").record()["contact"]
    monkeypatch.setattr("rmesh_nlp.contact.solver.solve", limited)
    row = rm.solve(problem, "fixed").record()
    assert (row["status"], row["success"]) == ("iteration_limit", False)
    assert not row.get("contact")
    assert row.get("resultant") is None


@pytest.mark.parametrize("make", [of(EXAMPLES["6.1"], 8), of(EXAMPLES["6.3"], (12, 6))])
def test_the_condensed_problem_has_the_active_set_of_the_whole(make: Callable[[], ContactSystem]) -> None:
    system = make()
    solution = solve(system)
    assert (
        first_set(system).key()
        == solution.active.key()
        != ActiveSet(system.offset <= 0, 0 * solution.active.sliding).key()
    )
    assert solution.iterations == 1


def test_a_thin_body_is_condensed_to_where_contact_acts() -> None:
    """The matrix has more entries than the stiffness, and fewer than its factors."""
    load, below = Traction("top", (0.2, -1.0)), Obstacle.graph("bottom", -0.01, friction=0.1)
    thin = ContactProblem(rectangle(40, 2, x=(0, 4)), PlaneStrain(9.0, 9.0), "left", below, tractions=load)
    system = ContactSolver(thin).system(thin.mesh.p)
    last = np.unique(np.append(system.normals.indices, system.tangents.indices))
    assert system.stiffness.nnz < last.size**2
    found = system.condensed(last)
    assert found is not None
    state, condensed = solve(system), solve(found[0])
    np.testing.assert_allclose(found[1](condensed.u), state.u, rtol=0, atol=1e-9 * np.max(np.abs(state.u)))


def test_contact_on_all_unknowns_is_not_condensed() -> None:
    problem = refined(random_problem(3, kind="membrane"))
    system = ContactSolver(problem).system(np.asarray(problem.mesh.p))
    assert first_set(system).key() == at_rest(system).key() != solve(system).active.key()


def spring(gap: float, normal: float, slip: float, tangential: float, **changes: Any) -> tuple[Any, Any]:
    """One node that has moved by 2, under a force of 8, the units, with a friction bound of 4."""
    system = ContactSystem(
        stiffness=sp.csc_array(10.0 * np.eye(4)),
        load=np.array([8.0, 0.0, 0.0, 0.0]),
        constant=0.0,
        offset=np.array([gap + 1.0]),
        slip_bound=np.array([4.0]),
        **{
            "normals": sp.csr_array(np.array([[0.0, 1.0, 0.0, 0.0]])),
            "tangents": sp.csr_array(np.array([[0.0, 0.0, 1.0, 0.0]])),
            "frictional": np.ones(1, dtype=bool),
            **changes,
        },
    )
    state = Equilibrium(
        u=np.array([2.0, -1.0, slip, 0.0]),
        energy=0.0,
        normal_force=np.array([normal]),
        tangential_force=np.array([tangential]),
        active=ActiveSet(np.array([True]), np.zeros(1, dtype=np.int8)),
        status=Status.CONVERGED,
        iterations=1,
    )
    return system, state


def test_gap_and_slip_of_a_pair_at_45_degrees_are_unknowns() -> None:
    rows = np.sqrt(0.5) * np.array([[1, 1, -1, -1], [1, -1, -1 - 1e-15, 1]])
    normals, tangents = (sp.csr_array(row[None]) for row in rows)
    system, _ = spring(0.0, 0.0, 0.0, 0.0, normals=normals, tangents=tangents)
    basis = system.rotated.basis
    np.testing.assert_allclose((rows @ basis)[:, system.rotated.last], np.eye(2), atol=1e-12)
    assert np.max(np.abs(basis.data)) < 2


WEAK = [
    (0.0, 0.0, 1.0, 4.0),  # touches without a force
    (1e-6, 4e-6, 1.0, 4.0),  # half a millionth of the units
    (-1e-6, -4e-6, 1.0, 4.0),
    (0.0, 5.0, 0.0, 4.0),  # rests at the bound of friction
    (0.0, 5.0, 1e-6, -4.0 + 4e-6),
    (0.0, 5.0, -1e-6, 4.0 - 4e-6),
]
STRICT = [
    *((gap, 0.0, 1.0, 4.0) for gap in (4e-6, -4e-6, 1.0)),  # open
    *((0.0, force, 1.0, 4.0) for force in (16e-6, -16e-6)),  # pressed
    *((0.0, 5.0, slip, 4.0) for slip in (4e-6, -4e-6)),  # slides
    *((0.0, 5.0, 0.0, friction) for friction in (4.0 - 16e-6, 0.0)),  # sticks
    (1.0, 0.0, 1.0, 0.0),
]


@pytest.mark.parametrize("values", [*WEAK, *STRICT])
def test_strict_complementarity_fails_where_two_things_vanish_at_once(values: Any) -> None:
    assert bool(ContactSystem.weak(*spring(*values))[0]) == (values in WEAK)


def test_friction_counts_only_where_it_may_act_and_a_body_at_rest_where_it_touches() -> None:
    at_the_bound = (0.0, 5.0, 0.0, 4.0)
    for acts in (True, False):
        assert ContactSystem.weak(*spring(*at_the_bound, frictional=np.array([acts])))[0] == acts
    # half of a contact force of 5 stands beside the bound of 4
    assert ContactSystem.weak(*spring(0.0, 5.0, 0.0, 6.5, coulomb=np.array([0.5])))[0]
    system, _ = spring(*at_the_bound)
    # without any displacement the gap itself tells: no length is there to divide by
    rest = replace(spring(0.0, 0.0, 1.0, 4.0)[1], u=np.zeros(4))
    for gap, weak in ((0.0, True), (1e-9, False)):
        alone = replace(system, offset=np.full(1, gap), frictional=np.zeros(1, dtype=bool))
        assert alone.weak(rest)[0] == weak


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
