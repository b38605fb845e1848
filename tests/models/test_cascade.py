"""The cascade of meshes: which end of several counts, and which map is taken to a finer mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.cascade import CascadeSettings, Schedules, cascade
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.levels import _continuous, accepted
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate, regularised
from rmesh_nlp.models.regularised_descent import descend, finished
from rmesh_nlp.models.second_derivatives import Curvature
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain, Traction
from rmesh_nlp.solving.outer import Outer
from support.problems import no_boxes


def coarse() -> ContactProblem:
    return replace(no_boxes(EXAMPLES["6.1"](n=3)), quadrature=4)


def regularised_energy(problem: ContactProblem) -> ReducedEnergy:
    return ReducedEnergy(relocation(problem, regularised(gain_estimate(problem).value, 0.01)))


@pytest.mark.parametrize("schedules", [((3.0,), (0.01,)), ((0.01,), (3.0,))])
def test_of_several_schedules_the_best_end_counts_and_weights_are_continued(schedules: Schedules) -> None:
    descents: list[tuple[ReducedEnergy, list[Array], list[float]]] = []

    def note(iteration: int, energy: ReducedEnergy, q: Array, value: float) -> None:
        if not descents or descents[-1][0] is not energy:
            descents.append((energy, [], []))
        descents[-1][1].append(q)
        descents[-1][2].append(value)

    settings = CascadeSettings(schedules=schedules, cheap=1.0, iterations=4)
    result = cascade(coarse(), settings, note)
    final = result.energy.relocation.objective.text
    ends = [values[-1] for energy, _, values in descents if energy.relocation.objective.text == final]
    assert len(ends) >= 2
    assert result.energy(result.q).value <= min(ends)
    for heavier, lighter in ((0, 1), (2, 3)):
        np.testing.assert_array_equal(descents[lighter][1][0], descents[heavier][1][-1])


def test_a_map_is_halved_until_it_lowers_the_energy() -> None:
    energy = regularised_energy(coarse())
    zero = np.zeros(energy.relocation.n_q)
    downhill = -energy(zero).gradient
    scale = 1e-2 / np.max(np.abs(downhill))
    whole, part = accepted(energy, scale * downhill)
    assert part == 1
    np.testing.assert_array_equal(whole, scale * downhill)
    assert accepted(energy, -scale * downhill)[1] == 0
    np.testing.assert_array_equal(accepted(energy, -scale * downhill)[0], zero)
    far = scale * downhill
    while energy.is_defined(far) and _continuous(energy, far) < _continuous(energy, zero):
        far = 2 * far
    taken, part = accepted(energy, far)
    assert 0 < part < 1
    np.testing.assert_array_equal(taken, part * far)
    assert _continuous(energy, taken) < _continuous(energy, zero)


def test_a_map_that_gains_by_penetration_is_not_taken() -> None:
    """Gaps hold at nodes, so a descent draws them apart and lets the foundation pass in between."""
    problem = ContactProblem(
        rectangle(4, 2, x=(0, 2)),
        PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(Dirichlet("left", (0.0, None)),),
        tractions=(Traction("top", (0.0, -20.0)),),
        obstacle=Obstacle.curve("bottom", lambda x, y: y + 0.05 * (x - 1) ** 2),
        motion=Motion(None),
    )
    energy = regularised_energy(problem)
    zero = np.zeros(energy.relocation.n_q)
    found = descend(energy, zero, gain_tolerance=0, max_iterations=4).x
    assert energy(found).equilibrium.energy < energy(zero).equilibrium.energy
    assert accepted(energy, found)[1] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("6.1", 5), ("6.2", (6, 3)), ("6.3", (6, 3))])
def test_the_way_from_a_cascade_to_a_stationary_point(name: str, size: int | tuple[int, int]) -> None:
    problem = replace(no_boxes(EXAMPLES[name](n=size)), quadrature=6)
    start = cascade(problem)
    outer = Outer(problem, start.energy.relocation.objective)
    residual = outer.residual
    before = start.energy(start.q).value
    end = finished(
        start.energy,
        start.q,
        residual,
        tolerance=1e-6,
        reference=before + start.gain_estimate,
        max_iterations=80,
    )
    assert end.result.status is Status.CONVERGED
    assert end.residual == residual(start.energy(end.result.x)) <= 1e-6
    assert end.result.value <= before
    # a minimum, not only a stationary point: no direction has negative curvature
    hessian = Curvature(start.energy).at(start.energy(end.result.x))
    matrix = np.column_stack([hessian(e) for e in np.eye(end.result.x.size)])
    eigenvalues = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    assert eigenvalues.min() > -1e-6 * eigenvalues.max()
