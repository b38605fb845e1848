"""Displacements of order 2: another code's contact solutions, and rates on solutions that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.problem import ContactProblem, Dirichlet, PointLoad
from support.second_order import SecondOrder

SEEDS = range(20)


def varied(seed: int) -> ContactProblem:
    """A random problem of order 2, half of them with a second support or a point load; exact rules."""
    problem = replace(random_problem(seed), order=2, quadrature=12)
    if seed % 4 == 1:
        (left,) = problem.supports
        rise = left.value[0]
        above = Dirichlet("top", (lambda x, y: rise + 0.02 * x * x,))
        other = above if problem.components == 1 else Dirichlet("right", (0.005, None))
        problem = replace(problem, dirichlet=(left, other))
    if seed % 4 == 3:
        node = int(np.argmax(np.sum(problem.mesh.p, axis=0)))
        problem = replace(problem, point_loads=(PointLoad(node, (0.9,) * problem.components),))
    return problem


def test_contact_solutions_are_those_of_scikit_fem() -> None:
    kinds, parted = set(), 0
    for seed in SEEDS:
        problem = varied(seed)
        values, energy = SecondOrder(problem).solve()
        solver = ContactSolver(problem)
        found = solver.given
        u = solver.discretisation.space.values(solver.displacement.values(found.u))
        assert found.energy == pytest.approx(energy, rel=1e-10)
        np.testing.assert_allclose(u, values, atol=1e-9 * np.max(np.abs(values)))
        touching = found.active.touching
        parted += 0 < np.sum(touching) < touching.size
        kinds.add((problem.components, problem.frictional, len(problem.regions)))
    assert parted >= 5
    assert len(kinds) == 6
