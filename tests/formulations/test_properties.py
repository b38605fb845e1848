"""Properties of every problem: random meshes, materials, loads, obstacles and motions.

Frame invariance, contact law, validity, and energies that never rise.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.problem import ContactProblem, signed_areas
from support.formulations import joint, nested
from support.frames import turned
from support.problems import shuffled

pytestmark = pytest.mark.slow
SEEDS = st.integers(0, 10**6)


def drawn(seed: int) -> ContactProblem:
    """A random problem, of order 2 for odd seeds."""
    return replace(random_problem(seed), order=1 + seed % 2)


FEW = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@FEW
@given(SEEDS, st.floats(0, 6.3), st.floats(-5, 5), st.floats(-5, 5))
def test_energy_does_not_depend_on_the_frame(seed: int, angle: float, a: float, b: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here = drawn(seed)
    there = turned(here, turn, np.array([a, b]))
    one, two = (ContactSolver(p).solve(p.mesh.p) for p in (here, there))
    assert two.energy == pytest.approx(one.energy, rel=1e-8, abs=1e-10)
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-7)
    np.testing.assert_allclose(two.tangential_force, one.tangential_force, atol=1e-7)


@FEW
@given(SEEDS)
def test_energy_does_not_depend_on_the_numbering(seed: int) -> None:
    problem = drawn(seed)
    mesh = problem.mesh
    renumbered, new = shuffled(mesh, seed)
    other = replace(problem, mesh=renumbered)
    one, two = ContactSolver(problem).solve(mesh.p), ContactSolver(other).solve(renumbered.p)
    assert two.energy == pytest.approx(one.energy, rel=1e-10, abs=1e-12)
    values = [
        solver.displacement.values(state.u)[:, : mesh.p.shape[1]]
        for solver, state in ((ContactSolver(other), two), (ContactSolver(problem), one))
    ]
    np.testing.assert_allclose(values[0][:, new], values[1], atol=1e-10)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SEEDS, st.sampled_from([joint, nested]))
def test_relocation_never_inverts_an_element_nor_raises_the_energy(seed, formulation):
    # a rule of high degree and gaps along edges: with the degree 3 and the nodal gaps of these problems some
    # optima are those of the rule, or penetration between contact nodes
    problem = with_edge_gaps(replace(drawn(seed), quadrature=8))
    solution = formulation.solve(problem)
    assert solution.success, solution.status
    assert solution.energy <= solution.energy_initial + 1e-9 * abs(solution.energy_initial)
    areas = signed_areas(solution.mesh.p, problem.triangles)
    ratio = areas / signed_areas(problem.mesh.p, problem.triangles)
    assert np.min(ratio) >= problem.motion.min_area_fraction * (1 - 1e-6)
    delta = problem.motion.delta
    if isinstance(delta, tuple):
        assert np.all(np.abs(solution.mesh.p - problem.mesh.p) <= np.array(delta)[:, None] * (1 + 1e-9))
