"""The exact finish: which branches it visits, what it accepts, and how it says where it ended."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options
from rmesh_nlp.mpcc import finish as finishing
from rmesh_nlp.mpcc.finish import Finish, finish, pivot, polished
from rmesh_nlp.mpcc.lpec import Direction
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.polish import Polished
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status
from support.scripted_run import BranchCall, ScriptedRun, ended, two_minima

ON_G, ON_H = np.array([True]), np.array([False])
DOWN = Direction(-1.0, np.zeros(2), ON_H)


def judged(f: float, status: Status = Status.CONVERGED, direction: Direction | None = None) -> Finish:
    return Finish(np.array([2.0, 0.0]), f, status, Stationarity("W", None, None, direction), lpecs=1)


class TestPolished:
    """Pairs near the corner are put into it if the branch itself gives nothing stationary."""

    @pytest.fixture
    def fixed(self, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
        sets: list[Any] = []
        self.answers: list[Finish | None] = []

        def answer(run: Any, z: Any, warm: Any, fix_G: Any, fix_H: Any, ceiling: float) -> Finish | None:
            sets.append((bool(fix_G[0]), bool(fix_H[0])))
            return self.answers.pop(0)

        monkeypatch.setattr(finishing, "_polished", answer)
        return sets

    def polished(self, z: tuple[float, float], corner: float, *answers: Finish | None) -> Finish | None:
        self.answers = list(answers)
        return polished(ScriptedRun(), np.array(z), ended(z), corner)

    def test_a_stationary_point_of_the_branch_is_enough(self, fixed: list[Any]) -> None:
        good = judged(1.0)
        assert self.polished((0.1, 0.2), 0.3, good) is good
        assert self.polished((0.2, 0.1), 0.3, good) is good
        assert fixed == [(True, False), (False, True)]

    def test_a_pair_far_from_the_corner_stays_in_its_branch(self, fixed: list[Any]) -> None:
        open_end = judged(1.0, Status.STALLED)
        assert self.polished((0.1, 0.4), 0.3, open_end) is open_end
        assert fixed == [(True, False)]

    @pytest.mark.parametrize("z", [(0.1, 0.2), (0.2, 0.1), (0.1, 0.3)])
    def test_the_better_of_branch_and_corner_is_taken(self, fixed: list[Any], z: tuple[float, float]) -> None:
        open_end, good = judged(1.0, Status.STALLED), judged(2.0)
        assert self.polished(z, 0.3, open_end, good) is good
        assert fixed[1] == (True, True)
        assert self.polished(z, 0.3, open_end, None) is open_end
        assert self.polished(z, 0.3, open_end, judged(2.0, Status.STALLED)) is open_end
        assert self.polished(z, 0.3, None, good) is good
        assert self.polished(z, 0.3, None, None) is None


@pytest.mark.parametrize(
    ("z", "fix_G", "fix_H"),
    [
        ((0.1, 0.2, 0.1, 4.0), [True, True], [True, False]),
        ((0.2, 0.1, 4.0, 0.1), [True, False], [True, True]),
        ((0.1, 4.0, 0.2, 0.1), [True, True], [False, True]),
        ((4.0, 0.1, 0.1, 0.2), [False, True], [True, True]),
    ],
)
def test_only_the_pairs_near_the_corner_are_put_into_it(
    z: tuple[float, ...], fix_G: list[bool], fix_H: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    v = ca.SX.sym("v", 4)
    run = ScriptedRun(mpcc=MPCC(v, ca.sumsqr(v), None, v[:2], v[2:]))
    calls: list[Any] = []
    monkeypatch.setattr(finishing, "_polished", lambda run, z, warm, G, H, ceiling: calls.append((G, H)))
    a, b, c, d = z  # pairs (a, b) and (c, d)
    assert polished(run, np.array([a, c, b, d]), ended(z), 0.3) is None
    sides = [(list(G), list(H)) for G, H in calls]
    assert sides == [([a < b, c < d], [a > b, c > d]), (fix_G, fix_H)]


@pytest.mark.parametrize(("ceiling", "is_judged"), [(2.9, False), (3.0, True), (np.inf, True)])
def test_a_polished_point_above_the_ceiling_is_not_judged(
    ceiling: float, is_judged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    point = Polished(np.array([2.0, 0.0]), 3.0, np.zeros(0), np.array([0.0, 2.0]))
    monkeypatch.setattr(finishing, "polish", lambda *_: point)
    run = ScriptedRun()
    found = finishing._polished(run, point.z, ended(point.z), ON_G, ON_H, ceiling)
    assert (found is not None) == is_judged
    assert [step.phase for step in run.steps] == ["polished"] * is_judged
    monkeypatch.setattr(finishing, "polish", lambda *_: None)
    assert finishing._polished(run, point.z, ended(point.z), ON_G, ON_H, np.inf) is None


def test_an_end_by_itself_has_visited_nothing() -> None:
    end = Finish(np.zeros(2), np.nan, Status.STALLED)
    assert (end.pivots, end.lpecs, end.stationarity, end.rank) == (0, 0, None, (False, False, -np.inf))


def test_judging_counts_a_program_over_the_branches_unless_s_is_proved() -> None:
    """At (2, 0) of two minima nothing is biactive: S; at the corner both slopes descend: C, and an LPEC."""
    run = ScriptedRun()
    good = finishing._labelled(run, np.array([2.0, 0.0]), 1.0, (np.zeros(0), np.array([0.0, 2.0])))
    assert (good.status, good.stationarity.label, good.lpecs, good.pivots) == (Status.CONVERGED, "S", 0, 0)
    bad = finishing._labelled(run, np.zeros(2), 5.0, None)
    assert (bad.status, bad.stationarity.label, bad.lpecs) == (Status.STALLED, "C", 1)


def test_a_polished_point_must_not_be_much_worse_than_the_relaxed_one() -> None:
    """f of two minima is 5 at the origin; a hundredth of the larger value may be lost."""
    run = ScriptedRun()
    at_origin = np.zeros(2)
    for f, is_faithful in ((4.0, True), (5.0, True), (5.04, True), (5.06, False), (9.0, False)):
        assert finishing._faithful(run, judged(f), at_origin) == is_faithful
    flat = ScriptedRun(mpcc=MPCC(two_minima().x, 0, None, *ca.vertsplit(two_minima().x)))
    assert finishing._faithful(flat, judged(5e-5), at_origin)
    assert finishing._faithful(flat, judged(1.005e-4), at_origin)
    assert not finishing._faithful(flat, judged(1.02e-4), at_origin)


class TestBranches:
    """What `finish` makes of the ends of its branches."""

    WARM = ended([0.1, 2.0])

    @staticmethod
    def run(*results: NLPResult, exact: bool | list[bool] = True, **options: Any) -> ScriptedRun:
        waiting = list(results)
        return ScriptedRun(
            branches=lambda call: waiting.pop(0) if len(waiting) > 1 else waiting[0],
            exact=lambda z: exact if isinstance(exact, bool) else bool(z[0] == 2.0),
            **options,
        )

    @pytest.fixture(autouse=True)
    def _simple(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.polished: Finish | None = None
        self.projected: Any = None
        self.pivots: list[Finish] = []
        self.tightened: list[Any] = []
        monkeypatch.setattr(finishing, "polished", lambda *_: self.polished)
        monkeypatch.setattr(finishing, "pivot", self._pivot)
        monkeypatch.setattr(finishing, "_labelled", lambda run, z, f, lam: judged(f))
        monkeypatch.setattr(finishing, "_tighten", self._tighten)
        monkeypatch.setattr(finishing, "_projected", self._projected)

    def _pivot(self, run: Any, here: Finish) -> Finish:
        self.pivots.append(here)
        return here

    def _tighten(self, run: Any, result: NLPResult, fix_G: Any) -> NLPResult:
        self.tightened.append(fix_G)
        return result

    def _projected(self, run: Any, z: Any, end: Finish) -> Any:
        self.projected = end
        return end

    def test_newton_s_point_is_taken_if_it_is_faithful_and_stationary(self) -> None:
        self.polished = judged(4.0)
        run = self.run(ended([2.0, 0.0], f=1.0))
        assert finish(run, np.array([0.1, 2.0]), search=True, warm=self.WARM) is self.polished
        assert run.branch_calls == []
        assert self.pivots == [self.polished]

    @pytest.mark.parametrize("near", [None, judged(400.0), judged(4.0, Status.STALLED)])
    def test_else_the_branch_is_solved_without_multipliers(self, near: Finish | None) -> None:
        self.polished = near
        run = self.run(ended([2.0, 0.0], f=1.0))
        end = finish(run, np.array([0.1, 2.0]), search=True, warm=self.WARM)
        assert end.f == 1.0
        assert end.solved
        (call,) = run.branch_calls
        assert call.options == {"warm": None}
        assert call.fix_G[0]
        assert self.projected is None
        assert self.tightened == [ON_G]

    def test_without_newton_the_branch_begins_with_the_multipliers_and_again_without_if_it_fails(
        self,
    ) -> None:
        good, bad = ended([2.0, 0.0], f=1.0), ended([0.3, 0.0], Status.STALLED)
        run = self.run(good, newton_finish=False, exact=[])
        finish(run, np.array([0.1, 2.0]), search=False, warm=self.WARM)
        assert [call.options.get("warm") for call in run.branch_calls] == [self.WARM]
        run = self.run(bad, good, newton_finish=False, exact=[])
        assert finish(run, np.array([0.1, 2.0]), search=False, warm=self.WARM).solved
        assert [call.options.get("warm") for call in run.branch_calls] == [self.WARM, None]
        run = self.run(bad, newton_finish=False, exact=[])
        finish(run, np.array([0.1, 2.0]), search=False)
        assert len(run.branch_calls) == 1

    def test_pairs_are_fixed_on_the_side_of_the_smaller_member(self) -> None:
        for z, on_G in (((0.1, 2.0), True), ((2.0, 0.1), False), ((1.0, 1.0), True)):
            run = self.run(ended([2.0, 0.0]))
            finish(run, np.array(z), search=False)
            assert run.branch_calls[0].fix_G[0] == on_G

    def test_an_exact_point_without_a_bound_or_above_the_ceiling_is_not_improved(self) -> None:
        end = finish(self.run(ended([2.0, 0.0], Status.UNBOUNDED, -1e20)), np.ones(2), search=False)
        assert (end.status, end.f, end.stationarity) == (Status.UNBOUNDED, -1e20, None)
        end = finish(self.run(ended([2.0, 0.0], f=3.0)), np.ones(2), search=True, ceiling=2.9)
        assert (end.status, end.f, end.stationarity) == (Status.WORSE, 3.0, None)
        assert finish(self.run(ended([2.0, 0.0], f=3.0)), np.ones(2), search=True, ceiling=3.0).solved

    @pytest.mark.parametrize(
        ("status", "said"),
        [(Status.CONVERGED, Status.INACCURATE), (Status.STALLED, Status.STALLED),
         (Status.UNBOUNDED, Status.UNBOUNDED)],
    )  # fmt: skip
    def test_a_point_that_is_not_exact_is_never_solved(
        self, status: Status, said: Status, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run = self.run(ended([0.3, 0.0], status, f=1.0), exact=False)
        end = finish(run, np.ones(2), search=False, ceiling=0.5)
        assert (end.status, end.stationarity, end.solved) == (said, None, False)
        assert self.projected is None
        assert self.tightened == []
        monkeypatch.setattr(finishing, "_other_branch", lambda run, z, fix_G, result: (result, fix_G))
        finish(run, np.ones(2), search=True)
        assert self.projected is not None  # with a search the relaxed point itself is tried at last

    def test_only_a_search_looks_for_another_branch(self, monkeypatch: pytest.MonkeyPatch) -> None:
        good = ended([2.0, 0.0], f=1.0)
        monkeypatch.setattr(finishing, "_other_branch", lambda run, z, fix_G, result: (good, ON_H))
        bad = ended([0.3, 0.0], Status.INFEASIBLE)
        assert not finish(self.run(bad, exact=[]), np.ones(2), search=False).solved
        assert finish(self.run(bad, exact=[]), np.ones(2), search=True).solved
        assert self.tightened == [ON_H]


class TestPivot:
    """A descent over branches, each lower than the one before."""

    @pytest.fixture
    def descend(self, monkeypatch: pytest.MonkeyPatch) -> list[NLPResult | None]:
        waiting: list[NLPResult | None] = []
        monkeypatch.setattr(finishing, "_descend", lambda *_: waiting.pop(0))
        monkeypatch.setattr(finishing, "_tighten", lambda run, result, fix_G: result)
        return waiting

    def test_it_ends_at_a_point_without_a_direction(self, descend: Any, monkeypatch: Any) -> None:
        monkeypatch.setattr(
            finishing, "_labelled",
            lambda run, z, f, lam: judged(f, *((Status.STALLED, DOWN) if f > 1.0 else ())),
        )  # fmt: skip
        descend += [ended([0, 0], f=3.0), ended([0, 0], f=2.0), ended([0, 0], f=1.0)]
        end = pivot(ScriptedRun(), judged(4.0, Status.STALLED, DOWN))
        assert (end.f, end.pivots, end.lpecs, end.solved) == (1.0, 3, 4, True)

    def test_it_ends_where_no_branch_is_lower(self, descend: Any) -> None:
        start = judged(4.0, Status.STALLED, DOWN)
        descend += [None]
        end = pivot(ScriptedRun(), start)
        assert (end.f, end.pivots, end.status) == (4.0, 0, Status.STALLED)
        assert pivot(ScriptedRun(), Finish(np.zeros(2), 1.0, Status.STALLED)).status is Status.STALLED

    def test_its_limit_is_a_status(self, descend: Any, monkeypatch: Any) -> None:
        monkeypatch.setattr(finishing, "_labelled", lambda run, z, f, lam: judged(f, Status.STALLED, DOWN))
        descend += [ended([0, 0], f=3.0 - k) for k in range(5)]
        end = pivot(ScriptedRun(max_pivots=2), judged(4.0, Status.STALLED, DOWN))
        assert (end.f, end.pivots, end.lpecs, end.status) == (2.0, 2, 3, Status.ITERATION_LIMIT)

    def test_a_branch_without_a_bound_ends_it(self, descend: Any) -> None:
        descend += [ended([0, 0], Status.UNBOUNDED, -1e20)]
        end = pivot(ScriptedRun(), judged(4.0, Status.STALLED, DOWN))
        assert (end.f, end.pivots, end.lpecs, end.status) == (-1e20, 1, 1, Status.UNBOUNDED)
        assert end.stationarity is None

    @pytest.mark.parametrize(
        ("ends", "tries"),
        [([(True, 0.9)], 1), ([(False, 0.5), (True, 0.9)], 2), ([(True, 1.5), (True, 1.0), (True, 0.9)], 3)],
    )
    def test_a_lower_point_is_sought_far_away_and_then_in_smaller_boxes(
        self, ends: list[tuple[bool, float]], tries: int
    ) -> None:
        here = Finish(np.array([3.0, 0.0]), 1.0, Status.STALLED)
        waiting = list(ends)

        def branch(call: BranchCall) -> NLPResult:
            exact, f = waiting.pop(0)
            return ended([float(exact), 0.0], f=f)

        run = ScriptedRun(branches=branch, exact=lambda z: bool(z[0]))
        assert finishing._descend(run, here, DOWN).f == 0.9
        assert len(run.branch_calls) == tries
        boxes = [call.options["box"] for call in run.branch_calls]
        assert boxes[0] is None
        for box, reach in zip(boxes[1:], (0.1, 1e-3), strict=False):
            np.testing.assert_allclose(box, [4 * reach, reach])  # relative to 1 + |z|
        assert all(call.fix_G is ON_H for call in run.branch_calls)

    def test_a_fall_by_rounding_is_none(self) -> None:
        here = Finish(np.zeros(2), -99.0, Status.STALLED)
        for f, accepted in ((-99.0 - 5e-8, False), (-99.0 - 2e-7, True)):
            run = ScriptedRun(branches=lambda call, f=f: ended([0, 0], f=f), exact=lambda z: True)
            assert (finishing._descend(run, here, DOWN) is not None) == accepted


def test_a_projected_point_counts_if_it_is_better_than_the_end_it_replaces() -> None:
    """The relaxed point next to the minimum (2, 0) of two minima: on its branch and stationary."""
    run = Run(CompiledNLPs(two_minima(), Options()), np.zeros(0))
    lost = Finish(np.ones(2), 0.0, Status.STALLED)
    found = finishing._projected(run, np.array([2.0, 1e-6]), lost)
    assert found.solved
    assert found.z == pytest.approx([2.0, 0.0], abs=1e-12)
    assert found.f == pytest.approx(1.0)
    assert run.steps[-1].phase == "polished"
    best = Finish(np.ones(2), 0.0, Status.CONVERGED, found.stationarity)
    assert finishing._projected(run, np.array([2.0, 1e-6]), best) is best
