"""What a solve makes of its paths: which end is taken, under which status, and with which figures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, MPCCSolver, Options, solve
from rmesh_nlp.mpcc import solver as solving
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path
from rmesh_nlp.mpcc.result import Step, excess, residuals
from rmesh_nlp.mpcc.solver import _choose, _end, _failure
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status
from support.scripted_run import ScriptedRun, ended, two_minima

HERE = np.array([2.0, 0.0])
LABELLED = Stationarity("W")


def end_of(f: float, status: Status = Status.CONVERGED, label: Stationarity | None = LABELLED) -> Path:
    return Path(finish=Finish(HERE, f, status, label))


INEXACT = Path(finish=Finish(HERE, -9.0, Status.INACCURATE))
UNBOUNDED = Path(finish=Finish(HERE, -1e20, Status.UNBOUNDED))


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (end_of(1.0), end_of(1.1)),
        (end_of(-1.1), end_of(-1.0)),
        (end_of(1.0), UNBOUNDED),  # a minimum is an answer, that there is none further down is not
        (end_of(1.0), end_of(0.0, Status.STALLED)),
        (UNBOUNDED, end_of(0.0, Status.STALLED)),
        (UNBOUNDED, INEXACT),
        (end_of(5.0, Status.STALLED), INEXACT),
        (end_of(0.0, Status.STALLED), end_of(1.0, Status.STALLED)),
    ],
)
def test_the_better_end_is_chosen_in_either_order(better: Path, worse: Path) -> None:
    assert _choose([better, worse]) is better.finish
    assert _choose([worse, better]) is better.finish
    assert _choose([Path(), worse, Path(), better]) is better.finish


@pytest.mark.parametrize("f", [0.0, 1.0, -1000.0])
def test_of_ends_that_differ_by_rounding_the_earlier_is_chosen(f: float) -> None:
    first, second = end_of(f), end_of(f - 0.5e-7 * (1 + abs(f)))
    assert _choose([first, second]) is first.finish
    lower = end_of(f - 2e-7 * (1 + abs(f)))
    assert _choose([first, lower]) is lower.finish
    assert _choose([Path(), Path()]) is None
    assert _choose([]) is None


class TestEnd:
    """The point and the status that are returned."""

    START = np.array([0.5, 0.5])

    def end(
        self, *paths: Path, limit: Status | None = None, run: ScriptedRun | None = None, **names: Any
    ) -> Any:
        return _end(run or ScriptedRun(**names), list(paths), self.START, limit)

    def test_a_stationary_end_keeps_its_status_if_it_is_exact(self) -> None:
        found = self.end(end_of(1.0), limit=Status.TIME_LIMIT)
        assert (found.status, found.f) == (Status.CONVERGED, 1.0)
        assert self.end(end_of(1.0, Status.ACCEPTABLE)).status is Status.ACCEPTABLE
        assert self.end(end_of(1.0), exact=lambda z: False).status is Status.INACCURATE

    def test_an_exact_end_that_is_not_stationary_has_its_own_status_or_that_of_a_limit(self) -> None:
        stalled = end_of(1.0, Status.STALLED)
        found = self.end(stalled)
        assert (found.status, found.f, found.stationarity) == (Status.STALLED, 1.0, LABELLED)
        assert self.end(stalled, limit=Status.TIME_LIMIT).status is Status.TIME_LIMIT

    def test_else_the_point_with_the_smallest_residuals_is_returned(self) -> None:
        run = ScriptedRun()
        run.nearest = (HERE, 1.0, 5.0)
        found = self.end(Path(), limit=Status.ITERATION_LIMIT, run=run)
        assert (found.z is HERE, found.stationarity, found.status) == (True, None, Status.ITERATION_LIMIT)
        found = self.end(Path(failure=Status.INFEASIBLE), run=run)
        assert (found.z is HERE, found.status) == (True, Status.INFEASIBLE)
        assert self.end(Path(failure=Status.STALLED)).z is self.START  # before any NLP has ended

    @pytest.mark.parametrize(
        ("point", "unbounded"),
        [([2e15, 0.0], True), ([0.0, -2e15], True), ([1e8, 1e7], False), ([np.nan, 2e15], False)],
    )
    def test_iterates_beyond_all_measure_are_called_unbounded(
        self, point: list[float], unbounded: bool
    ) -> None:
        """The program has an objective without a bound."""
        for path in (Path(relaxed=ended(point), failure=Status.ITERATION_LIMIT),
                     Path(finish=Finish(np.array(point), 0.0, Status.ITERATION_LIMIT))):  # fmt: skip
            found = self.end(path, run=ScriptedRun(mpcc=MPCC(ca.vertcat(x, y), x + y, None, x, y)))
            assert (found.status is Status.UNBOUNDED) == unbounded
            assert (list(found.z) == point) == unbounded

    def test_an_objective_beyond_all_measure_is_called_unbounded(self) -> None:
        steep = MPCC(ca.vertcat(x, y), -1e10 * x, None, x, y)
        found = self.end(Path(relaxed=ended([1e6, 0.0])), run=ScriptedRun(mpcc=steep))
        assert found.status is Status.UNBOUNDED
        found = self.end(Path(relaxed=ended([1e4, 0.0])), run=ScriptedRun(mpcc=steep))
        assert found.status is not Status.UNBOUNDED


x, y = ca.SX.sym("x"), ca.SX.sym("y")
S = Status


@pytest.mark.parametrize(
    ("failures", "finishes", "excess_of_nearest", "said"),
    [
        ([S.STALLED], [], 1.0, S.STALLED),
        ([S.INFEASIBLE, S.TIME_LIMIT], [], 1.0, S.TIME_LIMIT),
        ([S.INFEASIBLE], [], 0.5, S.STALLED),
        ([], [], 0.5, S.STALLED),
        ([S.INFEASIBLE, S.FAILED], [], 2.0, S.INFEASIBLE),
        ([S.STALLED], [S.INACCURATE], 2.0, S.INFEASIBLE),
        ([S.STALLED, S.ITERATION_LIMIT], [S.INACCURATE], 2.0, S.ITERATION_LIMIT),
        ([S.STALLED], [S.EVALUATION_ERROR], 2.0, S.EVALUATION_ERROR),
        ([], [], 2.0, S.FAILED),
    ],
)
def test_why_no_exact_point_was_found(
    failures: list[Status], finishes: list[Status], excess_of_nearest: float, said: Status
) -> None:
    paths = [Path(failure=status) for status in failures]
    paths += [Path(finish=Finish(HERE, 0.0, status)) for status in finishes]
    assert _failure(paths, excess_of_nearest) is said


def test_multipliers_of_rows_pairs_and_bounds_are_in_their_places_and_units() -> None:
    """min (x-2)^2 + (y-1)^2 + (w+1)^2, rows x + w <= 1.5 and w >= -3, w >= -1/2, 0 <= x _|_ 2 y >= 0.

    At (2, 0, -1/2): the row holds with equality and needs no multiplier, the bound of w has -1, and the
    pair's member 2 y has 2 (0 - 1) + 2 nu = 0. A weight of the objective must not be seen.
    """
    v = ca.SX.sym("v", 3)
    for size in (1.0, 1e-4):
        f = size * ((v[0] - 2) ** 2 + (v[1] - 1) ** 2 + (v[2] + 1) ** 2)
        rows = ca.vertcat(v[0] + v[2], v[2])
        mpcc = MPCC(v, f, rows, v[0], 2 * v[1], ubg=[1.5, np.inf], lbg=[-np.inf, -3], lbx=[-9, -9, -0.5])
        result = solve(mpcc, [1.9, 0.1, 0.0])
        assert result.success
        assert result.x == pytest.approx([2, 0, -0.5], abs=1e-6)
        assert result.lam_x / size == pytest.approx([0, 0, -1], abs=1e-4)
        assert result.lam_g / size == pytest.approx([0, 0], abs=1e-4)
        assert result.lam_G / size == pytest.approx([0], abs=1e-4)
        assert result.lam_H / size == pytest.approx([1], abs=1e-4)
        assert (result.G[0], result.H[0]) == pytest.approx((2, 0), abs=1e-6)


def test_without_a_label_there_are_no_multipliers() -> None:
    infeasible = solve(
        MPCC(ca.vertcat(x, y), x + y, ca.vertcat(x, y), x, y, lbg=0.5), [1.0, 1.0], t0=1e-4, rescues=()
    )
    assert not infeasible.success
    assert infeasible.stationarity == ""
    assert infeasible.b_stationary is None
    for values in (infeasible.lam_x, infeasible.lam_g, infeasible.lam_G, infeasible.lam_H):
        assert values.size
        assert np.all(np.isnan(values))
    assert (infeasible.counts["pivots"], infeasible.counts["lpecs"], infeasible.n_biactive) == (0, 0, 0)


def test_seconds_are_those_of_the_steps_by_phase() -> None:
    result = solve(two_minima(), [0.5, 0.6])
    by_phase: dict[str, float] = {"homotopy": 0.0, "finish": 0.0}
    for step in result.history:
        by_phase["homotopy" if step.phase in ("relaxed", "second") else "finish"] += step.seconds
    assert by_phase["homotopy"] > 0
    assert {name: result.seconds[name] for name in by_phase} == pytest.approx(by_phase)
    assert sum(by_phase.values()) < result.seconds["total"] < 60
    assert 0 < result.seconds["build"] < result.seconds["total"]
    assert result.counts["ipopt_iterations"] == sum(step.iterations for step in result.history)
    kept = MPCCSolver(two_minima())
    first, again = kept([0.5, 0.6]), kept([0.5, 0.6])
    assert again.seconds["build"] <= first.seconds["build"]
    assert again.seconds["build"] < 1e-6  # nothing is built twice
    assert 0 < again.seconds["total"] < 60


class TestAttempts:
    """The homotopy asked for, then the rescues, until one ends."""

    @pytest.fixture
    def attempts(self, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
        calls: list[tuple[Any, ...]] = []
        self.ends: dict[str, Path] = {}
        self.looks = 0

        def follow(run: Any, path: Path, name: str, z0: Any, t0: float, first: Any, *, patience: int) -> None:
            calls.append((name, t0, run.nlps.dependent, patience))
            known = self.ends.get(name, Path(failure=Status.STALLED))
            path.finish, path.failure = known.finish, known.failure

        def second_path(run: Any, path: Path, x0: Any, first: Any) -> None:
            self.looks += 1

        monkeypatch.setattr(solving, "follow", follow)
        monkeypatch.setattr(solving, "second_path", second_path)
        return calls

    def solved(self, **options: Any) -> Any:
        return solve(two_minima(), [0.5, 0.6], **options)

    def test_each_is_tried_once_and_rescues_reckon_with_dependent_equations(self, attempts: Any) -> None:
        rescues = (("l1-penalty", 1.0), ("scholtes", 1.0), ("scholtes", 1e-3))
        result = self.solved(rescues=rescues)
        assert attempts == [
            ("scholtes", 1.0, False, solving.RETREATS),
            ("l1-penalty", 1.0, True, solving.RETREATS),
            ("scholtes", 1e-3, True, solving.RETREATS),
        ]
        assert result.counts["rescues"] == 2
        assert self.looks == 1  # of the first path alone

    def test_a_relaxation_that_was_empty_is_not_tried_from_a_smaller_t(self, attempts: Any) -> None:
        self.ends["scholtes"] = Path(failure=Status.INFEASIBLE)
        self.solved(rescues=(("scholtes", 1e-3), ("l1-penalty", 1.0)), second_path=False)
        assert attempts == [("scholtes", 1.0, False, solving.RETREATS), ("l1-penalty", 1.0, True, 0)]

    def test_a_stationary_end_needs_no_rescue(self, attempts: Any) -> None:
        self.ends["scholtes"] = end_of(1.0)
        result = self.solved()
        assert len(attempts) == 1
        assert (result.status, result.counts["rescues"]) == (Status.CONVERGED, 0)

    def test_the_second_trajectory_is_not_asked_where_there_is_no_bound(self, attempts: Any) -> None:
        self.ends["scholtes"] = UNBOUNDED
        assert self.solved().status is Status.UNBOUNDED
        assert (len(attempts), self.looks) == (1, 0)
        self.ends["scholtes"] = end_of(1.0)
        self.solved()
        assert self.looks == 1
        self.solved(second_path=False)
        assert self.looks == 1

    def test_the_second_trajectory_needs_as_much_time_as_is_spent(
        self, attempts: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(solving.Run, "seconds_left", property(lambda run: 1e-6))
        self.solved()
        assert self.looks == 0

    def test_known_multipliers_are_tried_at_once_and_an_end_is_the_answer(
        self, attempts: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        known = solve(two_minima(), [2.0, 0.0])
        attempts.clear()
        again = MPCCSolver(two_minima())([2.0, 0.0], start=known if known.success else None)
        assert again is not None
        monkeypatch.setattr(solving, "polished", lambda *_: end_of(1.0).finish)
        duals = replace(known, lam_x=np.zeros(2), lam_G=np.zeros(1), lam_H=np.zeros(1))
        attempts.clear()
        result = MPCCSolver(two_minima())([2.0, 0.0], start=duals)
        assert (attempts, result.status) == ([], Status.CONVERGED)
        monkeypatch.setattr(solving, "polished", lambda *_: None)
        MPCCSolver(two_minima(), Options(rescues=()))([2.0, 0.0], start=duals)
        assert [name for name, *_ in attempts] == ["scholtes"]


class TestResiduals:
    """By hand."""

    MPCC3 = MPCC(ca.vertcat(x, y), x, x + y, ca.vertcat(x, y), ca.vertcat(y, x), lbx=-1, ubx=4, lbg=0, ubg=1)

    def test_the_largest_violation_of_any_bound_or_sign(self) -> None:
        def violation(
            point: tuple[float, float], g: float, G: tuple[float, ...], H: tuple[float, ...]
        ) -> float:
            parts = (np.array(v, float) for v in (point, [g], G, H))
            return residuals(self.MPCC3, *parts).constraint_violation

        ones = (1.0, 1.0)
        assert violation(ones, 0.5, ones, ones) == 0
        assert violation((1.0, -1.5), 0.5, ones, ones) == 0.5
        assert violation((5.0, 1.0), 0.5, ones, ones) == 1.0
        assert violation(ones, 1.25, ones, ones) == 0.25
        assert violation(ones, -0.25, ones, ones) == 0.25
        assert violation(ones, 0.5, (1.0, -2.0), (1.0, -3.0)) == 3.0
        assert violation(ones, np.nan, ones, ones) == np.inf

    def test_complementarity_and_product(self) -> None:
        parts = (np.array(v, float) for v in ((1, 1), (0.5,), (0.1, -3.0), (4.0, 0.2)))
        found = residuals(self.MPCC3, *parts)
        assert found.complementarity == pytest.approx(0.2)
        assert found.product == pytest.approx(0.6)
        empty = np.zeros(0)
        none = residuals(MPCC(x, x, None, None, None), np.zeros(1), empty, empty, empty)
        assert (none.constraint_violation, none.complementarity, none.product) == (0, 0, 0)
        assert excess(empty, 0.0, 1.0) == 0.0

    def test_words_of_a_label(self) -> None:
        result = solve(MPCC(ca.vertcat(x, y), x + 2 * y, None, x, y), [0.3, 0.4])
        assert result.label == "S (1 biactive pair, B-stationary)"
        two = replace(result, biactive=np.array([0, 1]), b_stationary=False, stationarity="W")
        assert two.label == "W (2 biactive pairs, not B-stationary)"
        assert replace(two, b_stationary=None, stationarity="").label == (
            "no label (2 biactive pairs, B not computed)"
        )
        none = replace(result, biactive=np.zeros(0, dtype=np.int64))
        assert none.label == "S (no biactive pair: a KKT point)"
        assert replace(none, stationarity="W").label == "W (0 biactive pairs, B-stationary)"

    def test_a_step_by_itself_has_no_pairs_at_the_corner_and_no_multiplier(self) -> None:
        measured = {"objective": 1.0, "constraint_violation": 0.0, "complementarity": 0.0, "product": 0.0}
        step = Step(phase="branch", t=0.0, **measured, iterations=3, status=Status.CONVERGED, seconds=0.1)
        assert (step.biactive, step.multiplier) == (0, 0.0)


def test_an_nlp_result_is_converged_by_its_word() -> None:
    words = {status for status in Status if replace(ended([0, 0]), status=status).converged}
    assert words == {Status.CONVERGED, Status.ACCEPTABLE}
    assert isinstance(ended([0, 0]), NLPResult)
