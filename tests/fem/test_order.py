"""Displacements of order 2: another code's contact solutions, and rates on solutions that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objective import Fields, Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem, Dirichlet, PointLoad
from support.manufactured import smooth_block, smooth_membrane
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


@pytest.mark.parametrize("seeds", [SEEDS[:6], pytest.param(SEEDS, marks=pytest.mark.slow)])
def test_contact_solutions_are_those_of_scikit_fem(seeds: range) -> None:
    kinds, parted = set(), 0
    for seed in seeds:
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
    assert parted >= len(seeds) // 4
    assert len(kinds) == 6 or len(seeds) < len(SEEDS)


def measured(problem: ContactProblem, objective: str | Objective) -> tuple[float, ContactSolver]:
    """An objective at the contact solution on the given mesh, and its solver."""
    solver = ContactSolver(problem)
    space, given = solver.discretisation.space, solver.given
    u = replace(constant_field(solver.displacement.values(given.u)), space=space)
    fields = Fields(problem, constant_field(problem.mesh.p), u, u)
    return parse_objective(objective).on(fields).evaluate()(np.zeros(0)), solver


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [smooth_membrane, smooth_block])
def test_smooth_solutions_have_full_rates(make: Any, order: int) -> None:
    """Squared errors over the number of nodes N: N^-order in the energy norm, N^-(order + 1) in L2."""
    for text, rate in (("2*error-energy", order), ("error-l2", order + 1)):
        found = [measured(make(n, order), text) for n in (6, 12)]
        nodes = [solver.discretisation.space.n_nodes for _, solver in found]
        slope = np.log(found[0][0] / found[1][0]) / np.log(nodes[1] / nodes[0])
        assert slope == pytest.approx(rate, abs=0.12 * rate)
