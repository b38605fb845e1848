"""Looking for feasible branches, and putting pairs into the corner where that costs nothing."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options
from rmesh_nlp.mpcc import finish as finishing
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ScriptedRun, ended

ON_G, ON_H = np.array([True]), np.array([False])


class TestOtherBranch:
    """A feasible branch near the relaxed point."""

    @pytest.fixture
    def nearest(self, monkeypatch: pytest.MonkeyPatch) -> list[float]:
        self.answer: Any = (np.array([2.0, 0.0]), ON_H)
        radii: list[float] = []

        def found(lifted: Any, z: Any, p: Any, radius: float, seconds: float) -> Any:
            radii.append(radius)
            return self.answer

        monkeypatch.setattr(finishing, "nearest_branch", found)
        monkeypatch.setattr(finishing, "_follow_signs", lambda *_: None)
        return radii

    @staticmethod
    def other(run: ScriptedRun, z: tuple[float, float]) -> Any:
        return finishing._other_branch(run, np.array(z), ON_G, ended([9.0, 9.0], Status.INFEASIBLE))

    def test_it_is_sought_at_a_distance_like_that_of_the_pairs_then_further(
        self, nearest: list[float]
    ) -> None:
        good = ScriptedRun(branches=lambda call: ended([2.0, 0.0]), exact=lambda z: True)
        result, fix_G = self.other(good, (0.3, 0.5))
        assert nearest == pytest.approx([0.3 * reach for reach in finishing._REACHES[:1]])
        assert (list(result.x), fix_G) == ([2.0, 0.0], ON_H)
        bad = ScriptedRun(branches=lambda call: ended([1.0, 1.0]), exact=lambda z: False)
        nearest.clear()
        self.other(bad, (0.5, 0.3))
        assert nearest == pytest.approx([0.3 * reach for reach in finishing._REACHES])
        assert 1 < finishing._REACHES[0] < finishing._REACHES[1]
        assert len(bad.branch_calls) == 1  # the second time it is the same branch again
        nearest.clear()
        self.other(bad, (0.0, 1.0))  # a point on its branch: units of the corner's size
        assert nearest == pytest.approx([Options().corner * reach for reach in finishing._REACHES])

    def test_the_branch_that_is_known_to_fail_is_not_solved_again(self, nearest: list[float]) -> None:
        self.answer = (np.array([2.0, 0.0]), ON_G)
        run = ScriptedRun(branches=lambda call: ended([2.0, 0.0]), exact=lambda z: True)
        result, fix_G = self.other(run, (0.3, 0.5))
        assert (run.branch_calls, list(result.x), fix_G) == ([], [9.0, 9.0], ON_G)
        self.answer = None
        assert self.other(run, (0.3, 0.5))[1] is ON_G

    def test_signs_come_first(self, nearest: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
        by_signs = (ended([2.0, 0.0]), ON_H)
        monkeypatch.setattr(finishing, "_follow_signs", lambda *_: by_signs)
        assert self.other(ScriptedRun(), (0.3, 0.5)) is by_signs
        assert nearest == []


class TestSigns:
    """The primal-dual active set method: pairs whose free member is negative change sides."""

    @staticmethod
    def follow(ends: list[NLPResult], exact: bool = True) -> tuple[ScriptedRun, Any]:
        waiting = list(ends)
        run = ScriptedRun(branches=lambda call: waiting.pop(0), exact=lambda z: exact)
        return run, finishing._follow_signs(run, np.array([0.1, 0.2]), ON_G)

    def test_a_pair_with_a_negative_member_changes_sides(self) -> None:
        run, found = self.follow([ended([0.0, -0.5]), ended([0.4, 0.0]), ended([2.0, 0.0])])
        assert [call.options for call in run.branch_calls] == [
            {"phase": "signs", "free_signs": True},
            {"phase": "signs", "free_signs": True},
            {},
        ]
        assert [bool(call.fix_G[0]) for call in run.branch_calls] == [True, False, False]
        assert list(run.branch_calls[1].z) == [0.0, -0.5]
        assert (list(found[0].x), bool(found[1][0])) == ([2.0, 0.0], False)

    def test_it_ends_if_signs_become_worse_or_a_branch_fails(self) -> None:
        run, found = self.follow([ended([0.0, -0.5]), ended([-0.6, 0.0]), ended([2.0, 0.0])])
        assert (found, len(run.branch_calls)) == (None, 2)
        run, found = self.follow([ended([0.0, -0.5], Status.STALLED), ended([2.0, 0.0])])
        assert (found, len(run.branch_calls)) == (None, 1)
        run, found = self.follow([ended([0.0, -0.5]), ended([-0.4, 0.0]), ended([0.0, 0.3]), ended([0, 0.3])])
        assert len(run.branch_calls) == 4  # less wrong each time
        assert found is not None

    def test_a_branch_that_is_not_exact_is_no_end(self) -> None:
        _, found = self.follow([ended([0.0, 0.5]), ended([0.0, 0.5])], exact=False)
        assert found is None

    def test_signs_within_the_tolerance_are_right(self) -> None:
        run, found = self.follow([ended([0.0, -0.9e-8]), ended([0.0, 0.0])])
        assert (len(run.branch_calls), found[1]) == (2, ON_G)
        run, _ = self.follow([ended([0.0, -1.1e-8]), ended([0.0, 0.0]), ended([0.0, 0.0])])
        assert len(run.branch_calls) == 3


x, y, w = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("w")
XYW = ca.vertcat(x, y, w)


class TestTighten:
    """Pairs next to the corner are put into it where that costs nothing."""

    @staticmethod
    def tightened(
        at: float, tight: NLPResult, monkeypatch: pytest.MonkeyPatch, exact: bool = True, closes: bool = True
    ) -> tuple[ScriptedRun, NLPResult, NLPResult]:
        monkeypatch.setattr(finishing, "_can_close", lambda *_: closes)
        run = ScriptedRun(branches=lambda call: tight, exact=lambda z: exact)
        before = ended([0.0, at], f=1.0)
        return run, before, finishing._tighten(run, before, ON_G)

    def test_both_members_are_fixed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        tight = ended([0.0, 0.0], f=1.0 + 1e-9)
        run, _, after = self.tightened(1e-5, tight, monkeypatch)
        assert after is tight
        (call,) = run.branch_calls
        assert (call.fix_G[0], call.fix_H[0]) == (True, True)
        assert call.options == {"phase": "tightened"}

    @pytest.mark.parametrize("at", [1e-9, 1e-4])
    def test_pairs_in_the_corner_or_far_from_it_are_left(
        self, at: float, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        run, before, after = self.tightened(at, ended([0.0, 0.0]), monkeypatch)
        assert after is before
        assert run.branch_calls == []

    def test_what_costs_or_fails_is_not_taken(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _, before, after = self.tightened(1e-5, ended([0.0, 0.0], f=1.0 + 3e-9), monkeypatch)
        assert after is before
        _, before, after = self.tightened(1e-5, ended([0.0, 0.0], f=0.0), monkeypatch, exact=False)
        assert after is before
        run, before, after = self.tightened(1e-5, ended([0.0, 0.0]), monkeypatch, closes=False)
        assert (after, run.branch_calls) == (before, [])

    @pytest.mark.parametrize(
        ("row", "closes"),
        [
            (None, True),
            (y - 1e-5, False),  # held open by an equation
            (y - 1e-2 * w, True),  # w moves by a hundred times the gap
            (y - 1e-5 * w, False),  # by 1e5 times the gap
            (1e6 * (y - 1e-2 * w), True),  # the size of a row does not matter
        ],
    )
    def test_a_step_that_closes_the_pair_must_exist_and_be_small(self, row: Any, closes: bool) -> None:
        mpcc = MPCC(
            XYW, (x - 1) ** 2 + y**2 + w**2, row, x, y, **({} if row is None else {"lbg": 0, "ubg": 0})
        )
        run = Run(CompiledNLPs(mpcc, Options()), np.zeros(0))
        gap = 1e-5
        ratio = {"(y-(0.01*w))": 1e-2, "(1e+06*(y-(0.01*w)))": 1e-2, "(y-(1e-05*w))": 1e-5}.get(str(row), 1.0)
        z = np.array([0.0, gap, gap / ratio])
        assert finishing._can_close(run, z, ON_G, np.array([True])) == closes

    def test_rows_that_are_not_active_do_not_hold(self) -> None:
        mpcc = MPCC(XYW, x + y, y + w, x, y, lbg=-1.0)
        run = Run(CompiledNLPs(mpcc, Options()), np.zeros(0))
        assert finishing._can_close(run, np.array([0.0, 1e-5, 0.0]), ON_G, np.array([True]))
        mpcc = MPCC(XYW, x + y, y, x, y, lbg=1e-5)
        run = Run(CompiledNLPs(mpcc, Options()), np.zeros(0))
        assert not finishing._can_close(run, np.array([0.0, 1e-5, 0.0]), ON_G, np.array([True]))
