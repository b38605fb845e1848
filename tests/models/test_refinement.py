"""Local refinement, its indicators, hr, and what a relocation is said to be worth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import l_shape, rectangle
from rmesh_nlp.models.hr import EFFECTIVITY, _stage, hr, reference_as_given
from rmesh_nlp.models.regularisation import edge_gains, marked
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    Traction,
    signed_areas,
)
from rmesh_nlp.problem.contact_problem import locally_refined, refined
from rmesh_nlp.solving import advice as advising
from rmesh_nlp.solving.advice import advise, recommended
from support.formulations import auto


def example(n: int = 8) -> ContactProblem:
    return replace(EXAMPLES["6.1"](n=n), motion=Motion(None), quadrature=6)


def error(problem: ContactProblem) -> float:
    return ContactSolver(replace(problem, quadrature=10)).solve(problem.mesh.p).energy - problem.exact.energy


@pytest.mark.parametrize("seed", range(5))
def test_refinement_keeps_domain_names_and_old_nodes(seed: int) -> None:
    problem = random_problem(seed)
    fine = locally_refined(problem, np.array([0, 3]))
    one, two = problem.mesh, fine.mesh
    assert two.t.shape[1] > one.t.shape[1]
    np.testing.assert_allclose(two.p[:, : one.p.shape[1]], one.p)
    whole = [signed_areas(p.mesh.p, p.triangles).sum() for p in (problem, fine)]
    assert whole[0] == pytest.approx(whole[1], rel=1e-12)
    for name in one.boundaries:
        lengths = [
            np.linalg.norm(np.diff(m.p[:, m.facets[:, m.boundaries[name]]], axis=1), axis=0).sum()
            for m in (one, two)
        ]
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    # nested spaces: the energy cannot rise (loads of low degree, so that quadrature has no say)
    assert set(two.subdomains or {}) == set(one.subdomains or {})


def test_marked_triangles_have_their_share_and_no_more_than_needed() -> None:
    values = np.array([1.0, 5.0, 2.0, 2.0])
    np.testing.assert_array_equal(marked(values, 0.5), [1])
    np.testing.assert_array_equal(np.sort(marked(values, 0.65)), [1, 2])
    assert marked(np.zeros(3)).size == 0


@pytest.mark.slow
def test_adaptive_refinement_beats_uniform_refinement() -> None:
    problem = example()
    while problem.mesh.p.shape[1] < 200:
        problem = locally_refined(problem, marked(edge_gains(problem)))
    assert problem.mesh.p.shape[1] < 289
    assert error(problem) < 0.7 * error(example(16))


@pytest.mark.slow
def test_edge_gains_estimate_the_error() -> None:
    for n in (8, 16, 32):
        assert edge_gains(example(n)).sum() == pytest.approx(EFFECTIVITY * error(example(n)), rel=0.15)


def test_the_gain_of_one_edge_by_hand() -> None:
    # the unit square cut in two, all corners held: the hat on the middle of the diagonal has
    # the integral 1/3 and the energy norm squared 4, so that the load 3 gains 1^2 / (2 * 4)
    problem = ContactProblem(
        rectangle(1, 1), Laplace(3.0), ("left", "right", "bottom", "top"), motion=Motion(None)
    )
    np.testing.assert_allclose(edge_gains(problem), [1 / 16, 1 / 16], rtol=1e-9)


@pytest.mark.slow
def test_hr_needs_fewer_nodes_than_refinement() -> None:
    stages = hr(example(), nodes=150)
    nodes = [stage.problem.mesh.p.shape[1] for stage in stages]
    assert nodes[0] == 81
    assert nodes[-1] >= 150
    assert np.all(np.diff(nodes) > 0)
    energies = [stage.energy for stage in stages]
    assert np.all(np.diff(energies) < 0)
    assert error(stages[-1].problem) < 0.3 * error(example(16))
    assert stages[-1].error_estimate < stages[0].error_estimate


def test_hr_compares_elements_with_the_mesh_as_given_and_none_with_a_flat_one() -> None:
    p = np.array([[0.0, 1.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 1.0, 0.0]])
    # node 4 is amid the lower side: the first triangle is flat where its nodes were
    shapes = reference_as_given(p, np.array([[0, 4, 1], [4, 2, 3]]).T)
    flat, good = shapes[:, :, 0], shapes[:, :, 1]
    np.testing.assert_array_equal(good, p[:, [4, 2, 3]])
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    assert a[0] * b[1] - a[1] * b[0] > 0
    assert np.linalg.norm(a) == pytest.approx(np.linalg.norm(b))
    assert a @ b == pytest.approx(a @ a / 2)


def test_hr_refuses_what_it_cannot_do() -> None:
    with pytest.raises(BadInputError, match="number of nodes"):
        hr(example())
    with pytest.raises(BadInputError, match="boxes"):
        hr(EXAMPLES["6.1"](n=4), nodes=100)


@pytest.mark.slow
def test_the_error_reduction_of_a_solution() -> None:
    found = auto.solve(example()).record()["error_reduction"]
    assert found["source"] == "exact"
    assert found["factor"] == pytest.approx(found["error_initial"][0] / found["error"][0])
    assert found["error_initial"][0] == pytest.approx(error(example()), rel=1e-6)
    other = auto.solve(replace(example(), exact=None)).record()["error_reduction"]
    assert other["source"] == "refinement"
    assert other["factor"] <= found["factor"] <= other["factor_upper"]


@pytest.mark.slow
@pytest.mark.parametrize("flips", [False, True])
def test_the_interval_holds_where_the_solution_is_singular(flips: bool) -> None:
    problem = ContactProblem(l_shape(1 / 6), Laplace(1.0), ("corner", "outer"), motion=Motion(None))
    solution = auto.solve(problem, flips=flips)
    exact = -0.2140758036 / 2
    before, after = solution.energy_initial_audited - exact, solution.audit.energy_audited - exact
    claimed = solution.record()["error_reduction"]
    assert claimed["error_initial"][0] <= before <= claimed["error_initial"][1]
    assert claimed["factor"] <= before / after <= claimed["factor_upper"]
    assert claimed["factor"] > 0.75 * before / after


def test_advice_on_a_parabola_knows_its_error_and_trusts_the_least_factor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    claimed: list[ErrorReduction] = []

    def reduction(before: Admissible, *given: Any) -> tuple[ErrorReduction, None]:
        claimed.append(ErrorReduction((0.1, 0.1), (0.05, 0.09), 1.1, 2.0, "refinement", 16, 3))
        return claimed[-1], None

    problem = ContactProblem(rectangle(3, 3), Laplace(1.0), ("left", "right"), motion=Motion(None))
    monkeypatch.setattr(advising, "error_reduction", reduction)
    advice = advise(problem, {"iterations": 2})
    assert advice.error == pytest.approx(1 / (24 * 9), rel=1e-6)
    assert advice.rate == pytest.approx(1.0, rel=1e-6)
    assert advice.relocation is claimed[-1]
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


def test_the_error_of_a_stage_is_the_gain_of_its_edges_over_their_effectivity() -> None:
    stage = _stage(example(3), 0, 0)
    assert stage.error_estimate == pytest.approx(edge_gains(stage.problem).sum() / EFFECTIVITY)
