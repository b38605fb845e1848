"""The energy with a distortion: derivatives, barrier, weights, descents without boxes."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.distortion import DISTORTIONS, distortion_group
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.models.regularised_descent import KEPT, descend, longest_valid, node_widths
from rmesh_nlp.models.second_derivatives import Curvature
from rmesh_nlp.problem import ContactProblem, Motion, signed_areas
from support.problems import sloped_block


def without_boxes(problem: ContactProblem) -> ContactProblem:
    return replace(problem, motion=replace(problem.motion, delta=None))


PROBLEMS = {
    "6.1": lambda: replace(without_boxes(EXAMPLES["6.1"](n=4)), quadrature=4),
    "6.3": lambda: without_boxes(EXAMPLES["6.3"]((6, 3))),
    "sloped, stick and slip": lambda: without_boxes(sloped_block()),
}


def reduced(problem: ContactProblem, text: str) -> ReducedEnergy:
    return ReducedEnergy(relocation(problem, parse_objective(text)))


@pytest.mark.parametrize("distortion", DISTORTIONS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_first_and_second_derivatives(name: str, distortion: str) -> None:
    energy = reduced(PROBLEMS[name](), f"energy + 0.1*{distortion}")
    rng = np.random.default_rng(3)
    q = 0.1 * rng.uniform(-1, 1, energy.relocation.n_q)
    d = rng.uniform(-1, 1, q.size)
    here = energy(q)
    Hd = Curvature(energy).at(here)(d)
    steps = 4e-3 * 0.5 ** np.arange(5)
    there = [energy(q + h * d) for h in steps]
    assert all(np.array_equal(p.equilibrium.active.touching, here.equilibrium.active.touching) for p in there)
    first = [abs(p.value - here.value - h * here.gradient @ d) for p, h in zip(there, steps, strict=True)]
    second = [np.linalg.norm(p.gradient - here.gradient - h * Hd) for p, h in zip(there, steps, strict=True)]
    for remainder in (first, second):
        assert np.log2(np.array(remainder)[:-1] / np.array(remainder)[1:])[-1] >= 1.9


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_a_distortion_is_zero_at_first_grows_without_bound_and_ends_where_an_element_does(
    distortion: str,
) -> None:
    energy = reduced(PROBLEMS["6.1"](), f"energy + 1*{distortion}")
    rel = energy.relocation
    values, q = [], np.zeros(rel.n_q)
    index = rel.mesh_map.positions.index
    node = int(np.flatnonzero(np.all(index >= 0, axis=0))[0])
    d = np.zeros(rel.n_q)
    d[index[0, node]] = 1.0
    # along d some element at the node loses its area: the first root is found by bisection
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        valid = np.min(signed_areas(rel.nodes(middle * d), rel.problem.triangles)) > 0
        low, high = (middle, high) if valid else (low, middle)
    values = [energy.of_positions(q + (1 - 10.0**-k) * low * d) for k in range(1, 8)]
    assert energy.of_positions(q) == pytest.approx(0, abs=1e-12)
    assert np.all(np.diff(values) > 0)
    assert values[-1] > 1e4
    assert np.isnan(energy.of_positions(1.01 * high * d))


def test_distortions_of_a_stretched_mesh_by_hand() -> None:
    problem = PROBLEMS["6.1"]()
    a, b = 2.0, 0.25  # along x and y: |A|^2 = a^2 + b^2, det A = a b
    stretched = constant_field(problem.mesh.p * np.array([[a], [b]]))
    shape, size = (a**2 + b**2) / (2 * a * b) - 1, (a * b + 1 / (a * b) - 2) / 2
    elastic = (a**2 + b**2 + a**-2 + b**-2) / 4 - 1
    for name, value in {"quality": shape, "shape-size": shape + size, "elastic": elastic}.items():
        (found,) = element_values([distortion_group(problem, stretched, name)])(np.zeros(0))
        assert found.sum() == pytest.approx(value)


def test_the_distortion_stands_in_the_place_of_area_constraints_but_not_of_angles() -> None:
    problem = PROBLEMS["6.1"]()
    assert relocation(problem).n_valid == problem.mesh.t.shape[1]
    assert relocation(problem, parse_objective("energy + 0.1*quality")).n_valid == 0
    angles = replace(problem, motion=replace(problem.motion, min_angle=10))
    assert relocation(angles, parse_objective("energy + 0.1*quality")).n_valid == 4 * problem.mesh.t.shape[1]


def test_other_terms_do_not_collapse() -> None:
    with pytest.raises(ValueError, match="error-l2"):
        relocation(PROBLEMS["6.1"](), parse_objective("error-l2 + 0.1*quality"))


def test_a_weight_means_the_same_in_every_unit() -> None:
    problem = PROBLEMS["6.3"]()
    stiffer = replace(
        problem,
        law=replace(
            problem.law, lame_lambda=1e3 * problem.law.lame_lambda, lame_mu=1e3 * problem.law.lame_mu
        ),
        tractions=tuple(replace(t, value=tuple(1e3 * v for v in t.value)) for t in problem.tractions),
        obstacle=replace(problem.obstacle, friction=1e3 * problem.obstacle.friction),
    )
    one, two = gain_estimate(problem), gain_estimate(stiffer)
    assert one.value > 0
    assert two.value == pytest.approx(1e3 * one.value, rel=1e-9)


def test_the_gain_is_estimated_well_where_the_error_is_known() -> None:
    problem = replace(without_boxes(EXAMPLES["6.1"](n=16)), quadrature=8)
    estimate = gain_estimate(problem)
    assert estimate.value == pytest.approx(estimate.energy - problem.exact.energy, rel=0.1)


@pytest.mark.parametrize("bad", [-1.0, float("nan"), (), (0.0, 1.0), "much", (1.0, None)])
def test_bad_weights_are_refused(bad: object) -> None:
    with pytest.raises(BadInputError, match="regularisation"):
        weights(bad)  # type: ignore[arg-type]


def test_weights_and_objectives() -> None:
    assert weights(0.01) == (0.01,)
    assert weights((1, 0.1, 0)) == (1.0, 0.1, 0.0)
    assert regularised(2.0, 0, "quality").is_energy
    assert regularised(2.0, 0.1, "quality").text == "energy + 0.2*quality"
    with pytest.raises(BadInputError, match="oval"):
        regularised(2.0, 0.1, "oval")


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_a_descent_without_boxes_converges_to_a_valid_lower_and_stationary_mesh(name: str) -> None:
    problem = PROBLEMS[name]()
    gain = gain_estimate(problem).value
    energy = ReducedEnergy(relocation(problem, regularised(gain, 0.01)))
    before = energy(np.zeros(energy.relocation.n_q))
    result = descend(energy, before.q, gain_tolerance=1e-6, max_iterations=200)
    after = energy(result.x)
    assert result.status.value == "converged"
    assert before.equilibrium.energy - after.equilibrium.energy > 0.2 * gain
    assert np.min(signed_areas(energy.relocation.nodes(result.x), problem.triangles)) > 0
    width = node_widths(energy.relocation, result.x)
    first = np.max(np.abs(node_widths(energy.relocation, before.q) * before.gradient))
    assert np.max(np.abs(width * after.gradient)) < 0.02 * first


def test_steps_are_cut_where_an_element_would_lose_most_of_its_area() -> None:
    rel = relocation(PROBLEMS["6.1"](), parse_objective("energy + 0.1*quality"))
    rng = np.random.default_rng(5)
    for length in (1e-3, 1.0, 50.0):
        step = length * rng.uniform(-1, 1, rel.n_q)
        part = longest_valid(rel, np.zeros(rel.n_q), step)
        before, after = (signed_areas(rel.nodes(t * step), rel.problem.triangles) for t in (0.0, part))
        least = np.min(after / before)
        assert least >= KEPT - 1e-9
        # cut no more than it must be
        assert part == 1.0 or least == pytest.approx(KEPT, rel=1e-6)


@pytest.mark.slow
def test_models_are_exact_unless_they_are_asked_to_take_loads_by_a_lower_rule() -> None:
    problem = replace(PROBLEMS["6.1"](), quadrature=6)
    energy = ReducedEnergy(relocation(problem, regularised(gain_estimate(problem).value, 0.01)))
    end = {}
    for approximate in (False, True):
        start = np.zeros(energy.relocation.n_q)
        end[approximate] = descend(
            energy, start, gain_tolerance=1e-12, max_iterations=40, approximate=approximate
        )
    # Newton's method converges quadratically, with another model linearly
    assert end[False].status.value == "converged"
    assert end[False].iterations < end[True].iterations
    given = energy(np.zeros(energy.relocation.n_q)).value
    assert given - end[True].value == pytest.approx(given - end[False].value, rel=0.05)


def test_large_moves_need_a_barrier() -> None:
    energy = ReducedEnergy(relocation(PROBLEMS["6.1"]()))
    with pytest.raises(ValueError, match="distortion"):
        descend(energy, np.zeros(energy.relocation.n_q), gain_tolerance=0)


def test_widths_are_heights() -> None:
    problem = replace(EXAMPLES["6.1"](n=4), motion=Motion(None))
    rel = relocation(problem)
    # right isosceles triangles with legs of 1/4, moves in units of the shortest edge: all heights are alike
    np.testing.assert_allclose(node_widths(rel, np.zeros(rel.n_q)), np.sqrt(0.5))
