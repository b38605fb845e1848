"""The cascade of meshes: which end of several counts, how long descents are, and what it notes."""

from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models import cascade as module
from rmesh_nlp.models.cascade import CascadeSettings, cascade
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import NewtonResult
from rmesh_nlp.problem import (
    ContactProblem,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    Traction,
)
from support.problems import no_move_limits


def square(n: int) -> ContactProblem:
    return replace(no_move_limits(EXAMPLES["6.1"](n=n)), quadrature=4)


@pytest.mark.parametrize("schedules", [((3.0,), (0.01,)), ((0.01,), (3.0,))])
def test_of_several_schedules_the_best_end_counts_and_weights_are_continued(
    schedules: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CHEAP", 1.0)
    seen: list[tuple] = []
    settings = CascadeSettings(schedules=schedules, iterations=4)
    result = cascade(square(3), settings, lambda iteration, *step: seen.append(step))
    descents = [list(steps) for _, steps in groupby(seen, key=lambda step: id(step[0]))]
    final = result.energy.objective.text
    ends = [steps[-1][2] for steps in descents if steps[0][0].objective.text == final]
    assert len(ends) >= 2
    assert result.energy(result.q).value <= min(ends)
    for heavier, lighter in ((0, 1), (2, 3)):
        np.testing.assert_array_equal(descents[lighter][0][1], descents[heavier][-1][1])


def test_levels_have_the_weight_of_their_error_and_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, seen, gains, descend = square(8), [], [], module.descend

    def noted(energy: ReducedEnergy, q: np.ndarray, **options: Any) -> NewtonResult:
        gains.append(options["reference"] - energy(q).value)
        return descend(energy, q, **options)

    monkeypatch.setattr(module, "descend", noted)
    result = cascade(problem, CascadeSettings(coarsest=20, iterations=6), lambda i, *_: seen.append(i))
    coarse, fine = result.levels
    assert (coarse.nodes, fine.nodes, coarse.triangles, fine.triangles) == (25, 81, 32, 128)
    # the error falls like the number of nodes
    error = gain_estimate(module.coarsened(problem, 20)).value
    assert coarse.weight == pytest.approx(0.003 * error)
    assert fine.weight == pytest.approx(0.003 * error * 25 / 81)
    assert result.gain_estimate == pytest.approx(error * 25 / 81)
    assert np.isnan([coarse.prolonged, coarse.taken]).all()
    assert fine.taken == 1
    assert fine.energy == result.energy(result.q).equilibrium.energy < fine.prolonged
    assert fine.prolonged < result.energy(0 * result.q).equilibrium.energy
    # a descent ends where little of the whole error is predicted
    assert gains == pytest.approx([*[error] * (len(gains) - 1), error * 25 / 81])
    # the last iterate of each descent is reported with the number of those before it
    assert seen == sorted(seen)
    assert seen[-1] == coarse.iterations + fine.iterations
    assert min(coarse.contact_solves, fine.contact_solves, coarse.products, fine.products) > 0
    assert result.energy.contact_solves >= fine.contact_solves > 0
    assert result.record()[1]["nodes"] == 81


def test_a_map_that_folds_triangles_is_not_evaluated(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(*given: Any) -> np.ndarray:
        return np.random.default_rng(0).uniform(-9, 9, given[-1].n_q)

    monkeypatch.setattr(module, "prolonged", folded)
    level = cascade(square(8), CascadeSettings(coarsest=20, iterations=2)).levels[-1]
    assert np.isnan(level.prolonged)
    assert level.taken == 0


def test_descents_are_brief_on_the_finest_mesh_and_longer_where_it_is_not_nested() -> None:
    settings = CascadeSettings(iterations=60, brief=10, brief_unnested=20)
    assert [settings.limit(True, nested) for nested in (True, False)] == [10, 20]
    assert [settings.limit(False, nested) for nested in (True, False)] == [60, 60]
    # on meshes made for the solution, shorter at order 2
    assert [CascadeSettings().near(order) for order in (1, 2)] == [20, 6]
    assert CascadeSettings(brief_unnested=1).near(2) == 1
    assert settings.starts(60, 9000) == settings.schedules
    assert settings.starts(60, 8999) == settings.schedules[:1]


def test_it_stops_when_asked_to_and_when_the_time_is_up() -> None:
    with pytest.raises(StoppedError):
        cascade(square(8), CascadeSettings(coarsest=20), budget=Budget(Limits(1e-9)))
    late, seen = Budget(), []
    late.is_over = lambda: len(seen) > 1  # type: ignore[method-assign]
    for ask, budget in ((lambda iteration, *_: iteration == 2, None), (lambda i, *_: seen.append(i), late)):
        found = cascade(square(8), CascadeSettings(coarsest=20), ask, budget)
        assert (found.status, len(found.levels), found.built) == (Status.INTERRUPTED, 1, None)
        # the map so far is taken to the given mesh, and lowers the energy there
        assert found.q.size == found.energy.relocation.n_q
        assert found.energy.is_defined(found.q)
        assert found.energy(found.q).value < found.energy(0 * found.q).value


LEAST = -3.66907
"""Energy of the block on a ridge, from relocated meshes refined four times."""


def wedge(n: int) -> ContactProblem:
    """A block on a ridge, 4 n times n cells."""
    mesh = named(
        rectangle(4 * n, n, x=(0, 4), diagonal="falling"), {"load": lambda x: (x[1] == 1) & (x[0] > 2)}
    )
    return ContactProblem(
        mesh=mesh,
        law=PlaneStrain(lame_lambda=1.15e4, lame_mu=0.83e4),
        dirichlet=("left",),
        obstacle=Obstacle.graph("bottom", PiecewiseLinear((0.0, 3.0, 4.0), (-0.12, -0.03, -0.06))),
        motion=Motion(None),
        tractions=(Traction("load", (-20.0, -57.5)),),
    )


@pytest.mark.slow
def test_meshes_that_are_not_nested_gain_as_much_as_their_neighbours() -> None:
    """Error times nodes hardly depends on the size, whether a mesh is a refinement of others or not."""
    products = []
    for n in (12, 13, 16, 17):
        found = cascade(wedge(n))
        relocated = admissible(found.problem, found.energy.relocation.nodes(found.q))
        products.append((relocated.energy - LEAST) * relocated.problem.mesh.p.shape[1])
    assert max(products) < 1.15 * min(products)
