"""Weights of a distortion, what relocation can gain, and descents of the energy with a distortion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formulations.nested import Nested
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.distortion import distortion_group
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.models.descent import KEPT, longest_valid, node_widths
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.models.second_derivatives import Curvature
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Motion
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step
from support.problems import no_move_limits
from support.reduced import free_membrane, with_distortion


def test_distortions_of_a_stretched_mesh_by_hand() -> None:
    problem = free_membrane()
    a, b = 2.0, 0.25  # along x and y: |A|^2 = a^2 + b^2, det A = a b
    parts, positions = discretise(problem), constant_field(problem.mesh.p * np.array([[a], [b]]))
    stretched = Fields(parts.space, positions, parts.displacement, parts.slip)
    shape, size = (a**2 + b**2) / (2 * a * b) - 1, (a * b + 1 / (a * b) - 2) / 2
    elastic = (a**2 + b**2 + a**-2 + b**-2) / 4 - 1
    for name, value in {"quality": shape, "shape-size": shape + size, "elastic": elastic}.items():
        (found,) = element_values([distortion_group(stretched, name)])(np.zeros(0))
        assert found.sum() == pytest.approx(value)


def test_widths_are_heights_in_units_of_the_outer_variables() -> None:
    for legs, problem in ((1 / 4, EXAMPLES["6.1"](n=4)), (1 / 8, EXAMPLES["6.1"](n=8))):
        rel = relocation(replace(problem, motion=Motion(None)))
        # right isosceles triangles, moves in units of the shortest edge: all heights are alike
        np.testing.assert_allclose(node_widths(rel, np.zeros(rel.parts.n_q)), np.sqrt(0.5))
        limited = relocation(replace(problem, motion=Motion((0.02, 0.01))))
        width = node_widths(limited, np.zeros(limited.parts.n_q))
        index = limited.parts.mesh_map.positions.index
        height = legs * np.sqrt(0.5)
        np.testing.assert_allclose(width[index[0][index[0] >= 0]], height / 0.02)
        np.testing.assert_allclose(width[index[1][index[1] >= 0]], height / 0.01)


@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_steps_are_cut_where_an_element_would_lose_most_of_its_area(length: float) -> None:
    rel = relocation(free_membrane(), parse_objective("energy + 0.1*quality"))
    q, step = np.random.default_rng(5).uniform(-1, 1, (2, rel.parts.n_q)) * [[0.1], [length]]
    part = longest_valid(rel, q, step)
    areas = [
        signed_areas(rel.nodes(q + t * step), rel.parts.problem.triangles) for t in np.linspace(0, part, 20)
    ]
    ratios = np.min(areas / areas[0], axis=1)
    assert min(ratios) >= KEPT - 1e-9
    # cut no more than it must be
    assert part == 1.0 or ratios[-1] == pytest.approx(KEPT, rel=1e-6)
    assert (part == 1.0) == (length < 1e-2)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("6.1", 3),
        pytest.param("6.1", 5, marks=pytest.mark.slow),
        pytest.param("6.2", (6, 3), marks=pytest.mark.slow),
        pytest.param("6.3", (6, 3), marks=pytest.mark.slow),
    ],
)
def test_nested_ends_at_a_minimum_with_a_distortion(name: str, size: int | tuple[int, int]) -> None:
    energy = with_distortion(replace(no_move_limits(EXAMPLES[name](n=size)), quadrature=6))
    outer, steps = Outer.of(energy.relocation.parts.problem, energy.relocation.objective), list[Step]()
    start = np.zeros(outer.n)
    end = Nested().run(outer, start, Monitor(on_step=steps.append))
    assert end.status is Status.CONVERGED
    assert outer.residual(energy(end.q)) <= 1e-6
    assert steps[-1].iteration == len(steps) - 1
    assert energy(end.q).value < energy(start).value
    # a minimum, not only a stationary point: no direction has negative curvature
    matrix = Curvature(energy).at(energy(end.q))(np.eye(end.q.size))
    eigenvalues = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    assert eigenvalues.min() > -1e-6 * eigenvalues.max()


def test_the_gain_is_estimated_well_where_the_error_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a refined mesh, or by interpolation where none can be solved."""
    problem = replace(no_move_limits(EXAMPLES["6.1"](n=16)), quadrature=8)
    solver = ContactSolver(problem)
    error = admissible(solver.discretisation).energy - problem.exact.energy
    assert gain_estimate(solver) == pytest.approx(error, rel=0.1)
    monkeypatch.setattr("rmesh_nlp.models.regularisation._refined", lambda given: None)
    assert 0.5 * error < gain_estimate(ContactSolver(problem)) < 2 * error


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
