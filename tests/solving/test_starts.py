"""Several starts and levels of any strategy: which are solved, which is best, and what the record tells."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from support.formulations import fixed
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, Obstacle, Relative
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.starts import MultiStart, multilevel, multistart, prolong, refine, with_starts


@pytest.fixture(scope="module")
def problem() -> ContactProblem:
    return ContactProblem(
        rectangle(2, 2), Laplace(1.0), ("left",), Obstacle("right", (1.0,), 0.1), Motion(Relative(0.2))
    )


@pytest.fixture(scope="module")
def solution(problem: ContactProblem) -> Solution:
    return fixed.solve(problem)


Make = Callable[..., Solution]


@pytest.fixture
def ended(solution: Solution) -> Make:
    """A solution with an audited energy, a success or not."""

    def make(audited: float, success: bool = True, **changes: Any) -> Solution:
        audit = replace(solution.audit, energy_audited=audited)
        return replace(solution, audit=audit, success=success, **changes)

    return make


class TestMultiStart:
    def test_the_best_is_the_success_of_least_audited_energy(self, ended: Make) -> None:
        first, low, failed = ended(-1.0), ended(-3.0, energy=5.0), ended(-9.0, success=False)
        several = MultiStart((first, failed, low, ended(-2.0)))
        assert several.best is low
        np.testing.assert_array_equal(several.energies, [-1, np.nan, -3, -2])
        assert several.spread == 2.0

    def test_of_another_objective_the_best_has_its_least_value(self, ended: Make) -> None:
        low = ended(-1.0, objective="error-l2", extra={"objective_value": 0.1})
        high = ended(-3.0, objective="error-l2", extra={"objective_value": 0.2})
        several = MultiStart((high, low))
        assert several.best is low
        np.testing.assert_array_equal(several.ends, [0.2, 0.1])
        assert several.reported().extra["start_values"] == [0.2, 0.1]
        assert several.reported().extra["start_energies"] == [-3.0, -1.0]

    def test_without_a_success_it_is_the_first(self, ended: Make) -> None:
        first, other = ended(-1.0, success=False), ended(-3.0, success=False)
        several = MultiStart((first, other))
        assert several.best is first
        assert np.isnan(several.spread)
        record = several.reported().record()
        assert record["start_energies"] == [None, None]
        assert record["start_spread"] is None

    def test_its_report_is_the_best_with_all_energies(self, ended: Make) -> None:
        best = ended(-3.0, seed=7, extra={"own": 1})
        several = MultiStart((ended(-1.0), best))
        reported = several.reported()
        assert reported.extra == {
            "own": 1, "start_seeds": [None, 7], "start_energies": [-1.0, -3.0], "start_spread": 2.0
        }  # fmt: skip
        assert (reported.seed, reported.status) == (7, best.status)

    def test_an_interrupted_last_start_is_said(self, ended: Make) -> None:
        best, stopped = ended(-3.0), ended(-1.0, status=Status.INTERRUPTED)
        assert MultiStart((best, stopped)).reported().status is Status.INTERRUPTED
        assert MultiStart((stopped, best)).reported().status is best.status


class Strategy:
    """A strategy that notes how it was called."""

    def __init__(self, *ends: Solution) -> None:
        self.ends, self.calls = list(ends), []

    def __call__(self, problem: ContactProblem, **options: Any) -> Solution:
        self.calls.append((problem, options))
        return self.ends.pop(0)


def test_starts_are_the_mesh_as_given_and_the_seeds(ended: Make, problem: ContactProblem) -> None:
    solve = Strategy(*(ended(-1.0 * k) for k in range(4)))
    several = multistart(solve, problem, 3, tolerance=0.5)
    assert [options for _, options in solve.calls] == [
        {"seed": seed, "tolerance": 0.5} for seed in (None, 1, 2, 3)
    ]
    assert len(several.solutions) == 4
    chosen = Strategy(*(ended(-1.0 * k) for k in range(3)))
    multistart(chosen, problem, [5, 9])
    assert [options["seed"] for _, options in chosen.calls] == [None, 5, 9]


def test_an_interrupted_start_is_the_last(ended: Make, problem: ContactProblem) -> None:
    solve = Strategy(ended(-1.0), ended(-2.0, status=Status.INTERRUPTED), ended(-3.0))
    assert len(multistart(solve, problem, 5).solutions) == 2


def test_a_refined_mesh_moves_in_boxes_of_the_same_length(problem: ContactProblem) -> None:
    fine = refine(problem)
    assert fine.mesh.t.shape[1] == 4 * problem.mesh.t.shape[1]
    meshes = [problem.mesh, fine.mesh]
    edges = [np.linalg.norm(np.diff(m.p[:, m.facets], axis=1), axis=0).min() for m in meshes]
    fractions = [p.motion.delta.fraction for p in (problem, fine)]
    assert edges[1] * fractions[1] == pytest.approx(edges[0] * fractions[0], rel=1e-12)


def test_a_prolonged_motion_is_interpolated_linearly(problem: ContactProblem) -> None:
    """An affine motion stays affine; one node that moves takes the midpoints of its edges half of the way."""
    fine, p = refine(problem), problem.mesh.p
    affine = np.array([[1.1, 0.2], [-0.1, 0.9]])
    np.testing.assert_allclose(prolong(problem, affine @ p, fine), affine @ fine.mesh.p, atol=1e-15)
    moved = p.copy()
    moved[:, 4] += (0.1, -0.2)
    motion = prolong(problem, moved, fine) - fine.mesh.p
    around = np.any(problem.mesh.facets == 4, axis=0)
    np.testing.assert_allclose(motion[:, 4], (0.1, -0.2))
    np.testing.assert_allclose(motion[:, p.shape[1] :][:, around], [[0.05], [-0.1]] * np.ones(around.sum()))
    assert np.count_nonzero(motion) == 2 * (1 + around.sum())


def test_a_mesh_that_is_no_refinement_is_refused(problem: ContactProblem) -> None:
    fine = refine(problem)
    shifted = replace(fine, mesh=replace(fine.mesh, doflocs=fine.mesh.p + 1e-3))
    for wrong in (problem, shifted, refine(fine)):
        with pytest.raises(ValueError, match="not the uniform refinement"):
            prolong(problem, problem.mesh.p, wrong)


def test_each_level_begins_where_the_one_before_ended(ended: Make, problem: ContactProblem) -> None:
    moved = problem.mesh.p.copy()
    moved[:, 4] += 0.05
    coarse = ended(-1.0, mesh=replace(problem.mesh, doflocs=moved))
    fine = refine(problem)
    second = ended(-2.0, mesh=replace(fine.mesh, doflocs=prolong(problem, moved, fine)), problem=fine)
    solve = Strategy(coarse, second, ended(-3.0))
    assert len(multilevel(solve, problem, 2, tolerance=0.5)) == 3
    (_, first), (middle, then), (_, last) = solve.calls
    assert first == {"tolerance": 0.5}
    assert middle.mesh.t.shape[1] == 4 * problem.mesh.t.shape[1]
    np.testing.assert_allclose(then["start"], prolong(problem, moved, fine))
    np.testing.assert_allclose(last["start"], prolong(fine, second.mesh.p, refine(fine)))
    assert then["tolerance"] == 0.5


def test_levels_end_where_one_is_interrupted_and_none_is_refused(
    ended: Make, problem: ContactProblem
) -> None:
    stopped = Strategy(ended(-1.0, status=Status.INTERRUPTED), ended(-2.0))
    assert len(multilevel(stopped, problem, 3)) == 1
    assert len(multilevel(Strategy(ended(-1.0)), problem, 0)) == 1
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        multilevel(Strategy(), problem, -1)


class TestOptions:
    """``starts`` and ``levels`` of a strategy that takes a seed and a start."""

    @pytest.fixture
    def made(self, ended: Make) -> SimpleNamespace:
        calls: list[Any] = []

        def solve(problem: Any, *, seed: int | None = None, start: Any = None, **rest: Any) -> Solution:
            """Its own words."""
            calls.append((seed, start is not None, rest))
            return ended(-1.0 * len(calls), mesh=problem.mesh)

        return SimpleNamespace(solve=with_starts(solve), calls=calls)

    def test_their_names_are_in_the_signature_before_other_keywords(self, made: SimpleNamespace) -> None:
        assert list(inspect.signature(made.solve).parameters) == [
            "problem", "seed", "start", "starts", "levels", "rest"
        ]  # fmt: skip
        assert made.solve.__doc__ == "Its own words."
        plain = with_starts(lambda problem, *, seed=None, start=None: None)
        assert list(inspect.signature(plain).parameters)[-2:] == ["starts", "levels"]
        defaults = [inspect.signature(plain).parameters[name].default for name in ("starts", "levels")]
        assert defaults == [0, 0]

    @pytest.mark.parametrize(
        "solve",
        [lambda problem, *, seed=None: None, lambda problem, *, start=None: None, lambda problem: None],
    )
    def test_a_strategy_without_them_stays_as_it_is(self, solve: Any) -> None:
        assert with_starts(solve) is solve

    def test_without_them_it_is_solved_once(self, made: SimpleNamespace, problem: ContactProblem) -> None:
        solution = made.solve(problem, seed=3, more=1)
        assert made.calls == [(3, False, {"more": 1})]
        assert "start_energies" not in solution.extra
        assert "level_energies" not in solution.extra

    def test_starts(self, made: SimpleNamespace, problem: ContactProblem) -> None:
        solution = made.solve(problem, starts=2, seed=None)
        assert [seed for seed, *_ in made.calls] == [None, 1, 2]
        assert solution.extra["start_energies"] == [-1, -2, -3]
        assert solution.audit.energy_audited == -3

    def test_levels(self, made: SimpleNamespace, problem: ContactProblem) -> None:
        solution = made.solve(problem, levels=1, seed=4)
        assert made.calls == [(4, False, {}), (4, True, {})]
        assert solution.extra["level_energies"] == [-1, -2]
        assert solution.audit.energy_audited == -2

    @pytest.mark.parametrize("options", [{"starts": 2, "levels": 1}, {"starts": 2, "seed": 0}])
    def test_what_does_not_go_together_is_refused(
        self, made: SimpleNamespace, problem: ContactProblem, options: dict[str, int]
    ) -> None:
        with pytest.raises(ValueError, match="cannot be combined"):
            made.solve(problem, **options)
        assert made.calls == []
