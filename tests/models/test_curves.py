"""Nodes that slide along curves: outer variables, formulations, refined and coarsened meshes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.arcs import strain_energy
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.models.levels import coarsened
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from rmesh_nlp.solving.solution import Solution
from support.curved import HOLE, disc, plate
from support.formulations import auto, joint, mpcc, nested

ARC = Circle((0.0, 1.0), 1.0)


def off(problem: ContactProblem, mesh: Any, name: str, circle: Circle) -> float:
    """Largest distance of a boundary's nodes from a circle."""
    away = mesh.p[:, problem.boundary_nodes((name,))] - np.array(circle.centre)[:, None]
    return float(np.max(np.abs(np.hypot(*away) - circle.radius)))


def moved(problem: ContactProblem, solution: Solution, name: str) -> float:
    nodes = problem.boundary_nodes((name,))
    return float(np.max(np.abs(solution.mesh.p[:, nodes] - problem.mesh.p[:, nodes])))


def test_outer_variables_are_found_again_and_limits_are_lengths_of_the_curve() -> None:
    problem = plate({"hole": HOLE}, delta=0.3)
    free, hole = MeshMap.of(problem), problem.boundary_nodes(("hole",))
    q = np.random.default_rng(0).uniform(-1, 1, free.n)
    np.testing.assert_allclose(free.q_of(free.positions.values(q)), q, atol=1e-12)
    assert np.all(free.mobility[hole] == Mobility.SLIDING)
    there, here = (
        np.arctan2(*(p[:, hole] - 5)[::-1]) for p in (free.positions.values(np.ones(free.n)), problem.mesh.p)
    )
    np.testing.assert_allclose(2.5 * np.angle(np.exp(1j * (there - here))), 0.3)


def test_pinned_beats_a_curve_and_ends_of_an_arc_stay() -> None:
    problem = disc({"arc": ARC})
    arc = problem.boundary_nodes(("arc",))
    assert np.sum(MeshMap.of(problem).mobility[arc] == Mobility.PINNED) == 2
    still = replace(problem, motion=Motion(None, pinned=("arc",), curves={"arc": ARC}))
    assert np.all(MeshMap.of(still).mobility[arc] == Mobility.PINNED)
    assert ContactSolver(still).solve(still.mesh.p).energy > 0


def test_nodes_that_are_nearly_on_the_curve_are_put_onto_it() -> None:
    circle = Circle((5.0, 5.0), 2.5 + 1e-7)
    nearly = plate({"hole": circle})
    assert off(nearly, nearly.mesh, "hole", circle) < 1e-12


def test_refined_and_coarsened_meshes_have_their_nodes_on_the_curve() -> None:
    problem = plate({"hole": HOLE}, h=1.2)
    fine, local, coarse = refined(problem), locally_refined(problem, np.arange(40)), coarsened(problem, 30)
    assert coarse is not None
    assert max(off(other, other.mesh, "hole", HOLE) for other in (fine, local, coarse)) < 1e-12
    assert coarse.boundary_nodes(("hole",)).size < problem.boundary_nodes(("hole",)).size
    polygon = refined(problem, polygon=True)
    assert (set(fine.motion.curves), set(polygon.motion.curves)) == ({"hole"}, set())
    areas = [signed_areas(one.mesh.p, one.triangles).sum() for one in (polygon, problem)]
    assert areas[0] == pytest.approx(areas[1], rel=1e-13)


@pytest.mark.slow
def test_formulations_agree_on_the_circle_and_gain_more_than_with_the_hole_fixed() -> None:
    problem, still = plate({"hole": HOLE}, delta=0.15), plate(delta=0.15)
    found, without = [one.solve(problem) for one in (joint, nested, mpcc)], joint.solve(still)
    for solution in found:
        assert solution.status.value == "converged"
        assert off(problem, solution.mesh, "hole", HOLE) < 1e-12
        assert solution.energy_initial - solution.energy > 1.1 * (without.energy_initial - without.energy)
        np.testing.assert_allclose(solution.energy, found[0].energy, rtol=1e-8)
    assert moved(problem, found[0], "hole") > 0.05
    assert moved(still, without, "hole") == 0


@pytest.mark.slow
def test_auto_slides_along_the_arc_of_a_disc() -> None:
    problem = disc({"arc": ARC})
    solution = auto.solve(problem)
    assert solution.success
    assert off(problem, solution.mesh, "arc", ARC) < 1e-12
    assert moved(problem, solution, "arc") > 1e-3
    assert solution.record()["error_reduction"]["factor"] > 1.35


HALF = 0.5
"""Half the angle of an arc of the unit circle. The tangents at its ends meet at the distance 1.14."""


@pytest.mark.parametrize("order", [1, 2])
def test_a_triangle_that_its_arc_folds_has_no_energy(order: int) -> None:
    """So a solver shortens its steps to there, and does not find the minus infinity behind."""
    energy = strain_energy(Laplace(), Circle((0.0, 0.0), 1.0), order)
    u = np.arange(float(energy.size1_in(2)))
    for apex, upright in ((1.3, True), (1.7, True), (1.1, False), (0.9, False)):
        found = float(energy([HALF, -HALF], [apex, 0.0], u)[0])
        assert bool(np.isfinite(found)) is upright


def test_relocation_of_order_2_beside_a_hole_is_not_lost_in_folded_triangles() -> None:
    solution = joint.solve(replace(plate({"hole": HOLE}), order=2))
    assert solution.status is Status.CONVERGED
    assert solution.gain_audited > 0.03
