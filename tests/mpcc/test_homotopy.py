"""The path of the relaxations: which t follows which, when it retreats, and when it ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rmesh_nlp.mpcc import homotopy
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import Answer, Call, ScriptedRun

START = np.array([0.5, 0.5])
SOLVED = Finish(np.array([2.0, 0.0]), 1.0, Status.CONVERGED)
UNSOLVED = Finish(np.array([2.0, 0.0]), 1.0, Status.STALLED)
TENTHS = [10.0**-k for k in range(9)]


class Finishes:
    """Stands for the exact finish: notes how it was called, and ends as the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[str, Any]] = []
        self.full, self.near, self.pivoted = UNSOLVED, None, SOLVED
        monkeypatch.setattr(homotopy, "finish", self._finish)
        monkeypatch.setattr(homotopy, "polished", self._polished)
        monkeypatch.setattr(homotopy, "pivot", self._pivot)

    def _finish(self, run: Any, z: Any, **options: Any) -> Finish:
        self.calls.append(("finish", {"z": z, "t": run.ts[-1], **options}))
        return self.full

    def _polished(self, run: Any, z: Any, warm: Any, corner: float) -> Finish | None:
        self.calls.append(("polished", {"z": z, "t": run.ts[-1], "corner": corner, "warm": warm}))
        return self.near

    def _pivot(self, run: Any, near: Finish) -> Finish:
        self.calls.append(("pivot", {"t": run.ts[-1]}))
        return self.pivoted

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [call for name, call in self.calls if name == kind]


@pytest.fixture
def finishes(monkeypatch: pytest.MonkeyPatch) -> Finishes:
    return Finishes(monkeypatch)


def followed(answers: Callable[[Call], Answer], **options: Any) -> tuple[ScriptedRun, Path]:
    names = ("first", "patience", "relaxation", "t0")
    own = {name: options.pop(name) for name in names if name in options}
    run, path = ScriptedRun(answers, exact=options.pop("exact", lambda z: False), **options), Path()
    follow(run, path, own.pop("relaxation", "scholtes"), START, own.pop("t0", 1.0), **own)
    return run, path


def restless(call: Call) -> Answer:
    """Sides that change from step to step, products that follow t."""
    even = round(np.log10(call.t)) % 2 == 0
    return Answer((1.0, 0.5) if even else (0.5, 1.0), product=call.t)


def settled(call: Call) -> Answer:
    return Answer((1.0, 0.5), product=call.t)


def test_t_goes_down_to_the_end_and_the_last_point_is_finished_with_a_search(finishes: Finishes) -> None:
    run, path = followed(restless)
    assert run.ts == pytest.approx(TENTHS)
    (last,) = finishes.of("finish")
    assert last["search"] is True
    assert last["warm"] is not None
    assert last["corner"] == pytest.approx(homotopy.CORNER * 1e-4)
    assert finishes.of("polished") == []
    assert path.finish is UNSOLVED
    assert path.failure is None
    np.testing.assert_array_equal(run.calls[0].z, START)
    np.testing.assert_array_equal(run.calls[3].z, [1.0, 0.5])  # from the solution of the step before
    assert [call.first for call in run.calls] == [True] + [False] * 8


def test_an_exact_relaxed_point_is_the_end_of_the_path(finishes: Finishes) -> None:
    run, _ = followed(restless, exact=lambda z: z[0] == 0.5)
    assert run.ts == pytest.approx([1.0, 0.1])
    assert [call["search"] for call in finishes.of("finish")] == [True]


def test_settled_sides_are_finished_early_from_the_crossover_on(finishes: Finishes) -> None:
    finishes.near = SOLVED
    run, path = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0))
    assert run.ts == pytest.approx([1.0, 0.1, 0.01])
    assert finishes.of("polished")[0]["corner"] == pytest.approx(homotopy.CORNER * 0.1)
    assert path.finish is SOLVED
    later, _ = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0), crossover=1e-3)
    assert later.ts == pytest.approx([1.0, 0.1, 0.01, 1e-3])
    first, _ = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0), crossover=1.0)
    assert first.ts == pytest.approx([1.0, 0.1])  # two steps are needed to see that nothing changes


def test_changing_sides_are_not_finished_early(finishes: Finishes) -> None:
    finishes.near = SOLVED
    followed(restless)
    assert finishes.of("polished") == []


@pytest.mark.parametrize("near", [None, UNSOLVED])
def test_an_early_finish_that_proves_nothing_lets_the_path_go_on(
    finishes: Finishes, near: Finish | None
) -> None:
    finishes.near = finishes.pivoted = near
    finishes.full = SOLVED
    run, path = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0))
    assert run.ts == pytest.approx(TENTHS)
    assert path.finish is SOLVED


@pytest.mark.parametrize(("expected", "ends"), [(1.0, True), (1.5, True), (0.9, False)])
def test_an_early_finish_above_what_the_path_foretells_is_not_yet_final(
    finishes: Finishes, expected: float, ends: bool
) -> None:
    finishes.near = SOLVED  # f = 1
    finishes.full = UNSOLVED
    run, path = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=expected))
    assert (len(run.ts) == 3) == ends
    assert path.finish is SOLVED  # the better of the two


def test_the_objective_of_a_step_is_weighted_as_that_of_a_finish(finishes: Finishes) -> None:
    finishes.near = SOLVED
    run, _ = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=0.01), weight=100.0)
    assert len(run.ts) == 3


def test_multipliers_foretell_what_closing_the_pairs_costs(finishes: Finishes) -> None:
    """H = 0.5 is to be closed with the multiplier -2: the objective changes by -2 times 0.5."""
    finishes.near = SOLVED
    run, _ = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=2.0, lam_x=(9.0, -2.0)))
    assert len(run.ts) == 3
    run, _ = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.5, lam_x=(0.0, -2.0)))
    assert len(run.ts) > 3


@pytest.mark.parametrize(("f", "descends"), [(1.0, True), (1.04, True), (1.2, False)])
def test_branches_are_descended_over_from_a_good_point_at_small_t_only(
    finishes: Finishes, f: float, descends: bool
) -> None:
    finishes.near = Finish(np.array([2.0, 0.0]), f, Status.STALLED)
    finishes.pivoted = finishes.near
    followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0))
    ts = [call["t"] for call in finishes.of("pivot")]
    assert (len(ts) >= 3) == descends
    assert all(t <= 1.01e-4 for t in ts)


def test_without_newton_an_early_finish_is_that_by_the_interior_point_without_a_search(
    finishes: Finishes,
) -> None:
    finishes.full = SOLVED
    run, path = followed(lambda call: Answer((1.0, 0.5), product=call.t, objective=1.0), newton_finish=False)
    assert run.ts == pytest.approx([1.0, 0.1, 0.01])
    (call,) = finishes.of("finish")
    assert call["search"] is False
    assert call["warm"] is not None
    assert path.finish is SOLVED


def failing(status: Status, bad: Callable[[float], bool]) -> Callable[[Call], Answer]:
    def answer(call: Call) -> Answer:
        return Answer(status=status) if bad(call.t) else restless(call)

    return answer


def test_a_step_that_fails_retreats_half_of_the_way_and_goes_on_by_smaller_steps(finishes: Finishes) -> None:
    """From 1 to 0.1 and from 0.316 to 0.1: the factor becomes its square root."""
    failed: list[float] = []

    def once(call: Call) -> Answer:
        if call.t < 0.5 and len(failed) < 2:  # from the last solution, and from the start
            failed.append(call.t)
            return Answer(status=Status.STALLED)
        return Answer((1.0, 0.5) if len(failed) % 2 else (0.5, 1.0), product=call.t)

    run, path = followed(once, crossover=1e-12)
    half = 10**-0.5
    assert run.ts[:6] == pytest.approx([1.0, 0.1, 0.1, half, 0.1, 0.1 * half])
    assert failed == pytest.approx([0.1, 0.1])
    assert run.ts[-1] == pytest.approx(1e-8)
    assert path.failure is None
    np.testing.assert_array_equal(run.calls[2].z, START)
    assert run.calls[2].first


@pytest.mark.parametrize(
    ("status", "patience", "tried"),
    [
        (Status.ITERATION_LIMIT, 3, [0.1, 0.1**0.5, 0.1**0.25, 0.1**0.125]),
        (Status.ITERATION_LIMIT, 0, [0.1]),
        (Status.INFEASIBLE, 3, [0.1, 0.1**0.5]),
    ],
)
def test_retreats_are_counted_and_infeasible_ones_twice(
    finishes: Finishes, status: Status, patience: int, tried: list[float]
) -> None:
    run, path = followed(failing(status, lambda t: t < 1.0), patience=patience)
    assert sorted(set(run.ts[1:])) == pytest.approx(sorted(tried))
    assert len(run.ts) == 1 + len(tried) * (1 if status is Status.ITERATION_LIMIT else 2)
    assert path.failure is status
    (call,) = finishes.of("finish")  # what there is, with a search
    assert call["search"] is True
    np.testing.assert_array_equal(call["z"], path.relaxed.x)
    assert path.relaxed.converged


def test_a_first_step_that_fails_ends_the_path_and_its_point_is_finished_without_a_search(
    finishes: Finishes,
) -> None:
    run, path = followed(failing(Status.STALLED, lambda t: True))
    assert run.ts == [1.0]
    assert path.failure is path.relaxed.status is Status.STALLED
    assert [call["search"] for call in finishes.of("finish")] == [False]
    lost = lambda call: Answer((np.nan, 1.0), Status.EVALUATION_ERROR)  # noqa: E731
    _, path = followed(lost)
    assert len(finishes.of("finish")) == 1
    assert path.finish is None


def test_a_failure_below_the_crossover_is_finished_from_the_point_before_it(finishes: Finishes) -> None:
    finishes.full = SOLVED
    run, path = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5e-2))
    assert run.ts == pytest.approx([1.0, 0.1, 0.01, 1e-3])
    (call,) = finishes.of("finish")
    assert call["search"] is False
    assert call["corner"] == pytest.approx(homotopy.CORNER * 0.1)  # of the last t that was solved
    np.testing.assert_array_equal(call["z"], [1.0, 0.5])
    assert path.finish is SOLVED
    above, _ = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5), crossover=1e-2, patience=0)
    assert [call["search"] for call in finishes.of("finish")][1:] == [True]  # only when retreats are used up
    assert above.ts == pytest.approx([1.0, 0.1])


def test_a_failure_below_the_crossover_that_is_not_finished_retreats(finishes: Finishes) -> None:
    run, path = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5e-2), patience=1)
    assert run.ts[4:] == pytest.approx([1e-3 * 10**0.5])
    assert [call["search"] for call in finishes.of("finish")] == [False, False]
    assert path.finish is UNSOLVED


@pytest.mark.parametrize(("fall", "ends"), [(1.0, True), (0.95, True), (0.8, False)])
def test_products_that_do_not_fall_end_at_a_violation(finishes: Finishes, fall: float, ends: bool) -> None:
    """They count from t = 0.01 on, where they are ten times t, and the third in turn is the last."""
    run, path = followed(
        lambda call: Answer(
            (1.0, 0.5) if len(run_ts(call)) % 2 else (0.5, 1.0), product=fall ** -np.log10(call.t)
        )
    )
    assert (path.failure is Status.INFEASIBLE) == ends
    assert run.ts == pytest.approx(TENTHS[:5] if ends else TENTHS)
    assert [call["search"] for call in finishes.of("finish")] == [True]


def run_ts(call: Call) -> range:
    return range(round(-np.log10(call.t)))


def test_known_multipliers_start_the_first_step_with_zeros_for_the_relaxation_s_own_rows(
    finishes: Finishes,
) -> None:
    from support.scripted_run import ended

    known = ended([0.5, 0.5], lam_x=np.array([1.0, 2.0]), lam_g=np.zeros(0))
    run, _ = followed(restless, first=known)
    assert run.calls[0].first
    np.testing.assert_array_equal(run.calls[0].warm.lam_x, [1.0, 2.0])
    np.testing.assert_array_equal(run.calls[0].warm.lam_g, [0.0])
    assert run.calls[1].warm is None


def test_a_step_at_its_iteration_limit_is_not_repeated_from_the_start(finishes: Finishes) -> None:
    run, _ = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 1.0), patience=0)
    assert run.ts == pytest.approx([1.0, 0.1])
    run, path = followed(failing(Status.STALLED, lambda t: t < 1.0), patience=0)
    assert run.ts == pytest.approx([1.0, 0.1, 0.1])
    assert path.failure is Status.STALLED


def exact(f: float, status: Status = Status.STALLED) -> Finish:
    return Finish(np.zeros(2), f, status, Stationarity("W"))


def test_of_two_ends_the_solved_then_the_exact_then_the_lower_is_better() -> None:
    inexact = Finish(np.zeros(2), -9.0, Status.STALLED)
    for better, worse in (
        (SOLVED, exact(0.0)),
        (exact(5.0), inexact),
        (exact(1.0), exact(2.0)),
        (exact(1.0), exact(np.nan)),
    ):
        for one, other in ((worse, better), (better, worse)):
            path = Path(one)
            path.keep(other)
            assert path.finish is better
    twin = exact(1.0)
    path = Path(twin)
    assert path.keep(exact(1.0)) is False
    assert path.finish is twin
    path = Path()
    assert path.keep(SOLVED)
    assert path.finish is SOLVED


def test_a_path_ends_with_a_stationary_point_or_without_a_bound() -> None:
    assert Path(finish=SOLVED).ended
    assert Path(finish=Finish(np.zeros(2), -1e20, Status.UNBOUNDED)).ended
    assert not Path(finish=UNSOLVED).ended
    assert not Path().ended


@pytest.mark.parametrize(
    ("finished", "expected", "within"),
    [(1.0, 1.0, True), (1.0009, 1.0, True), (1.002, 1.0, False), (-5.0, 1.0, True), (-1.002, -1.0, True),
     (-1.0, -1.002, False), (-1.0, -1.0009, True), (5e-7, 0.0, True), (2e-6, 0.0, False)],
)  # fmt: skip
def test_an_end_is_where_the_path_was_going_to_a_thousandth_or_lower(
    finished: float, expected: float, within: bool
) -> None:
    assert homotopy._at_the_limit(finished, expected, 1e-3) == within


def test_sides_are_settled_if_one_in_a_hundred_changes() -> None:
    before = np.zeros(200, dtype=bool)
    for changes, is_settled in ((0, True), (2, True), (3, False)):
        after = before.copy()
        after[:changes] = True
        assert homotopy._settled(before, after) == is_settled
