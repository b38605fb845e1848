"""Blended triangles stand for the true domain; integrals over them in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from rmesh_nlp.assessment.energy import load_vector, stiffness
from rmesh_nlp.assessment.integrals import over_edges, over_triangles
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, signed_areas
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import on_points
from support.curved import HOLE, disc, plate, spline_of_the_hole

ARC = Circle((0.0, 1.0), 1.0)
CUT = np.arcsin(0.2)


def area(problem: ContactProblem) -> float:
    body = Body(problem, problem.mesh.p)
    every = np.arange(body.triangles.shape[1])
    return float(over_triangles(body, every, lambda _, s, __: np.ones((1, *s.shape[1:])), 8)[0].sum())


def test_areas_are_those_of_the_true_domains() -> None:
    # a square of side 10 with a hole of radius 2.5; a quarter of a disc, cut off at half-length 0.2
    for curve, error in ((HOLE, 1e-10), (spline_of_the_hole(), 1e-3)):
        assert area(plate({"hole": curve})) == pytest.approx(100 - np.pi * 2.5**2, rel=error)
    quarter = disc({"arc": ARC})
    assert area(quarter) == pytest.approx(np.pi / 4 - (CUT - np.sin(CUT) * np.cos(CUT)) / 2, rel=1e-9)
    assert signed_areas(quarter.mesh.p, quarter.triangles).sum() < 0.996 * area(quarter)


def test_edges_are_as_long_as_their_arcs() -> None:
    problem = disc({"arc": ARC})
    edges = Body(problem, problem.mesh.p).edges("arc")
    lengths, doubt = over_edges(edges.at, edges.size, lambda _, s, __: np.ones((1, *s.shape)))
    assert lengths.sum() == pytest.approx(np.pi / 2 - CUT, rel=1e-12)
    assert doubt.max() < 1e-12


def test_rules_are_refined_until_a_narrow_bump_is_integrated() -> None:
    problem = ContactProblem(rectangle(2, 2), Laplace(1.0), ("left",))
    body = Body(problem, problem.mesh.p)

    def bump(_: Array, barycentric: Array, where: Array) -> Array:
        far = (where[0] - 0.3) ** 2 + (where[1] - 0.4) ** 2
        return np.exp(-far / 0.02**2)[None] * np.ones_like(barycentric[:1])

    total, doubt = over_triangles(body, np.arange(8), bump)
    assert total.sum() == pytest.approx(np.pi * 0.02**2, rel=1e-8)
    assert doubt.sum() < 1e-8


def test_stiffness_and_loads_are_those_of_the_formulations() -> None:
    load = (lambda x, y: x * y, lambda x, y: np.sin(x))
    problem = plate({"hole": HOLE}, load=load).with_rule(20)
    body, model = Body(problem, problem.mesh.p), ContactSolver(problem)
    system = model.system(problem.mesh.p)
    free = np.flatnonzero(model.displacement.index.T.ravel() >= 0)
    K, (F, doubt) = stiffness(body)[free][:, free], load_vector(body)
    assert abs(K - system.stiffness).max() < 1e-4 * abs(K).max()
    np.testing.assert_allclose(F[free], system.load, atol=1e-6 * np.max(np.abs(F)))
    assert np.max(doubt) < 1e-6 * np.max(np.abs(F))


def test_a_constant_coefficient_has_its_value_everywhere() -> None:
    points = np.random.default_rng(0).uniform(size=(2, 5000))
    np.testing.assert_array_equal(on_points(lambda x, y: 0 * x, points), np.zeros(5000))
    np.testing.assert_allclose(on_points(lambda x, y: x * y + 2, points), points[0] * points[1] + 2)
