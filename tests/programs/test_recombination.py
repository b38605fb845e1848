"""Two solutions recombined block by block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formulations import nested
from rmesh_nlp.discretisation.validity import ROUNDING, least_angles
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.programs.recombination import Recombination
from rmesh_nlp.solution.referee import Referee


def random_unknowns(referee: Referee, seed: int) -> np.ndarray:
    """Random moves with their own contact solution."""
    q = referee.start(seed)
    return referee.reduced.point(q, referee.reduced(q).equilibrium)


@pytest.mark.parametrize(("name", "size"), [("6.1", 8), ("6.2", (12, 6)), ("6.3", (12, 6))])
@pytest.mark.parametrize("across", [2, 4])
def test_the_energy_never_rises_and_every_unknown_comes_from_one_of_the_two(name, size, across) -> None:
    referee = Referee(EXAMPLES[name](size))
    relocation = referee.relocation
    energy = relocation.assembled.grad_f
    x, other = random_unknowns(referee, 1), random_unknowns(referee, 2)
    mixed = Recombination(relocation)(x, other, across, shift=0.5)
    assert np.all((mixed == x) | (mixed == other))
    assert float(energy(mixed, [])[0]) <= float(energy(x, [])[0])
    # for random moves some blocks are better in one and some in the other
    assert np.any(mixed != x)
    # and the contact problem at the mixed mesh can only lower the energy further
    assert referee.reduced(mixed[: relocation.n_q]).value <= float(energy(mixed, [])[0]) + 1e-12


def test_elements_stay_valid_where_boxes_are_large() -> None:
    referee = Referee(EXAMPLES["6.1"](4, 0.25))  # blocks gain by inverted elements
    relocation = referee.relocation
    x, other = random_unknowns(referee, 3), random_unknowns(referee, 4)
    mixed = Recombination(relocation)(x, other, 2, shift=0.0)
    problem = referee.problem
    ratio = signed_areas(relocation.nodes(mixed[: relocation.n_q]), problem.triangles) / signed_areas(
        problem.mesh.p, problem.triangles
    )
    assert ratio.min() >= problem.motion.min_area_fraction


@pytest.mark.slow
def test_a_pair_of_descents_ends_lower_than_either() -> None:
    # fine enough for domains of patterns; on 48 squares the pair ends at its limit of iterations, at 2e-6
    problem = EXAMPLES["6.1"](32)
    single = nested.solve(problem, outer="newton")
    pair = nested.solve(problem, outer="newton-pair")
    assert pair.success
    assert pair.stationarity == "KKT"
    assert pair.energy < single.energy
    # energies of the two descents and of the last one, in one history
    assert pair.iterations == pair.history[-1].iteration


@pytest.mark.slow
def test_a_pair_of_descents_keeps_elements_valid_in_large_boxes_and_with_a_least_angle() -> None:
    problem = EXAMPLES["6.1"](6, 0.12)
    for motion in (problem.motion, replace(problem.motion, min_angle=12.0)):
        solution = nested.solve(replace(problem, motion=motion), outer="newton-pair")
        assert solution.energy < solution.energy_initial
        assert solution.audit.min_area_ratio >= motion.min_area_fraction - ROUNDING
        least = np.min(least_angles(np.asarray(solution.mesh.p), problem.triangles))
        assert least >= motion.min_angle - np.rad2deg(ROUNDING)
