"""The paths of the relaxations: which t follows which, when they retreat, and when they end."""

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, homotopy, solve
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path, follow, second_path
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import START, XY, Answer, ScriptedRun, ended, run_of, two_minima, x, y

S = Status
SOLVED, UNSOLVED = (Finish(np.array([2.0, 0.0]), 1.0, status) for status in (S.CONVERGED, S.STALLED))
TENTHS = [10.0**-k for k in range(9)]
HALVES = [10.0 ** (-k / 2) for k in range(17)]


class Finishes:
    """Stands for the exact finish: notes how it was called, and ends as the test says."""

    def __init__(self, monkeypatch):
        self.calls = []
        self.full, self.near, self.pivoted = UNSOLVED, None, SOLVED
        for name, answer in (("finish", "full"), ("polished", "near"), ("pivot", "pivoted")):
            monkeypatch.setattr(homotopy, name, self._standing_for(name, answer))

    def _standing_for(self, name, answer):
        def stand(run, z, *rest, **options):
            if name == "polished":
                options = dict(zip(("warm", "corner"), rest, strict=True))
            self.calls.append((name, {"z": z, "t": run.ts[-1], **options}))
            return getattr(self, answer)

        return stand

    def of(self, kind):
        return [call for name, call in self.calls if name == kind]

    @property
    def searches(self):
        return [call["search"] for call in self.of("finish")]


@pytest.fixture
def finishes(monkeypatch):
    return Finishes(monkeypatch)


def followed(answers, **options):
    own = {name: options.pop(name) for name in ("first", "patience") if name in options}
    run, path = ScriptedRun(answers, exact=options.pop("exact", lambda z: False), **options), Path()
    follow(run, path, "scholtes", START, 1.0, **own)
    return run, path


def restless(call, product=None):
    """Sides that change from step to step, products that follow t."""
    even = round(np.log10(call.t)) % 2 == 0
    return Answer((1.0, 0.5) if even else (0.5, 1.0), product=call.t if product is None else product)


def settled(objective=1.0, lam_x=(0.0, 0.0)):
    return lambda call: Answer((1.0, 0.5), product=call.t, objective=objective, lam_x=lam_x)


def failing(status, bad):
    return lambda call: Answer(status=status) if bad(call) else restless(call)


def failing_below(status, t):
    return failing(status, lambda call: call.t < t)


def stuck(fall):
    return lambda call: restless(call, fall ** round(-np.log10(call.t)))


LONG = failing_below(S.ITERATION_LIMIT, 0.5e-2)
STALLED_FAR = failing(S.STALLED, lambda call: call.t < 1 and not np.array_equal(call.z, START))


def retreats(powers, twice=False):
    return [1.0, *(0.1**power for power in powers for _ in range(1 + twice))]


@pytest.mark.parametrize(
    ("answers", "options", "ends", "ts", "searches", "failure", "end"),
    [
        (restless, {}, {}, TENTHS, [True], None, UNSOLVED),  # sides that change are not finished early
        (restless, {"exact": lambda z: z[0] == 0.5}, {}, TENTHS[:2], [True], None, UNSOLVED),
        # settled sides are finished early from the crossover on; two steps are needed to see that they are
        (settled(), {}, {"near": SOLVED}, TENTHS[:3], [], None, SOLVED),
        (settled(), {"crossover": 1e-3}, {"near": SOLVED}, TENTHS[:4], [], None, SOLVED),
        (settled(), {"crossover": 1.0}, {"near": SOLVED}, TENTHS[:2], [], None, SOLVED),
        # an early finish that proves nothing lets the path go on
        (settled(), {}, {"near": None, "pivoted": None, "full": SOLVED}, TENTHS, [True], None, SOLVED),
        (settled(), {}, {"near": UNSOLVED, "pivoted": UNSOLVED, "full": SOLVED}, TENTHS, [True], None,
         SOLVED),
        # and so does one with f = 1 above what the path foretells, but the better of the two is kept
        (settled(1.5), {}, {"near": SOLVED}, TENTHS[:3], [], None, SOLVED),
        (settled(0.9), {}, {"near": SOLVED}, TENTHS, [True], None, SOLVED),
        (settled(0.01), {"weight": 100.0}, {"near": SOLVED}, TENTHS[:3], [], None, SOLVED),
        # H = 0.5 is to be closed with the multiplier -2
        (settled(2.0, (9.0, -2.0)), {}, {"near": SOLVED}, TENTHS[:3], [], None, SOLVED),
        (settled(1.5, (0.0, -2.0)), {}, {"near": SOLVED}, TENTHS, [True], None, SOLVED),
        # without Newton an early finish is that by the interior point, without a search
        (settled(), {"newton_finish": False}, {"full": SOLVED}, TENTHS[:3], [False], None, SOLVED),
        # a first step that fails ends the path; its point is finished without a search if it is one
        (failing_below(S.STALLED, 9), {}, {}, [1.0], [False], S.STALLED, UNSOLVED),
        (lambda _: Answer((np.nan, 1), S.FAILED), {}, {}, [1.0], [], S.FAILED, None),
        # a step that ran long is not repeated from the start, others are; infeasible ones count twice
        (failing_below(S.ITERATION_LIMIT, 1), {}, {}, retreats([1, 0.5, 0.25, 0.125]), [True],
         S.ITERATION_LIMIT, UNSOLVED),
        (failing_below(S.ITERATION_LIMIT, 1), {"patience": 0}, {}, TENTHS[:2], [True], S.ITERATION_LIMIT,
         UNSOLVED),
        (failing_below(S.STALLED, 1), {"patience": 0}, {}, retreats([1], True), [True], S.STALLED, UNSOLVED),
        (failing_below(S.INFEASIBLE, 1), {}, {}, retreats([1, 0.5], True), [True], S.INFEASIBLE, UNSOLVED),
        (STALLED_FAR, {}, {}, retreats(range(1, 9), True), [True], None, UNSOLVED),
        # a failure below the crossover is finished from the point before it
        (LONG, {}, {"full": SOLVED}, TENTHS[:4], [False], S.ITERATION_LIMIT, SOLVED),
        (LONG, {"patience": 1}, {}, [*TENTHS[:4], HALVES[5]], [False] * 2, S.ITERATION_LIMIT, UNSOLVED),
        # products ten times t from t = 0.01 on that do not fall by a tenth: the third in turn is the last
        (stuck(1.0), {}, {}, TENTHS[:5], [True], S.INFEASIBLE, UNSOLVED),
        (stuck(0.95), {}, {}, TENTHS[:5], [True], S.INFEASIBLE, UNSOLVED),
        (stuck(0.8), {}, {}, TENTHS, [True], None, UNSOLVED),
    ],
)  # fmt: skip
def test_path_goes_down_retreats_and_ends(answers, options, ends, ts, searches, failure, end, finishes):
    vars(finishes).update(ends)
    run, path = followed(answers, **options)
    assert run.ts == pytest.approx(ts)
    assert (finishes.searches, path.failure, path.finish) == (searches, failure, end)


def test_each_step_starts_at_the_one_before_and_a_finish_knows_t_and_multipliers(finishes):
    run, _ = followed(restless)
    (last,) = finishes.of("finish")
    assert (last["corner"], last["warm"] is None) == (pytest.approx(3e-4), False)
    assert finishes.of("polished") == []
    assert [list(call.z) for call in run.calls[:4]] == [[0.5, 0.5], [1.0, 0.5], [0.5, 1.0], [1.0, 0.5]]
    assert [call.first for call in run.calls] == [True] + [False] * 8
    assert not any(call.warm for call in run.calls)
    assert {call.name for call in run.calls} == {"scholtes"}
    run, _ = followed(restless, warm_duals=True)
    assert [call.warm is not None for call in run.calls] == [False] + [True] * 8
    run, _ = followed(STALLED_FAR)
    assert [call.first for call in run.calls[1:4]] == [False, True, False]
    assert [list(call.z) for call in run.calls[1:4]] == [[1.0, 0.5], [0.5, 0.5], [0.5, 1.0]]


@pytest.mark.parametrize(("crossover", "corner"), [(1e-2, 0.3), (1e-3, 3 * 10**-1.5), (1.0, 3 * 10**-0.5)])
def test_corner_of_an_early_finish_is_of_size_sqrt_t(crossover, corner, finishes):
    finishes.near = SOLVED
    followed(settled(), crossover=crossover)
    assert finishes.of("polished")[0]["corner"] == pytest.approx(corner)


@pytest.mark.parametrize(("f", "descends"), [(1.0, True), (1.04, True), (1.2, False)])
def test_branches_are_descended_over_from_a_good_point_at_small_t_only(f, descends, finishes):
    finishes.near = finishes.pivoted = replace(UNSOLVED, f=f)
    followed(settled())
    assert [call["t"] for call in finishes.of("pivot")] == pytest.approx(TENTHS[5:8] if descends else [])


def test_step_that_fails_retreats_half_of_the_way_and_goes_on_by_smaller_steps(finishes):
    """From 1 to 0.1 and from 0.316 to 0.1: the factor becomes its square root."""
    failed = []

    def once(call):
        if call.t < 0.5 and len(failed) < 2:  # from the last solution, and from the start
            failed.append(call.t)
            return Answer(status=S.STALLED)
        return Answer((1.0, 0.5) if len(failed) % 2 else (0.5, 1.0), product=call.t)

    run, path = followed(once, crossover=1e-12)
    assert run.ts == pytest.approx([1.0, 0.1, *HALVES[2:3], *HALVES[1:]])
    assert path.failure is None


def test_points_of_failed_paths_are_finished_from_the_last_relaxed_solution(finishes):
    _, path = followed(failing_below(S.STALLED, 1), patience=0)
    np.testing.assert_array_equal(finishes.of("finish")[0]["z"], path.relaxed.x)
    assert path.relaxed.converged
    assert not followed(failing_below(S.STALLED, 9))[1].relaxed.converged
    followed(LONG, patience=0)
    call = finishes.of("finish")[-1]
    assert (call["corner"], list(call["z"])) == (pytest.approx(0.3), [1.0, 0.5])  # of t = 0.01
    finishes.near = SOLVED  # stationary, but above what the path foretells: it will do if the path fails
    late = lambda call: settled(0.9)(call) if call.t > 0.5e-2 else Answer(status=S.ITERATION_LIMIT)  # noqa: E731
    run, path = followed(late)
    assert (run.ts, path.finish) == (pytest.approx(TENTHS[:4]), SOLVED)


def test_known_multipliers_start_the_first_step_with_zeros_for_the_relaxation_s_own_rows(finishes):
    known = ended([0.5, 0.5], lam_x=np.array([1.0, 2.0]), lam_g=np.zeros(0))
    first, second = followed(restless, first=known)[0].calls[:2]
    assert (list(first.warm.lam_x), list(first.warm.lam_g)) == ([1.0, 2.0], [0.0])
    assert (first.first, second.warm) == (True, None)


def exact(f, status=S.STALLED):
    return Finish(np.zeros(2), f, status, Stationarity("W"))


INEXACT, UNBOUNDED = (Finish(np.zeros(2), *end) for end in ((-9.0, S.STALLED), (-1e20, S.UNBOUNDED)))


@pytest.mark.parametrize(
    ("better", "worse"),
    [(SOLVED, exact(0.0)), (exact(5.0), INEXACT), (exact(1.0), exact(2.0)), (exact(1.0), exact(np.nan))],
)
def test_of_two_ends_the_solved_then_the_exact_then_the_lower_is_kept(better, worse):
    for one, other in ((worse, better), (better, worse)):
        path = Path(one)
        assert path.keep(other) == other.solved
        assert path.finish is better
    path = Path(better)
    path.keep(replace(better))
    assert path.finish is better  # of equals the first


@pytest.mark.parametrize(
    ("end", "ended"), [(SOLVED, True), (UNBOUNDED, True), (UNSOLVED, False), (None, False)]
)
def test_path_ends_with_a_stationary_point_or_without_a_bound(end, ended):
    assert Path(finish=end).ended == ended


@pytest.mark.parametrize(
    ("finished", "expected", "within"),
    [(1.0, 1.0, True), (1.0009, 1.0, True), (1.002, 1.0, False), (-5.0, 1.0, True), (-1.002, -1.0, True),
     (-1.0, -1.002, False), (-1.0, -1.0009, True), (5e-7, 0.0, True), (2e-6, 0.0, False)],
)  # fmt: skip
def test_end_is_where_the_path_was_going_to_a_thousandth_or_lower(finished, expected, within):
    assert homotopy._at_the_limit(finished, expected, 1e-3) == within


@pytest.mark.parametrize(("changes", "is_settled"), [(0, True), (2, True), (3, False)])
def test_sides_are_settled_if_one_in_a_hundred_changes(changes, is_settled):
    assert homotopy._settled(np.zeros(200, dtype=bool), np.arange(200) < changes) == is_settled


@pytest.mark.parametrize(
    ("t", "product", "following"), [(1.0, 0.9, 0.1), (1.0, 0.05, 0.01), (1.0, 0.0, 1e-8), (1e-7, 0.0, 1e-8)]
)
def test_t_follows_its_sequence_and_leaves_out_what_does_not_act(t, product, following):
    assert homotopy._next(t, 0.1, product, 1e-8) == pytest.approx(following)


def test_t_of_a_solve_is_that_of_its_options():
    result = solve(two_minima(), [0.5, 0.6], t0=0.5, factor=0.2, crossover=1e-12)
    ts = [step.t for step in result.history if step.phase == "relaxed"]
    assert ts == pytest.approx([max(0.5 * 0.2**k, 1e-8) for k in range(len(ts))])
    assert ts[-1] < 2e-8  # the point at the last t may already be exact


class TestSecondPath:
    """The trajectory in the unknowns as they were given; minima (0, 1) with f = 4 and (2, 0) with f = 1."""

    @pytest.fixture
    def scripted(self, monkeypatch):
        """Follow it with relaxed points that a test gives; the run's asks, and what is finished how."""

        def look(end, known=None):
            run, path, asks, ends = ScriptedRun(), Path(), [], []
            monkeypatch.setattr(run, "unlifted", lambda x, t: asks.append((list(x), t)) or end)
            monkeypatch.setattr(homotopy, "finish", lambda run, z, **names: ends.append(names) or UNSOLVED)
            second_path(run, path, START, Path(finish=known))
            return path, asks, ends

        return look

    @staticmethod
    def looked(first, levels=(), **options):
        run, path = run_of(two_minima(), **options), Path()
        second_path(run, path, START, Path(finish=first, levels=dict(levels)))
        return path.finish, [step.t for step in run.steps if step.phase == "second"]

    @pytest.mark.parametrize(
        ("known", "options", "ts"),
        [(Finish(np.array([0.0, 1.0]), 4.0, S.CONVERGED), {}, TENTHS[:3]), (None, {}, TENTHS[:3]),
         (None, {"crossover": 0.1}, TENTHS[:2])],
    )  # fmt: skip
    def test_lower_minimum_than_the_first_is_found_at_the_crossover(self, known, options, ts):
        end, seen = self.looked(known, **options)
        assert (end.solved, end.f, seen) == (True, pytest.approx(1.0), pytest.approx(ts))

    @pytest.mark.parametrize(("f", "steps"), [(0.0, 1), (1 + 1e-4, 3), (0.9, 2)])
    def test_it_ends_where_it_cannot_help(self, f, steps):
        """It lies above, or ends in the same branch."""
        end, seen = self.looked(Finish(np.array([2.0, 0.0]), f, S.CONVERGED))
        assert end is None
        assert 1 <= len(seen) <= steps

    @pytest.mark.parametrize(
        ("below", "options", "seen"),
        [(1e-6, {}, 1), (-0.01, {}, 3), (1e-6, {"relaxation": "kanzow-schwartz"}, 3)],
    )
    def test_it_joins_the_first_one_where_that_is_as_low_at_the_same_t(self, below, options, seen):
        """Levels of other relaxations are not comparable."""
        probe = run_of(two_minima())
        level = probe.objective(probe.unlifted(START, 1.0).x) - below
        end, ts = self.looked(Finish(np.array([0.0, 1.0]), 4.0, S.CONVERGED), {1.0: level}, **options)
        assert (end is None, len(ts)) == (seen == 1, seen)

    @pytest.mark.parametrize(
        ("z", "known", "same"), [((0, 1), (0, 2), True), ((1, 0), (0, 2), False), ((0, 1), (0, 0), False)]
    )
    def test_known_corner_is_no_branch(self, z, known, same):
        assert homotopy._same_branch(ScriptedRun(), np.array(z), np.array(known)) is same

    @pytest.mark.parametrize(
        ("status", "point", "asked", "failure", "finished"),
        [(S.STALLED, [1.0, 0.5], 3, S.STALLED, 1), (S.FAILED, [1.0, 0.5], 1, S.FAILED, 0),
         (S.STALLED, [np.nan, 1.0], 1, S.STALLED, 0), (S.CONVERGED, [1.0, 0.5], 3, None, 1)],
    )  # fmt: skip
    def test_steps_that_fail_end_it_unless_they_stalled(
        self, status, point, asked, failure, finished, scripted
    ):
        path, asks, ends = scripted(ended(point, status))
        expected = [([0.5, 0.5], 1.0), (point, pytest.approx(0.1)), (point, pytest.approx(0.01))]
        assert (asks, path.failure, len(ends)) == (expected[:asked], failure, finished)
        assert all(end["search"] and end["corner"] == pytest.approx(0.3) for end in ends)

    def test_its_finish_must_not_lose_what_it_has_gained(self, scripted):
        """Known: f = 4 on the other branch; the relaxed point (2, 0.1) has f = 0.81."""
        _, _, ends = scripted(ended([2.0, 0.1]), Finish(np.array([0.0, 1.0]), 4.0, S.CONVERGED))
        assert (ends[0]["search"], ends[0]["ceiling"]) == (False, pytest.approx(8 - 0.81))

    @pytest.mark.parametrize(
        ("mpcc", "options", "looks"),
        [(two_minima(), {}, True), (two_minima(), {"second_path": False}, False),
         (MPCC(XY, x**2 + y**2, None, None, None), {}, False)],
    )  # fmt: skip
    def test_it_is_an_option_and_needs_pairs(self, mpcc, options, looks):
        history = solve(mpcc, START, **options).history
        assert any(step.phase == "second" for step in history) == looks


@pytest.mark.slow
def test_penalty_that_ends_at_a_violation_is_not_followed_to_the_end():
    """Both members at least 0.2: empty for every t below 0.04, not for t = 1."""
    empty = MPCC(XY, (x - 1) ** 2 + y**2, XY, x, y, lbg=0.2)
    run, path = run_of(empty), Path()
    follow(run, path, "l1-penalty", START, 1.0)
    assert path.failure is S.INFEASIBLE
    assert min(step.t for step in run.steps if step.phase == "relaxed") > 1e-8
    result = solve(empty, START)
    assert (result.status, result.success) == (S.INFEASIBLE, False)
    assert result.counts["nlp_solves"] <= 25
    assert result.counts["rescues"] > 0  # another relaxation was asked all the same
    follow(run_of(two_minima()), path := Path(), "l1-penalty", START, 1.0)
    assert path.finish.solved
