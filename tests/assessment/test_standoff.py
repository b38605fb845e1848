"""How far nodes must keep off a foundation, against gap violations in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rmesh_nlp.assessment.standoff import SAMPLES, Cells, cells_of
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Obstacle, PlaneStrain
from rmesh_nlp.problem.body import Body

RIDGE = (SAMPLES / 2 + 0.5) / SAMPLES
"""Halfway between two samples."""


def cells_on(problem: ContactProblem) -> list[Cells]:
    space = DisplacementSpace.of(problem)
    return list(cells_of(Body(problem, problem.mesh.p), space, space.contact_sets[0]))


def edge(height: Callable, held: tuple[str, ...] = ("top",), length: float = 2.0, order: int = 1) -> Cells:
    """One contact edge from x = 0 to its length over a foundation -1 + height(x / length)."""
    problem = ContactProblem(
        rectangle(1, 1, x=(0, length)),
        PlaneStrain(1.0, 1.0),
        tuple(Dirichlet(name, (0.0, 0.25)) for name in held),
        Obstacle.graph("bottom", lambda x, y: -1 + height(x / length)),
        order=order,
    )
    (cells,) = cells_on(problem)
    return cells


@pytest.mark.parametrize(
    ("height", "off"),
    [
        (lambda s: 0.4 * s * (1 - s), 0.1),  # a crest of 0.4 / 4 over its chord
        (lambda s: 0.3 + 0.2 * s, 0.0),
        (lambda s: -0.4 * s * (1 - s), 0.0),  # a valley
        (lambda s: 0.05 * (1 - np.cos(2 * np.pi * s)), 0.1),
        (lambda s: s * s * (1 - s), 4 / 27),  # the top lies between two samples
        (lambda s: 0.4 * np.minimum(s / RIDGE, (1 - s) / (1 - RIDGE)), 0.4),
    ],
)
def test_nodes_keep_off_by_the_height_of_the_foundation_over_its_chord(height: Callable, off: float) -> None:
    cells = edge(height)
    found = cells.off(np.zeros(4))
    assert off - 1e-12 <= found[0] <= off + 1e-4
    # so raised the gap is closed at the crest and nowhere violated; without it is violated by as much
    u = np.zeros((2, 4))
    u[1] = -1.0
    on_chord = u.copy()
    x = cells.points[0, 0, [0, -1]]
    on_chord[1, cells.nodes[:, 0]] = -(1 - height(x / 2)) + found[0]
    assert -1e-12 <= np.min(cells.gaps(on_chord)) <= 1e-4
    assert cells.missing(on_chord)[0] < 1e-12
    on_chord[1] -= 0.05
    assert cells.missing(on_chord)[0] == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(
    ("height", "off"),
    [
        (lambda s: 0.4 * s * (1 - s) + 0.1 * s, 0.0),
        (lambda s: s * (1 - s) * (1 - 2 * s), 3**0.5 / 18),  # a cubic: over the parabola, which is zero
        (lambda s: 0.05 * (1 - np.cos(2 * np.pi * s)), 0.0),  # below it everywhere
    ],
)
def test_nodes_of_order_2_keep_off_by_the_height_over_the_parabola(height: Callable, off: float) -> None:
    cells, fine = edge(height, order=2), np.linspace(0, 1, 20_001)
    parabola = np.polynomial.Polynomial.fit([0, 0.5, 1], height(np.array([0, 0.5, 1])), 2)
    exact = max(float(np.max(height(fine) - parabola(fine))), 0.0)
    assert exact == pytest.approx(off, abs=1e-8)
    found = max(cells.off(np.zeros(9))[0], 0.0)
    assert exact - 1e-12 <= found <= exact + 2e-4
    # with these coefficients of the gap the foundation is met at the crest, and nowhere passed
    u = np.zeros((2, 9))
    u[1, cells.nodes[:, 0]] = found - cells.at_nodes[:, 0]
    assert -1e-12 <= np.min(cells.gaps(u)) <= 1e-4
    assert cells.missing(u)[0] < 1e-12


def test_between_points_a_parabola_is_lower_by_its_bend() -> None:
    """Of a gap (s - r)^2 whose least value lies between two points nothing below zero is overlooked."""
    cells, at = edge(lambda s: 0 * s, order=2), RIDGE
    u = np.zeros((2, 9))
    u[1, cells.nodes[:, 0]] = np.array([at**2, (1 - at) ** 2, -at * (1 - at)]) - 1.0
    assert np.min(cells.gaps(u)) == pytest.approx(0.0, abs=1e-12)
    assert np.min(cells.gaps(u) + cells.dips(u)) > 1e-5


def test_in_triangles_a_paraboloid_is_looked_at_between_samples_too() -> None:
    """-r^2 about a point of no lattice: the node opposite keeps off by its height over the plane."""
    middle = np.array([0.31, 0.27])
    hill = Obstacle.interior(lambda x, y: -1 - (x - middle[0]) ** 2 - (y - middle[1]) ** 2)
    problem = ContactProblem(rectangle(1, 1, diagonal="falling"), Laplace(0.0), ("right",), hill)
    (cells,) = cells_on(problem)
    corner = 0 if np.all(np.min(cells.points[:, 0], axis=1) < 0.01) else 1  # the triangle at the origin
    gaps = cells.gaps(np.zeros((1, 4)))[corner]
    exact = 1 + np.sum((cells.points[:, corner] - middle[:, None]) ** 2, axis=0)
    assert np.all(gaps <= exact)
    assert np.min(gaps) <= 1.0  # not above the least gap, which no sample has
    assert np.min(gaps) > 1 - 1e-3
