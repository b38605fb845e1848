"""Random design problems: sizes, repeatability, and the design that obeys all constraints."""

from __future__ import annotations

import numpy as np
import pytest

from random_designs import random_design
from rmesh_nlp.solving.outer import Outer

SEEDS = (0, 5, 6, 7, 8, 19)


@pytest.mark.parametrize("seed", SEEDS)
def test_stated_design_obeys_all_constraints(seed: int) -> None:
    found = random_design(seed)
    outer = Outer.of(found.problem, found.objective)
    shapes = found.problem.shape_motions
    amplitudes = [found.feasible[shape.name] for shape in found.problem.shapes]
    nodes = found.problem.mesh.p + np.tensordot(amplitudes, shapes, 1)
    q = outer.variables(nodes, design=found.feasible)
    assert outer.design(q) == pytest.approx(found.feasible)
    assert 3 <= outer.n <= 200
    assert outer.merit(outer.function(q))[0] == 0.0


def test_seed_determines_the_problem() -> None:
    one, two = random_design(5), random_design(5)
    assert (one.objective, one.feasible) == (two.objective, two.feasible)
    np.testing.assert_array_equal(one.problem.mesh.p, two.problem.mesh.p)
    assert [str(c) for c in one.problem.constraints] == [str(c) for c in two.problem.constraints]
    assert random_design(6).feasible != one.feasible


@pytest.mark.slow
def test_kinds_of_problems() -> None:
    problems = [random_design(seed).problem for seed in range(20)]
    obstacles = [problem.contact_sets[0].obstacle for problem in problems]
    assert any(obstacle.has_coulomb for obstacle in obstacles)
    assert any(obstacle.has_bound for obstacle in obstacles)
    assert any(not obstacle.frictional for obstacle in obstacles)
    assert any(obstacle.level is not None for obstacle in obstacles)
    assert {problem.components for problem in problems} == {1, 2}
    assert {problem.motion.is_fixed for problem in problems} == {True, False}
    assert {bool(problem.constraints) for problem in problems} == {True, False}
