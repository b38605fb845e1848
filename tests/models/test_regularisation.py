"""What relocation can gain: edge gains, marking, the estimated error, and weights of a distortion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.edge_gains import edge_gains, marked
from rmesh_nlp.models.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.problem.contact_problem import locally_refined
from support.problems import energy_error, no_move_limits, signorini

EFFECTIVITY = 0.65
"""Sum of the gains over the error of the energy, on Example 6.1 refined locally: 0.60 to 0.73."""


def test_marked_triangles_have_their_share_and_no_more_than_needed() -> None:
    values = np.array([1.0, 5.0, 2.0, 2.0])
    np.testing.assert_array_equal(marked(values), [1])
    np.testing.assert_array_equal(marked(values, 0.5), [1])
    np.testing.assert_array_equal(np.sort(marked(values, 0.65)), [1, 2])
    np.testing.assert_array_equal(np.sort(marked(values, 0.95)), [0, 1, 2, 3])
    assert marked(np.zeros(3)).size == 0


def test_the_gain_of_one_edge_by_hand() -> None:
    # the unit square cut in two, all corners fixed: the hat on the middle of the diagonal has
    # the integral 1/3 and the energy norm squared 4, so that the load 3 gains 1^2 / (2 * 4)
    sides = ("left", "right", "bottom", "top")
    problem = ContactProblem(rectangle(1, 1), Laplace(3.0), sides, motion=Motion(None))
    np.testing.assert_allclose(edge_gains(problem), [1 / 16, 1 / 16], rtol=1e-9)


def test_edges_of_the_boundary_gain_unless_they_are_fixed_at_both_ends() -> None:
    # with the left side alone fixed the right corners have 4/3 and 5/3, and the gains by hand are 2/27 below,
    # 1/216 on the right, 1/24 above and 1/18 on the diagonal
    problem = ContactProblem(rectangle(1, 1), Laplace(3.0), ("left",), motion=Motion(None))
    np.testing.assert_allclose(np.sort(edge_gains(problem)), [15 / 216, 23 / 216], rtol=1e-9)


@pytest.mark.slow
def test_edge_gains_estimate_the_error_and_adaptive_refinement_beats_uniform_refinement() -> None:
    for n in (8, 16, 32):
        assert edge_gains(signorini(n)).sum() == pytest.approx(
            EFFECTIVITY * energy_error(signorini(n)), rel=0.15
        )
    problem = signorini()
    while problem.mesh.p.shape[1] < 200:
        problem = locally_refined(problem, marked(edge_gains(problem)))
    assert problem.mesh.p.shape[1] < 289
    assert energy_error(problem) < 0.7 * energy_error(signorini(16))


def test_the_gain_is_estimated_well_where_the_error_is_known() -> None:
    problem = replace(no_move_limits(EXAMPLES["6.1"](n=16)), quadrature=8)
    estimate = gain_estimate(problem)
    assert estimate.value == pytest.approx(estimate.energy - problem.exact.energy, rel=0.1)


def test_a_weight_means_the_same_in_every_unit() -> None:
    problem = no_move_limits(EXAMPLES["6.3"]((6, 3)))
    law = problem.law
    stiffer = replace(
        problem,
        law=replace(law, lame_lambda=1e3 * law.lame_lambda, lame_mu=1e3 * law.lame_mu),
        tractions=tuple(replace(t, value=tuple(1e3 * v for v in t.value)) for t in problem.tractions),
        obstacle=replace(problem.obstacle, friction=1e3 * problem.obstacle.friction),
    )
    one, two = gain_estimate(problem), gain_estimate(stiffer)
    assert one.value > 0
    assert two.value == pytest.approx(1e3 * one.value, rel=1e-9)


@pytest.mark.parametrize("bad", [-1.0, float("nan"), (), (0.0, 1.0), "much", (1.0, None), float("inf")])
def test_bad_weights_are_refused(bad: object) -> None:
    with pytest.raises(BadInputError, match="regularisation"):
        weights(bad)  # type: ignore[arg-type]


def test_weights_and_objectives() -> None:
    assert (weights(0.01), weights((1, 0.1, 0)), weights("1, 0.1")) == ((0.01,), (1.0, 0.1, 0.0), (1.0, 0.1))
    assert regularised(2.0, 0, "quality").is_energy
    assert regularised(2.0, 0.1, "quality").text == "energy + 0.2*quality"
    with pytest.raises(BadInputError, match="oval"):
        regularised(2.0, 0.1, "oval")
