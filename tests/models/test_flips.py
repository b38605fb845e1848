"""Edge flips by energy: monotone, names kept, with the angles and areas of the motion."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.contact.solver import ContactSolver
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
from rmesh_nlp.models.flips import (
    ElementEnergies,
    flip_edges,
    flips_and_moves,
    mean_around,
    mended,
    shapes_as_given,
)
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.problem import ContactProblem, Motion
from support.formulations import auto
from support.problems import no_boxes


def energy(problem: ContactProblem) -> float:
    return ContactSolver(problem).solve(problem.mesh.p).energy


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


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]
)
def test_flips_lower_the_energy_by_at_least_what_they_say(seed: int) -> None:
    problem = no_boxes(random_problem(seed))
    result = flip_edges(problem, gain_estimate(problem).value)
    assert result.gain >= 0
    before = energy(problem)
    assert before - energy(result.problem) >= result.gain - 1e-10 * abs(before)
    one, two = problem.mesh, result.problem.mesh
    assert result.changed <= 2 * result.flips
    np.testing.assert_array_equal(two.p, one.p)
    for name in one.boundaries:
        edges = [{tuple(e) for e in np.sort(m.facets[:, m.boundaries[name]], axis=0).T} for m in (one, two)]
        assert edges[0] == edges[1], name
    for name in one.subdomains or {}:
        areas = [np.abs(signed_areas(m.p, m.t))[m.subdomains[name]].sum() for m in (one, two)]
        assert areas[0] == pytest.approx(areas[1])


def test_flips_keep_the_least_angle_and_area_of_the_motion() -> None:
    problem = crooked()
    gain = gain_estimate(problem).value
    free = flip_edges(problem, gain).problem
    present = float(least_angles(problem.mesh.p, problem.triangles).min())
    # what is asked for below excludes a flip
    assert least_angles(free.mesh.p, free.triangles).min() < present
    kept = flip_edges(replace(problem, motion=Motion(None, min_angle=present)), gain)
    assert kept.flips > 0
    assert least_angles(kept.problem.mesh.p, kept.problem.triangles).min() >= present
    around = mean_around(problem.triangles, signed_areas(problem.mesh.p, problem.triangles), 49)
    large = flip_edges(replace(problem, motion=Motion(None, min_area_fraction=0.9)), gain).problem
    ratio = signed_areas(large.mesh.p, large.triangles) / around[large.triangles].mean(axis=0)
    assert ratio[~is_known(problem, large.triangles)].min() >= 0.9


def test_means_around_nodes_and_equilateral_triangles_by_hand() -> None:
    triangles = np.array([[0, 1], [1, 2], [2, 3]])
    np.testing.assert_allclose(mean_around(triangles, np.array([1.0, 3.0]), 5), [1, 2, 2, 3, 0])
    areas = np.array([2.0, 7.0, 0.5])
    corner = mended(np.zeros((2, 5)), triangles[:, [0, 1, 1]], np.array([True, False, True]), areas)
    assert not np.any(corner[:, :, 1])
    corner = corner[:, :, [0, 2]]
    np.testing.assert_allclose(signed_areas(corner.reshape(2, -1), np.arange(6).reshape(3, 2)), [2.0, 0.5])
    sides = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=0)
    np.testing.assert_allclose(sides, np.broadcast_to(sides[0], sides.shape))


def test_a_relocation_that_raises_the_energy_is_not_kept() -> None:
    problem = crooked()

    def worse(flipped: ContactProblem) -> ContactProblem:
        nodes = np.array(flipped.mesh.p)
        nodes[:, flipped.mesh.interior_nodes()] += 0.02
        return replace(flipped, mesh=replace(flipped.mesh, doflocs=nodes))

    last, rounds = flips_and_moves(problem, 1e-3, worse, given=problem, rounds=1)
    assert rounds[0].relocated == rounds[0].flipped < energy(problem)
    np.testing.assert_array_equal(last.mesh.p, problem.mesh.p)


def test_rounds_end_where_they_gain_too_little_or_are_stopped() -> None:
    problem = crooked()
    fall = energy(problem) - energy(flip_edges(problem, 1e-3).problem)

    def rounds(gain: float, stop: bool) -> int:
        """Every relocation goes back to the crooked mesh, so that every round could flip and gain again."""
        again = flips_and_moves(problem, gain, lambda p: p, given=problem, rounds=3, stop=lambda: stop)
        return len(again[1])

    assert rounds(fall / 2e-3 * 1.01, False) == 1
    assert rounds(1e-3, True) == 1
    assert rounds(1e-3, False) >= 1


def test_a_flipped_mesh_is_compared_with_the_mesh_as_given() -> None:
    problem = crooked()
    flipped = flip_edges(problem, gain_estimate(problem).value).problem
    shapes, p = shapes_as_given(problem, flipped.triangles), problem.mesh.p[:, flipped.triangles]
    known = is_known(problem, flipped.triangles)
    np.testing.assert_array_equal(shapes[:, :, known], p[:, :, known])
    quality = shape_quality(shapes.reshape(2, -1), np.arange(shapes[0].size).reshape(shapes[0].shape))
    assert quality[~known].min() >= 0.2
    # where the nodes are as given, a distortion is that of the triangles without a counterpart alone
    values = {}
    for name, reference in (("own", None), ("given", shapes)):
        there = replace(flipped, reference=reference)
        group = distortion_group(there, constant_field(there.mesh.p), "shape-size")
        values[name] = element_values([group])(np.zeros(0))[0]
    np.testing.assert_allclose(values["own"], 0, atol=1e-14)
    np.testing.assert_allclose(values["given"][known], 0, atol=1e-14)
    assert np.all(values["given"] >= -1e-14)
    with pytest.raises(ValueError, match="reference"):
        distortion_group(replace(flipped, reference=shapes[:, :, :-1]), constant_field(p[0]), "shape-size")


def test_flips_need_a_problem_without_move_limits() -> None:
    with pytest.raises(BadInputError, match=r"boxes|move limits"):
        auto.solve(EXAMPLES["6.1"](n=4), flips=True)


@pytest.mark.slow
def test_flips_gain_beyond_relocation_and_refer_to_the_mesh_as_given() -> None:
    problem = no_boxes(EXAMPLES["6.3"]())
    plain, flipped = auto.solve(problem), auto.solve(problem, flips=True)
    one, two = plain.record(), flipped.record()
    assert one["energy_initial"] == two["energy_initial"]
    assert one["energy_initial"] - two["energy"] > 1.03 * (one["energy_initial"] - one["energy"])
    assert two["flips"] == sum(r["flips"] for r in two["flip_rounds"]) > 0
    assert 0 < two["changed_triangles"] <= problem.mesh.t.shape[1]
    energies = [r["relocated"] for r in two["flip_rounds"]]
    assert np.all(np.diff([one["energy"], *energies]) < 0)
    np.testing.assert_array_equal(flipped.initial_nodes, problem.mesh.p)
    motion = point_data(flipped)["motion"][:, :2].T
    np.testing.assert_allclose(motion, flipped.mesh.p - problem.mesh.p, atol=1e-14)
    assert np.min(cell_data(flipped)["area_ratio"]) == pytest.approx(two["min_area_ratio"])
    # pinned nodes are where they were
    top = problem.boundary_nodes(("top",))
    np.testing.assert_allclose(flipped.mesh.p[:, top], problem.mesh.p[:, top], atol=1e-14)


@pytest.mark.slow
def test_a_least_angle_holds_through_relocation_and_flips() -> None:
    problem = replace(EXAMPLES["6.1"](n=4), motion=Motion(None, min_angle=15.0), quadrature=6)
    solution = auto.solve(problem, flips=True)
    assert solution.success
    assert least_angles(solution.mesh.p, solution.problem.triangles).min() >= 15.0 - 1e-6
