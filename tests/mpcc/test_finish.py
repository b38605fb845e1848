"""The exact finish: which branches it visits, what it accepts, and how it says where it ended."""

import itertools

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc import finish as finishing
from rmesh_nlp.mpcc.finish import Finish, finish, pivot, polished
from rmesh_nlp.mpcc.lpec import Direction
from rmesh_nlp.mpcc.phase_one import Feasibility
from rmesh_nlp.mpcc.polish import Polished
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ON_G, ON_H, XY, ScriptedRun, ended, run_of, two_minima, x, y

S = Status
DOWN = Direction(-1.0, np.zeros(2), ON_H)
EQUATION = {"lbg": 0, "ubg": 0}


def labelled(f, status=S.CONVERGED, direction=None):
    return Finish(np.array([2.0, 0.0]), f, status, Stationarity("W", None, None, direction), lpecs=1)


def scripted(*results, exact=True, **options):
    """A run whose branches end in turn as given, the last of them again and again."""
    waiting = list(results)
    is_exact = exact if callable(exact) else lambda z: exact
    answer = lambda call: waiting.pop(0) if len(waiting) > 1 else waiting[0]  # noqa: E731
    return ScriptedRun(branches=answer, exact=is_exact, **options)


OPEN, GOOD, POOR = labelled(1.0, S.STALLED), labelled(2.0), labelled(2.0, S.STALLED)


@pytest.mark.parametrize(
    ("z", "answers", "fixed", "taken"),
    [
        ((0.1, 0.2), [GOOD], [(True, False)], GOOD),  # a stationary point of the branch is enough
        ((0.2, 0.1), [GOOD], [(False, True)], GOOD),
        ((0.1, 0.4), [OPEN], [(True, False)], OPEN),  # far from the corner the pair stays in its branch
        ((0.1, 0.2), [OPEN, GOOD], [(True, False), (True, True)], GOOD),
        ((0.2, 0.1), [OPEN, None], [(False, True), (True, True)], OPEN),
        ((0.1, 0.3), [OPEN, POOR], [(True, False), (True, True)], OPEN),
        ((0.1, 0.2), [None, POOR], [(True, False), (True, True)], POOR),
        ((0.1, 0.2), [None, None], [(True, False), (True, True)], None),
    ],
)
def test_better_of_branch_and_corner_is_taken(z, answers, fixed, taken, monkeypatch):
    waiting, sets = list(answers), []
    monkeypatch.setattr(
        finishing, "_polished", lambda run, z, warm, zero, _: sets.append((*zero[:, 0],)) or waiting.pop(0)
    )
    assert polished(ScriptedRun(), np.array(z), ended(z), 0.3) is taken
    assert sets == fixed


@pytest.mark.parametrize("z", list(itertools.permutations((0.1, 0.2, 0.25, 4.0))))
def test_only_pairs_near_the_corner_are_put_into_it(z, monkeypatch):
    v, calls = ca.SX.sym("v", 4), []
    run = ScriptedRun(mpcc=MPCC(v, ca.sumsqr(v), None, v[:2], v[2:]))
    monkeypatch.setattr(finishing, "_polished", lambda run, z, warm, zero, ceiling: calls.append(zero))
    assert polished(run, np.array(z), ended(z), 0.3) is None
    G, H = np.array(z[:2]), np.array(z[2:])
    near = (G <= 0.3) & (H <= 0.3)
    np.testing.assert_array_equal(calls, [(G < H, G > H), ((G < H) | near, (G > H) | near)][: 1 + any(near)])


@pytest.mark.parametrize(("ceiling", "is_labelled"), [(2.9, False), (3.0, True), (np.inf, True)])
def test_polished_point_above_the_ceiling_is_not_labelled(ceiling, is_labelled, monkeypatch):
    point, run = Polished(np.array([2.0, 0.0]), 3.0, np.zeros(0), np.array([0.0, 2.0])), ScriptedRun()
    for found, expected in ((point, is_labelled), (None, False)):
        monkeypatch.setattr(finishing, "polish", lambda *_, found=found, **__: found)
        end = finishing._polished(run, point.z, ended(point.z), ON_G, ceiling)
        assert (end is not None) == expected
    assert [step.phase for step in run.steps] == ["polished"] * is_labelled


def test_label_counts_a_program_over_the_branches_unless_s_is_proved():
    """At (2, 0) of two minima nothing is biactive: S; at the corner both slopes descend: C, and an LPEC."""
    good = finishing._labelled(ScriptedRun(), np.array([2.0, 0.0]), 1.0, (np.zeros(0), np.array([0.0, 2.0])))
    assert (good.status, good.stationarity.label, good.lpecs, good.pivots) == (S.CONVERGED, "S", 0, 0)
    bad = finishing._labelled(ScriptedRun(), np.zeros(2), 5.0, None)
    assert (bad.status, bad.stationarity.label, bad.lpecs) == (S.STALLED, "C", 1)
    end = Finish(np.zeros(2), np.nan, S.STALLED)
    assert (end.pivots, end.lpecs, end.stationarity, end.rank) == (0, 0, None, (False, False, -np.inf))


@pytest.mark.parametrize(
    ("mpcc", "f", "is_faithful"),
    [
        *((None, *case) for case in ((4.0, True), (5.0, True), (5.04, True), (5.06, False), (9.0, False))),
        *((MPCC(XY, 0, None, x, y), *case) for case in ((5e-5, True), (1.005e-4, True), (1.02e-4, False))),
    ],
)
def test_polished_point_must_not_be_much_worse_than_the_relaxed_one(mpcc, f, is_faithful):
    """f of two minima is 5 at the origin; a hundredth of the larger value may be lost."""
    assert finishing._faithful(ScriptedRun(mpcc=mpcc), labelled(f), np.zeros(2)) == is_faithful


class TestBranches:
    """What `finish` makes of the ends of its branches; a point is exact if it begins with 2."""

    START = np.array([0.1, 2.0])
    WARM = ended(START)
    GOOD, BAD = ended([2.0, 0.0], f=1.0), ended([0.3, 0.0], S.STALLED)

    @pytest.fixture(autouse=True)
    def _simple(self, monkeypatch):
        self.polished, self.pivots = None, []
        for name, answer in {
            "polish": lambda *_, **__: None,
            "polished": lambda *_: self.polished,
            "pivot": lambda run, here: self.pivots.append(here) or here,
            "_labelled": lambda run, z, f, lam: labelled(f),
        }.items():
            monkeypatch.setattr(finishing, name, answer)

    def finish(self, *results, z=START, search=False, warm=None, ceiling=np.inf, **options):
        self.run = scripted(*results, exact=lambda z: bool(z[0] == 2.0), **options)
        return finish(self.run, np.array(z), search=search, warm=warm, ceiling=ceiling)

    @property
    def warms(self):
        return [call.options.get("warm") for call in self.run.branch_calls]

    def test_newton_s_point_is_taken_if_it_is_faithful_and_stationary(self):
        self.polished = labelled(4.0)
        assert self.finish(self.GOOD, search=True, warm=self.WARM) is self.polished
        assert (self.run.branch_calls, self.pivots) == ([], [self.polished])

    @pytest.mark.parametrize("near", [None, labelled(400.0), labelled(4.0, S.STALLED)])
    def test_else_the_branch_is_solved_without_multipliers(self, near):
        self.polished = near
        end = self.finish(self.GOOD, search=True, warm=self.WARM)
        assert (end.f, end.solved, self.warms) == (1.0, True, [None])
        np.testing.assert_array_equal(self.run.branch_calls[0].zero, ON_G)

    @pytest.mark.parametrize(
        ("results", "warm", "warms"),
        [([GOOD], WARM, [WARM]), ([BAD, GOOD], WARM, [WARM, None]), ([BAD], None, [None])],
    )
    def test_without_newton_the_branch_begins_with_the_multipliers(self, results, warm, warms):
        end = self.finish(*results, warm=warm, newton_finish=False)
        assert (self.warms, end.solved) == (warms, results[-1] is self.GOOD)

    @pytest.mark.parametrize(("z", "on_G"), [((0.1, 2.0), True), ((2.0, 0.1), False), ((1.0, 1.0), True)])
    def test_pairs_are_fixed_on_the_side_of_the_smaller_member(self, z, on_G):
        self.finish(self.GOOD, z=z)
        assert list(self.run.branch_calls[0].zero) == [[on_G], [not on_G]]

    @pytest.mark.parametrize(
        ("result", "ceiling", "status"),
        [
            (ended([2.0, 0.0], S.UNBOUNDED, -1e20), np.inf, S.UNBOUNDED),
            (ended([2.0, 0.0], f=3.0), 2.9, S.WORSE),
            (ended([2.0, 0.0], f=3.0), 3.0, S.CONVERGED),
            (ended([0.3, 0.0], f=1.0), 0.5, S.INACCURATE),  # a point that is not exact is never solved
            (ended([0.3, 0.0], S.STALLED), 0.5, S.STALLED),
            (ended([0.3, 0.0], S.UNBOUNDED), 0.5, S.UNBOUNDED),
        ],
    )
    def test_end_says_why_it_is_none(self, result, ceiling, status):
        end = self.finish(result, ceiling=ceiling)
        assert (end.status, end.f) == (status, result.f)
        assert (end.stationarity is None) == (not end.solved)

    def test_only_a_search_looks_for_another_branch(self, monkeypatch):
        monkeypatch.setattr(finishing, "_other_branch", lambda run, z, zero, result: self.GOOD)
        assert [self.finish(self.BAD, search=search).solved for search in (False, True)] == [False, True]


class TestPivot:
    """A descent over branches, each lower than the one before."""

    @pytest.mark.parametrize(
        ("ends", "stationary_at", "expected"),
        [
            ([3.0, 2.0, 1.0], 1.0, (1.0, 3, 4, S.CONVERGED)),  # f, pivots, lpecs
            ([None], 1.0, (4.0, 0, 1, S.STALLED)),  # no branch is lower
            ([3.0, 2.0, 1.0, 0.0, -1.0], -9.0, (1.0, 3, 4, S.ITERATION_LIMIT)),
            ([-1e20], 1.0, (-1e20, 1, 1, S.UNBOUNDED)),
        ],
    )
    def test_it_ends_where_no_branch_descends_or_at_its_limit(
        self, ends, stationary_at, expected, monkeypatch
    ):
        def label(run, z, f, lam):
            return labelled(f) if f <= stationary_at else labelled(f, S.STALLED, DOWN)

        unbounded = S.UNBOUNDED if ends == [-1e20] else S.CONVERGED
        waiting = [None if f is None else ended([0, 0], unbounded, f) for f in ends]
        monkeypatch.setattr(finishing, "_descend", lambda *_: waiting.pop(0))
        monkeypatch.setattr(finishing, "_labelled", label)
        limit = 3 if stationary_at < 0 else 30
        end = pivot(ScriptedRun(max_pivots=limit), labelled(4.0, S.STALLED, DOWN))
        assert (end.f, end.pivots, end.lpecs, end.status) == expected
        assert (end.stationarity is None) == (unbounded is S.UNBOUNDED)

    def test_inexact_point_is_left_as_it_is(self):
        assert pivot(ScriptedRun(), Finish(np.zeros(2), 1.0, S.STALLED)).status is S.STALLED

    @pytest.mark.parametrize(
        ("ends", "tries"),
        [([(True, 0.9)], 1), ([(False, 0.5), (True, 0.9)], 2), ([(True, 1.5), (True, 1.0), (True, 0.9)], 3),
         ([(True, 1.0 - 1e-9), (True, 1.0), (False, 0.0)], 3)],
    )  # fmt: skip
    def test_lower_point_is_sought_far_away_and_then_within_smaller_radii(self, ends, tries):
        run = scripted(*(ended([float(exact), 0.0], f=f) for exact, f in ends), exact=lambda z: bool(z[0]))
        found = finishing._descend(run, Finish(np.array([3.0, 0.0]), 1.0, S.STALLED), DOWN)
        assert (found is not None and found.f) == (ends[-1][0] and 0.9)
        radii = [call.options["radius"] for call in run.branch_calls]
        assert (len(radii), radii[0]) == (tries, None)
        for radius, reach in zip(radii[1:], (0.1, 1e-3), strict=False):
            np.testing.assert_allclose(radius, [4 * reach, reach])  # relative to 1 + |z|
        assert all(call.zero is ON_H for call in run.branch_calls)

    @pytest.mark.parametrize(("f", "accepted"), [(-99.0 - 5e-8, False), (-99.0 - 2e-7, True)])
    def test_fall_by_rounding_is_none(self, f, accepted):
        here = Finish(np.zeros(2), -99.0, S.STALLED)
        assert (finishing._descend(scripted(ended([0, 0], f=f)), here, DOWN) is not None) == accepted

    def test_wrong_branch_is_left_by_the_descent(self):
        """The finish started on the arm x = 0 of a problem whose corner is not B-stationary crosses it."""
        run = run_of(MPCC(XY, (x - 1) ** 2 + (y + 1) ** 2, None, x, y))
        end = finish(run, np.array([0.0, 0.5]), search=False)
        assert (end.solved, end.pivots, end.z) == (True, 1, pytest.approx([1, 0], abs=1e-8))


@pytest.mark.parametrize(("ceiling", "status"), [(3.0, S.WORSE), (5.0, S.CONVERGED)])
def test_exact_point_above_the_ceiling_is_left(ceiling, status):
    """Next to the minimum 4."""
    end = finish(run_of(two_minima()), np.array([1e-3, 1.0]), search=False, ceiling=ceiling)
    assert end.status is status


def test_feasible_branch_is_found_when_the_sides_are_unclear():
    """x = y - 1e-3: at x = y the sides are a coin toss and one of them is infeasible."""
    run = run_of(MPCC(XY, (x - y) ** 2 + x, y - x - 1e-3, x, y, **EQUATION))
    z = np.array([2e-3, 1e-3])  # fixes y, which is infeasible
    assert not finish(run, z, search=False).solved
    end = finish(run, z, search=True)
    assert (end.solved, end.z) == (True, pytest.approx([0, 1e-3], abs=1e-9))


class TestOtherBranch:
    """A feasible branch near the relaxed point."""

    @pytest.fixture
    def nearest(self, monkeypatch):
        self.near, self.by_signs, radii = Feasibility(np.array([2.0, 0.0]), ON_H, S.CONVERGED), None, []
        monkeypatch.setattr(finishing, "phase_one", lambda run, z, radius: radii.append(radius) or self.near)
        monkeypatch.setattr(finishing, "_follow_signs", lambda *_: self.by_signs)
        return radii

    @staticmethod
    def other(run, *z):
        return finishing._other_branch(run, np.array(z), ON_G, ended([9.0, 9.0], S.INFEASIBLE))

    def test_it_is_solved_from_the_end_of_phase_one_near_the_point(self, nearest):
        result = self.other(scripted(ended([2.0, 0.0])), 0.3, 0.5)
        assert (list(result.x), nearest) == ([2.0, 0.0], pytest.approx([0.6]))
        self.other(scripted(ended([2.0, 0.0])), 0.0, 1.0)  # a point on its branch: units of the corner's size
        assert nearest[1:] == pytest.approx([2e-6])

    def test_feasible_point_is_kept_if_its_branch_is_not_solved(self, nearest):
        result = self.other(scripted(ended([1.0, 1.0]), exact=False), 0.3, 0.5)
        assert list(result.x) == [2.0, 0.0]

    @pytest.mark.parametrize("status", [S.INFEASIBLE, S.STALLED])
    def test_without_a_feasible_point_no_branch_is_solved(self, status, nearest):
        self.near, run = Feasibility(np.array([2.0, 0.0]), ON_H, status), scripted(ended([2.0, 0.0]))
        result = self.other(run, 0.3, 0.5)
        assert (run.branch_calls, list(result.x)) == ([], [9.0, 9.0])

    def test_signs_come_first(self, nearest):
        self.by_signs = ended([2.0, 0.0])
        assert self.other(ScriptedRun(), 0.3, 0.5) is self.by_signs
        assert nearest == []


@pytest.mark.parametrize(
    ("ends", "exact", "on_G", "found"),
    [
        # a pair with a negative member changes sides
        ([[0.0, -0.5], [0.4, 0.0], [2.0, 0.0]], True, [True, False, False], False),
        ([[0.0, -0.5], [-0.6, 0.0], [2.0, 0.0]], True, [True, False], None),  # signs become worse
        ([None, [2.0, 0.0]], True, [True], None),  # a branch fails
        ([[0.0, -0.5], [-0.4, 0.0], [0.0, 0.3], [0, 0.3]], True, [True, False, True, True], True),
        ([[0.0, 0.5], [0.0, 0.5]], False, [True, True], None),  # a branch that is not exact is no end
        ([[0.0, -0.9e-8], [0.0, 0.0]], True, [True, True], True),  # signs within the tolerance are right
        ([[0.0, -1.1e-8], [0.0, 0.0], [0.0, 0.0]], True, [True, False, False], False),
    ],
)
def test_pairs_follow_the_signs_of_their_free_members(ends, exact, on_G, found):
    run = scripted(*(ended([0, -0.5], S.STALLED) if end is None else ended(end) for end in ends), exact=exact)
    answer = finishing._follow_signs(run, np.array([0.1, 0.2]), ON_G)
    assert [call.zero.ravel().tolist() for call in run.branch_calls] == [[side, not side] for side in on_G]
    assert (None if answer is None else bool(run.branch_calls[-1].zero[0, 0])) == found
    signs, done = {"phase": "signs", "free_signs": True}, answer is not None or not exact
    assert [call.options for call in run.branch_calls] == [signs] * (len(on_G) - done) + [{}] * done
    for end, call in zip(ends, run.branch_calls[1:], strict=False):
        assert list(call.z) == end  # each starts at the solution of the one before
