"""Refinement, flips and relocation in turn, and the advice that rests on them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models import hr as module
from rmesh_nlp.models.cascade import CascadeSettings
from rmesh_nlp.models.hr import EFFECTIVITY, _with_new_nodes, hr, reference_as_given
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import edge_gains
from rmesh_nlp.optimize.trust_region import NewtonResult
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from rmesh_nlp.solving import advice as advising
from rmesh_nlp.solving.advice import advise, recommended
from support.problems import energy_error, signorini


@pytest.mark.parametrize("seed", range(5))
def test_refinement_keeps_domain_names_and_old_nodes(seed: int) -> None:
    problem = random_problem(seed)
    fine = locally_refined(problem, np.array([0, 3]))
    one, two = problem.mesh, fine.mesh
    assert two.t.shape[1] > one.t.shape[1]
    np.testing.assert_allclose(two.p[:, : one.p.shape[1]], one.p)

    def sizes(p: ContactProblem) -> list[float]:
        """The area, and the length of every boundary."""
        edges = (p.mesh.facets[:, facets] for facets in p.mesh.boundaries.values())
        lengths = [np.linalg.norm(np.diff(p.mesh.p[:, edge], axis=1), axis=0).sum() for edge in edges]
        return [signed_areas(p.mesh.p, p.triangles).sum(), *lengths]

    assert sizes(fine) == pytest.approx(sizes(problem), rel=1e-12)
    assert list(two.boundaries) == list(one.boundaries)
    assert set(two.subdomains or {}) == set(one.subdomains or {})


def test_stages_refine_until_there_are_enough_nodes_or_the_error_is_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings, descend, gains = CascadeSettings(iterations=8, brief=4), module.descend, []

    def noted(energy: ReducedEnergy, q: np.ndarray, **options: Any) -> NewtonResult:
        whole = edge_gains(energy.relocation.problem).sum() / EFFECTIVITY
        gains.append((options["reference"] - energy(q).value) / whole)
        return descend(energy, q, **options)

    monkeypatch.setattr(module, "descend", noted)
    stages = hr(signorini(4), nodes=30, settings=settings)
    nodes = [stage.problem.mesh.p.shape[1] for stage in stages]
    assert nodes[0] == 25
    assert nodes[-2] < 30 <= nodes[-1]
    assert np.all(np.diff([stage.energy for stage in stages]) < 0)
    last = stages[-1]
    assert gains[0] == pytest.approx(1)  # what is gained counts from the whole error
    assert last.error_estimate == pytest.approx(edge_gains(last.problem).sum() / EFFECTIVITY)
    assert last.energy == pytest.approx(ContactSolver(last.problem).solve(last.problem.mesh.p).energy)
    assert last.problem.reference is None
    (only,) = hr(signorini(4), error=stages[0].error_estimate, settings=settings)
    assert only.energy == stages[0].energy
    assert len(hr(signorini(4), nodes=9999, settings=settings, max_stages=1)) == 1


def test_new_nodes_are_amid_their_edges_on_the_mesh_as_given() -> None:
    given = rectangle(3, 3).p
    problem = ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(None))
    moved = replace(problem, mesh=replace(problem.mesh, doflocs=problem.mesh.p**2))
    fine = locally_refined(moved, np.array([2, 7]))
    found = _with_new_nodes(given, moved, fine)
    assert found.shape == fine.mesh.p.shape
    # amid an edge of the 3 by 3 grid as given: multiples of 1/6
    np.testing.assert_allclose(6 * found, np.rint(6 * found), atol=1e-12)
    np.testing.assert_array_equal(found[:, : given.shape[1]], given)


def test_elements_are_compared_with_the_mesh_as_given_and_none_with_a_flat_one() -> None:
    p = np.array([[0.0, 1.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 1.0, 0.0]])
    # node 4 is amid the lower side: the first triangle is flat where its nodes were
    shapes = reference_as_given(p, np.array([[0, 4, 1], [4, 2, 3], [1, 4, 2]]).T)
    flat, good = shapes[:, :, 0], shapes[:, :, 1]
    np.testing.assert_array_equal(good, p[:, [4, 2, 3]])
    # node 4 has a third of the area 1/2, the others of the flat one nothing: inverted elements count as none
    assert signed_areas(flat, np.arange(3)[:, None]) == pytest.approx(1 / 18)
    sides = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=0)
    np.testing.assert_allclose(sides, sides[0])


def test_hr_refuses_what_it_cannot_do() -> None:
    with pytest.raises(BadInputError, match="number of nodes"):
        hr(signorini())
    with pytest.raises(BadInputError, match=r"boxes|move limits"):
        hr(EXAMPLES["6.1"](n=4), nodes=100)


@pytest.mark.slow
def test_hr_needs_fewer_nodes_than_refinement() -> None:
    stages = hr(signorini(), nodes=150)
    assert np.all(np.diff([stage.problem.mesh.p.shape[1] for stage in stages]) > 0)
    assert energy_error(stages[-1].problem) < 0.3 * energy_error(signorini(16))
    assert stages[-1].error_estimate < stages[0].error_estimate


def test_advice_on_a_parabola_knows_its_error_and_trusts_the_least_factor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    claimed = ErrorReduction((0.1, 0.1), (0.05, 0.09), 1.1, 2.0, "refinement", 16, 3)
    problem = ContactProblem(rectangle(3, 3), Laplace(1.0), ("left", "right"), motion=Motion(None))
    monkeypatch.setattr(advising, "error_reduction", lambda *_: (claimed, None))
    advice = advise(problem, {"iterations": 2})
    assert advice.error == pytest.approx(1 / (24 * 9), rel=1e-6)
    assert advice.rate == pytest.approx(1.0, rel=1e-6)
    assert advice.relocation is claimed
    assert advice.recommendation.startswith("refine uniformly")  # 1.1 is sure, 2.0 is not


@pytest.mark.slow
def test_advice_does_not_praise_penetration_between_contact_nodes() -> None:
    problem = ContactProblem(
        rectangle(8, 4, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("left", (0.0, None)),),
        tractions=(Traction("top", (0.0, -20.0)),),
        obstacle=Obstacle.curve("bottom", lambda x, y: y + 0.1 * (x - 1) ** 2),
        motion=Motion(None),
    )
    advice = advise(problem)
    # with gaps at nodes the energy falls by more than the whole error, by pulling nodes apart
    assert advice.relocation is None or advice.relocation.factor < 20
    energies = [admissible(problem).energy]
    for _ in range(3):
        problem = refined(problem)
    energies.append(admissible(problem).energy)
    assert advice.error == pytest.approx(energies[0] - energies[1], rel=0.4)


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ((1.1, 1.0), "refine uniformly"),
        ((1.49, 0.84), "refine locally"),
        ((1.51, 0.86), "relocate"),
        ((1.51, 0.84), "both"),
    ],
)
def test_what_is_recommended(figures: tuple[float, float], words: str) -> None:
    assert recommended(*figures).startswith(words)
