"""Starts with alternating steps."""

from contextlib import suppress

import numpy as np
import pytest

from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.alternating import alternated, alternating
from rmesh_nlp.optimize.budget import Limits, StoppedError
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer


def test_alternating_steps_are_red_and_black_on_a_structured_grid() -> None:
    problem = EXAMPLES["6.1"](6)
    relocation = Outer.of(problem).relocation
    steps = relocation.nodes(alternating(relocation)) - problem.mesh.p
    i, j = np.rint(6 * problem.mesh.p).astype(int)
    free = np.all(steps != 0, axis=0)
    sign = np.sign(steps[0, free]) * (-1.0) ** (i + j)[free]
    assert free.sum() == 25
    assert np.all(sign == sign[0])


@pytest.mark.parametrize("seed", [None, 3])
def test_they_go_downhill_from_any_start(seed: int | None) -> None:
    outer = Outer.of(EXAMPLES["6.1"](8))
    q = outer.variables(seed=seed)
    gradient = outer.energy(q).gradient
    moved = alternated(outer.relocation, q, gradient, 0.1, outer.is_valid)
    np.testing.assert_allclose(np.abs(moved - q)[np.abs(moved) < 1], 0.1)
    assert gradient @ (moved - q) < 0


def test_they_are_halved_until_the_mesh_is_valid() -> None:
    outer = Outer.of(EXAMPLES["6.3"]((12, 6)))
    q = np.zeros(outer.n)
    assert not outer.is_valid(alternating(outer.relocation))
    moved = alternated(outer.relocation, q, outer.energy(q).gradient, 1.0, outer.is_valid)
    assert outer.is_valid(moved)
    assert np.max(np.abs(moved)) in (0.5, 0.25, 0.125)


@pytest.mark.parametrize(
    ("fine", "name", "size", "added"),
    [(100, "6.1", 8, True), (1000, "6.1", 8, False), (10, "6.3", (12, 6), False)],
)
@pytest.mark.parametrize("formulation", [Joint(), AllAtOnce()], ids=lambda one: one.name)
def test_solves_start_with_them_on_fine_meshes_without_areas(
    formulation, fine, name, size, added, monkeypatch
) -> None:
    monkeypatch.setattr(f"formulations.{formulation.name}.FINE", fine)
    outer, first = Outer.of(EXAMPLES[name](size)), []
    monitor = Monitor(Limits(iterations=1), on_step=lambda step: first.append(step.q))
    with suppress(StoppedError):
        formulation.run(outer, np.zeros(outer.n), monitor)
    assert (np.max(np.abs(alternating(outer.relocation) * first[0])) > 0.2) == added
