"""Edge flips by energy: monotone, names kept, with the angles and areas of the motion."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.distortion import distortion_group
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.io.export import cell_data, point_data
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes.geometry import shape_quality, signed_areas
from rmesh_nlp.models import flips
from rmesh_nlp.models.flips import ElementEnergies, energy_of, flip_edges, flips_and_moves, mean_around
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.problem import ContactProblem, Motion
from support.formulations import auto
from support.problems import no_move_limits


def crooked() -> ContactProblem:
    """Example 6.1 on a mesh whose flips would make slivers: its nodes are shaken."""
    problem = replace(EXAMPLES["6.1"](n=6), motion=Motion(None), quadrature=6)
    free = discretise(problem).mesh_map
    q = 0.3 * np.random.default_rng(2).uniform(-1, 1, free.n)
    return replace(problem, mesh=replace(problem.mesh, doflocs=free.positions.values(q)))


def is_known(problem: ContactProblem, triangles: np.ndarray) -> np.ndarray:
    """Whether triangles are between the same nodes as one of a problem."""
    own = {tuple(t) for t in np.sort(problem.triangles, axis=0).T.tolist()}
    return np.array([tuple(t) in own for t in np.sort(triangles, axis=0).T.tolist()])


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_element_energies_sum_to_the_energy_of_the_body(seed: int) -> None:
    problem = replace(random_problem(seed), tractions=())
    values = np.random.default_rng(seed).uniform(-1, 1, (problem.components, problem.mesh.p.shape[1]))
    energies = ElementEnergies(problem, problem.mesh.p, 0 * values).at(values)
    found = energies(problem.triangles, np.arange(problem.mesh.t.shape[1])).sum()
    groups = discretise(problem).bulk(constant_field(problem.mesh.p), constant_field(values))
    expected = sum(part.sum() for part in element_values(groups)(np.zeros(0)))
    assert found == pytest.approx(expected, rel=1e-12)


SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]


@pytest.mark.parametrize("seed", SEEDS)
def test_flips_lower_the_energy_by_at_least_what_they_say(seed: int) -> None:
    problem = no_move_limits(random_problem(seed))
    result, before = flip_edges(problem, gain_estimate(problem).value), energy_of(problem)
    assert before - energy_of(result.problem) >= result.gain - 1e-10 * abs(before)
    assert result.gain >= 0
    one, two = problem.mesh, result.problem.mesh
    assert np.sum(~is_known(problem, result.problem.triangles)) == result.changed <= 2 * result.flips
    np.testing.assert_array_equal(two.p, one.p)
    for name in one.boundaries:
        edges = [{tuple(e) for e in np.sort(m.facets[:, m.boundaries[name]], axis=0).T} for m in (one, two)]
        assert edges[0] == edges[1], name
    for name in one.subdomains or {}:
        areas = [np.abs(signed_areas(m.p, m.t))[m.subdomains[name]].sum() for m in (one, two)]
        assert areas[0] == pytest.approx(areas[1])


def test_flips_keep_the_least_angle_and_area_of_the_motion() -> None:
    problem = crooked()
    gain, p, t = gain_estimate(problem).value, problem.mesh.p, problem.triangles
    present = float(least_angles(p, t).min())
    # what is asked for below excludes a flip
    assert least_angles(p, flip_edges(problem, gain).problem.triangles).min() < present
    kept = flip_edges(replace(problem, motion=Motion(None, min_angle=present)), gain)
    assert kept.flips > 0
    assert least_angles(p, kept.problem.triangles).min() >= present
    around = mean_around(t, signed_areas(p, t), 49)
    for fraction in (0.9, 0.3):
        motion = Motion(None, min_area_fraction=fraction)
        new = flip_edges(replace(problem, motion=motion), gain).problem.triangles
        ratio = (signed_areas(p, new) / around[new].mean(axis=0))[~is_known(problem, new)]
        assert ratio.min() >= fraction
        assert (ratio.min() < 0.9) == (fraction < 0.9)


def test_means_around_nodes_and_mended_triangles_by_hand() -> None:
    triangles, areas = np.array([[0, 1], [1, 2], [2, 3]]), np.array([2.0, 0.5])
    np.testing.assert_allclose(mean_around(triangles, np.array([1.0, 3.0]), 5), [1, 2, 2, 3, 0])
    p = np.arange(10.0).reshape(2, 5) ** 2
    shapes = flips.mended(p, triangles, np.array([True, False]), areas)
    np.testing.assert_array_equal(shapes[:, :, 1], p[:, triangles[:, 1]])
    assert signed_areas(shapes[:, :, 0], np.arange(3)[:, None]) == pytest.approx(2.0)
    sides = np.linalg.norm(shapes - np.roll(shapes, 1, axis=1), axis=0)[:, 0]
    np.testing.assert_allclose(sides, sides[0])


def test_a_relocation_that_raises_the_energy_is_not_kept() -> None:
    def worse(flipped: ContactProblem) -> ContactProblem:
        nodes = np.array(flipped.mesh.p)
        nodes[:, flipped.mesh.interior_nodes()] += 0.02
        return replace(flipped, mesh=replace(flipped.mesh, doflocs=nodes))

    problem = crooked()
    last, rounds = flips_and_moves(problem, 1e-3, worse, given=problem, rounds=1)
    assert rounds[0].relocated == rounds[0].flipped < energy_of(problem)
    np.testing.assert_array_equal(last.mesh.p, problem.mesh.p)


def test_rounds_end_where_they_gain_too_little_or_are_stopped() -> None:
    problem = crooked()
    fall = energy_of(problem) - energy_of(flip_edges(problem, 1e-3).problem)
    for gain, stop in ((fall / 2e-3 * 1.01, False), (1e-3, True)):
        # every relocation goes back to the crooked mesh, so that every round could flip and gain again
        again = flips_and_moves(
            problem, gain, lambda p: p, given=problem, rounds=3, stop=lambda stop=stop: stop
        )
        assert len(again[1]) == 1


def test_a_flipped_mesh_is_compared_with_the_mesh_as_given() -> None:
    problem = crooked()
    flipped = flip_edges(problem, gain_estimate(problem).value).problem
    shapes, p = flips.shapes_as_given(problem, flipped.triangles), problem.mesh.p[:, flipped.triangles]
    known = is_known(problem, flipped.triangles)
    np.testing.assert_array_equal(shapes[:, :, known], p[:, :, known])
    quality = shape_quality(shapes.reshape(2, -1), np.arange(shapes[0].size).reshape(shapes[0].shape))
    assert quality[~known].min() >= 0.2

    def distortion(reference: np.ndarray | None) -> np.ndarray:
        there = replace(flipped, reference=reference)
        group = distortion_group(there, constant_field(there.mesh.p), "shape-size")
        return element_values([group])(np.zeros(0))[0]

    # where the nodes are as given, a distortion is that of the triangles without a counterpart alone
    np.testing.assert_allclose(distortion(None), 0, atol=1e-14)
    np.testing.assert_allclose(distortion(shapes)[known], 0, atol=1e-14)
    assert np.all(distortion(shapes) >= -1e-14)
    with pytest.raises(ValueError, match="reference"):
        distortion(shapes[:, :, :-1])


def test_flips_need_a_problem_without_move_limits() -> None:
    with pytest.raises(BadInputError, match=r"boxes|move limits"):
        auto.solve(EXAMPLES["6.1"](n=4), flips=True)


@pytest.mark.slow
def test_flips_gain_beyond_relocation_and_refer_to_the_mesh_as_given() -> None:
    problem = no_move_limits(EXAMPLES["6.3"]())
    plain, flipped = auto.solve(problem), auto.solve(problem, flips=True)
    one, two = plain.record(), flipped.record()
    assert one["energy_initial"] == two["energy_initial"]
    assert one["energy_initial"] - two["energy"] > 1.03 * (one["energy_initial"] - one["energy"])
    assert two["flips"] == sum(r["flips"] for r in two["flip_rounds"]) > 0
    assert 0 < two["changed_triangles"] <= problem.mesh.t.shape[1]
    assert np.all(np.diff([one["energy"], *(r["relocated"] for r in two["flip_rounds"])]) < 0)
    np.testing.assert_array_equal(flipped.initial_nodes, problem.mesh.p)
    motion = point_data(flipped)["motion"][:, :2].T
    np.testing.assert_allclose(motion, flipped.mesh.p - problem.mesh.p, atol=1e-14)
    assert np.min(cell_data(flipped)["area_ratio"]) == pytest.approx(two["min_area_ratio"])
    # pinned nodes are where they were
    np.testing.assert_allclose(motion[:, problem.boundary_nodes(("top",))], 0, atol=1e-14)


@pytest.mark.slow
def test_a_least_angle_holds_through_relocation_and_flips() -> None:
    problem = replace(EXAMPLES["6.1"](n=4), motion=Motion(None, min_angle=15.0), quadrature=6)
    solution = auto.solve(problem, flips=True)
    assert solution.success
    assert least_angles(solution.mesh.p, solution.problem.triangles).min() >= 15.0 - 1e-6
