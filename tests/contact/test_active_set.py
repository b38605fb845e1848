"""The active set solves the convex quadratic program: its laws hold, from any start."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.contact.active_set import at_rest, first_set, solve
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from support.contact_geometry import block_between_two_foundations, block_sliding_on_a_circle
from support.problems import sloped_block


def random_system(seed: int) -> ContactSystem:
    """A stiffness that is far from an M-matrix, where block changes alone may cycle."""
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
    )


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
    **{f"random {seed}": (lambda seed=seed: random_system(seed)) for seed in range(3)},
}


@pytest.fixture(params=SYSTEMS)
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


def test_contact_on_all_unknowns_is_not_condensed() -> None:
    problem = refined(random_problem(3, kind="membrane"))
    system = ContactSolver(problem).system(np.asarray(problem.mesh.p))
    assert first_set(system).key() == at_rest(system).key() != solve(system).active.key()
