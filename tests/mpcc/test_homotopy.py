"""The paths of the relaxations: which t follows which, when they retreat, and when they end."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, Options, homotopy, solve
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path, follow, second_path
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.stationarity import Stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import Answer, ScriptedRun, ended, two_minima

START = np.array([0.5, 0.5])
SOLVED = Finish(np.array([2.0, 0.0]), 1.0, Status.CONVERGED)
UNSOLVED = Finish(np.array([2.0, 0.0]), 1.0, Status.STALLED)
TENTHS = [10.0**-k for k in range(9)]
x, y = ca.SX.sym("x"), ca.SX.sym("y")
XY = ca.vertcat(x, y)


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


def restless(call):
    """Sides that change from step to step, products that follow t."""
    even = round(np.log10(call.t)) % 2 == 0
    return Answer((1.0, 0.5) if even else (0.5, 1.0), product=call.t)


def settled(objective=1.0, lam_x=(0.0, 0.0)):
    return lambda call: Answer((1.0, 0.5), product=call.t, objective=objective, lam_x=lam_x)


def failing(status, bad):
    return lambda call: Answer(status=status) if bad(call.t) else restless(call)


def test_t_goes_down_to_the_end_and_the_last_point_is_finished_with_a_search(finishes):
    run, path = followed(restless)
    assert run.ts == pytest.approx(TENTHS)
    (last,) = finishes.of("finish")
    assert (last["search"], last["corner"]) == (True, pytest.approx(3e-4))
    assert last["warm"] is not None
    assert finishes.of("polished") == []  # sides that change are not finished early
    assert (path.finish, path.failure) == (UNSOLVED, None)
    assert [list(call.z) for call in run.calls[:4]] == [[0.5, 0.5], [1.0, 0.5], [0.5, 1.0], [1.0, 0.5]]
    assert [call.first for call in run.calls] == [True] + [False] * 8
    assert not any(call.warm for call in run.calls)


def test_warm_duals_hand_the_multipliers_on(finishes):
    run, _ = followed(restless, warm_duals=True)
    assert [call.warm is not None for call in run.calls] == [False] + [True] * 8


def test_exact_relaxed_point_is_the_end_of_the_path(finishes):
    run, _ = followed(restless, exact=lambda z: z[0] == 0.5)
    assert run.ts == pytest.approx([1.0, 0.1])
    assert finishes.searches == [True]


@pytest.mark.parametrize(("crossover", "steps"), [(1e-2, 3), (1e-3, 4), (1.0, 2)])
def test_settled_sides_are_finished_early_from_the_crossover_on(crossover, steps, finishes):
    """Two steps are needed to see that nothing changes."""
    finishes.near = SOLVED
    run, path = followed(settled(), crossover=crossover)
    assert run.ts == pytest.approx(TENTHS[:steps])
    assert finishes.of("polished")[0]["corner"] == pytest.approx(3 * 10 ** (-(steps - 1) / 2))
    assert path.finish is SOLVED


@pytest.mark.parametrize("near", [None, UNSOLVED])
def test_early_finish_that_proves_nothing_lets_the_path_go_on(near, finishes):
    finishes.near = finishes.pivoted = near
    finishes.full = SOLVED
    run, path = followed(settled())
    assert run.ts == pytest.approx(TENTHS)
    assert path.finish is SOLVED


@pytest.mark.parametrize(
    ("answers", "weight", "ends"),
    [
        (settled(1.0), 1.0, True),
        (settled(1.5), 1.0, True),
        (settled(0.9), 1.0, False),  # the finish, f = 1, is above what the path foretells
        (settled(0.01), 100.0, True),  # weighted as that of a finish
        (settled(2.0, (9.0, -2.0)), 1.0, True),  # H = 0.5 is to be closed with the multiplier -2
        (settled(1.5, (0.0, -2.0)), 1.0, False),
    ],
)
def test_early_finish_above_what_the_path_foretells_is_not_yet_final(answers, weight, ends, finishes):
    finishes.near = SOLVED
    run, path = followed(answers, weight=weight)
    assert (len(run.ts) == 3) == ends
    assert path.finish is SOLVED  # the better of the two


@pytest.mark.parametrize(("f", "descends"), [(1.0, True), (1.04, True), (1.2, False)])
def test_branches_are_descended_over_from_a_good_point_at_small_t_only(f, descends, finishes):
    finishes.near = finishes.pivoted = Finish(np.array([2.0, 0.0]), f, Status.STALLED)
    followed(settled())
    ts = [call["t"] for call in finishes.of("pivot")]
    assert ts == pytest.approx(TENTHS[5:8] if descends else [])


def test_without_newton_an_early_finish_is_that_by_the_interior_point_without_a_search(finishes):
    finishes.full = SOLVED
    run, path = followed(settled(), newton_finish=False)
    assert run.ts == pytest.approx([1.0, 0.1, 0.01])
    assert finishes.searches == [False]
    assert finishes.of("finish")[0]["warm"] is not None
    assert path.finish is SOLVED


def test_step_that_fails_retreats_half_of_the_way_and_goes_on_by_smaller_steps(finishes):
    """From 1 to 0.1 and from 0.316 to 0.1: the factor becomes its square root."""
    failed = []

    def once(call):
        if call.t < 0.5 and len(failed) < 2:  # from the last solution, and from the start
            failed.append(call.t)
            return Answer(status=Status.STALLED)
        return Answer((1.0, 0.5) if len(failed) % 2 else (0.5, 1.0), product=call.t)

    run, path = followed(once, crossover=1e-12)
    half = 10**-0.5
    assert run.ts[:6] == pytest.approx([1.0, 0.1, 0.1, half, 0.1, 0.1 * half])
    assert run.ts[-1] == pytest.approx(1e-8)
    assert path.failure is None
    assert (list(run.calls[2].z), run.calls[2].first) == ([0.5, 0.5], True)


@pytest.mark.parametrize(
    ("status", "patience", "powers", "twice"),
    [
        (Status.ITERATION_LIMIT, 3, [1, 0.5, 0.25, 0.125], False),  # one that ran long is not repeated
        (Status.ITERATION_LIMIT, 0, [1], False),
        (Status.STALLED, 0, [1], True),  # others are tried from the start
        (Status.INFEASIBLE, 3, [1, 0.5], True),  # and count twice
    ],
)
def test_retreats_are_counted(status, patience, powers, twice, finishes):
    run, path = followed(failing(status, lambda t: t < 1.0), patience=patience)
    assert run.ts[1:] == pytest.approx([0.1**power for power in powers for _ in range(1 + twice)])
    assert path.failure is status
    assert path.relaxed.converged
    (call,) = finishes.of("finish")  # what there is, with a search
    assert call["search"] is True
    np.testing.assert_array_equal(call["z"], path.relaxed.x)


def test_step_that_succeeds_from_the_start_is_taken(finishes):
    def far(call):
        return (
            restless(call) if call.t == 1 or np.array_equal(call.z, START) else Answer(status=Status.STALLED)
        )

    run, path = followed(far)
    assert run.ts == pytest.approx([1.0, *(t for t in TENTHS[1:] for _ in "ab")])
    assert path.failure is None


def test_first_step_that_fails_ends_the_path_and_its_point_is_finished_without_a_search(finishes):
    run, path = followed(failing(Status.STALLED, lambda t: True))
    assert (run.ts, path.failure, path.relaxed.status) == ([1.0], Status.STALLED, Status.STALLED)
    assert finishes.searches == [False]
    _, path = followed(lambda call: Answer((np.nan, 1.0), Status.EVALUATION_ERROR))
    assert (len(finishes.searches), path.finish) == (1, None)


def test_failure_below_the_crossover_is_finished_from_the_point_before_it(finishes):
    finishes.full = SOLVED
    run, path = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5e-2))
    assert run.ts == pytest.approx([1.0, 0.1, 0.01, 1e-3])
    (call,) = finishes.of("finish")
    assert (call["search"], call["corner"]) == (False, pytest.approx(0.3))  # of the last t that was solved
    assert list(call["z"]) == [1.0, 0.5]
    assert path.finish is SOLVED
    above, _ = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5), patience=0)
    assert above.ts == pytest.approx([1.0, 0.1])
    assert finishes.searches[1:] == [True]  # only when retreats are used up
    finishes.full = UNSOLVED
    run, path = followed(failing(Status.ITERATION_LIMIT, lambda t: t < 0.5e-2), patience=1)
    assert run.ts[4:] == pytest.approx([1e-3 * 10**0.5])
    assert finishes.searches[2:] == [False, False]
    assert path.finish is UNSOLVED


@pytest.mark.parametrize(("fall", "ends"), [(1.0, True), (0.95, True), (0.8, False)])
def test_products_that_do_not_fall_end_at_a_violation(fall, ends, finishes):
    """They count from t = 0.01 on, where they are ten times t, and the third in turn is the last."""

    def stuck(call):
        k = round(-np.log10(call.t))
        return Answer((1.0, 0.5) if k % 2 else (0.5, 1.0), product=fall**k)

    run, path = followed(stuck)
    assert (path.failure is Status.INFEASIBLE) == ends
    assert run.ts == pytest.approx(TENTHS[:5] if ends else TENTHS)
    assert finishes.searches == [True]


def test_known_multipliers_start_the_first_step_with_zeros_for_the_relaxation_s_own_rows(finishes):
    known = ended([0.5, 0.5], lam_x=np.array([1.0, 2.0]), lam_g=np.zeros(0))
    run, _ = followed(restless, first=known)
    assert run.calls[0].first
    assert (list(run.calls[0].warm.lam_x), list(run.calls[0].warm.lam_g)) == ([1.0, 2.0], [0.0])
    assert run.calls[1].warm is None


def exact(f, status=Status.STALLED):
    return Finish(np.zeros(2), f, status, Stationarity("W"))


def test_of_two_ends_the_solved_then_the_exact_then_the_lower_is_kept():
    inexact = Finish(np.zeros(2), -9.0, Status.STALLED)
    for better, worse in (
        (SOLVED, exact(0.0)), (exact(5.0), inexact), (exact(1.0), exact(2.0)), (exact(1.0), exact(np.nan)),
    ):  # fmt: skip
        for one, other in ((worse, better), (better, worse)):
            path = Path(one)
            assert path.keep(other) == other.solved
            assert path.finish is better
    twin, path = exact(1.0), Path()
    path.keep(twin)
    path.keep(exact(1.0))
    assert path.finish is twin


def test_path_ends_with_a_stationary_point_or_without_a_bound():
    unbounded = Finish(np.zeros(2), -1e20, Status.UNBOUNDED)
    ends = [Path(finish=end).ended for end in (SOLVED, unbounded, UNSOLVED, None)]
    assert ends == [True, True, False, False]


@pytest.mark.parametrize(
    ("finished", "expected", "within"),
    [(1.0, 1.0, True), (1.0009, 1.0, True), (1.002, 1.0, False), (-5.0, 1.0, True), (-1.002, -1.0, True),
     (-1.0, -1.002, False), (-1.0, -1.0009, True), (5e-7, 0.0, True), (2e-6, 0.0, False)],
)  # fmt: skip
def test_end_is_where_the_path_was_going_to_a_thousandth_or_lower(finished, expected, within):
    assert homotopy._at_the_limit(finished, expected, 1e-3) == within


def test_sides_are_settled_if_one_in_a_hundred_changes():
    before = np.zeros(200, dtype=bool)
    for changes, is_settled in ((0, True), (2, True), (3, False)):
        assert homotopy._settled(before, np.arange(200) < changes) == is_settled


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

    @staticmethod
    def looked(first, **options):
        run, path = Run(CompiledNLPs(two_minima(), Options(**options)), np.zeros(0)), Path()
        second_path(run, path, START, first)
        return run, path

    def test_a_lower_minimum_than_the_first_is_found(self):
        run, path = self.looked(Finish(np.array([0.0, 1.0]), 4.0, Status.CONVERGED))
        assert (path.finish.solved, path.finish.f) == (True, pytest.approx(1.0))
        ts = [step.t for step in run.steps if step.phase == "second"]
        assert ts == pytest.approx([1.0, 0.1, 0.01])  # to the crossover, no further
        run, path = self.looked(None, crossover=0.1)
        assert [step.t for step in run.steps if step.phase == "second"] == pytest.approx([1.0, 0.1])
        assert path.finish.f == pytest.approx(1.0)

    @pytest.mark.parametrize(
        ("known", "f", "steps"),
        [([2, 0], 0.0, 1), ([2, 0], 1 + 1e-4, 3), ([2, 0], 0.9, 2)],  # it lies above; ends in the same branch
    )
    def test_it_ends_where_it_cannot_help(self, known, f, steps):
        run, path = self.looked(Finish(np.array(known, float), f, Status.CONVERGED))
        assert path.finish is None
        assert [step.phase for step in run.steps][:1] == ["second"]
        assert len(run.steps) <= steps

    @pytest.mark.parametrize(
        ("z", "known", "same"), [((0, 1), (0, 2), True), ((1, 0), (0, 2), False), ((0, 1), (0, 0), False)]
    )
    def test_a_known_corner_is_no_branch(self, z, known, same):
        assert homotopy._same_branch(ScriptedRun(), np.array(z), np.array(known)) is same

    @pytest.mark.parametrize(
        ("status", "point", "asked", "failure", "finished"),
        [(Status.STALLED, [1.0, 0.5], 3, Status.STALLED, 1), (Status.FAILED, [1.0, 0.5], 1, Status.FAILED, 0),
         (Status.STALLED, [np.nan, 1.0], 1, Status.STALLED, 0), (Status.CONVERGED, [1.0, 0.5], 3, None, 1)],
    )  # fmt: skip
    def test_steps_that_fail_end_it_unless_they_stalled(
        self, status, point, asked, failure, finished, monkeypatch
    ):
        run, path, ends = ScriptedRun(), Path(), []
        asks = []
        monkeypatch.setattr(run, "unlifted", lambda x, t: asks.append((list(x), t)) or ended(point, status))
        monkeypatch.setattr(homotopy, "finish", lambda run, z, **names: ends.append(names) or UNSOLVED)
        second_path(run, path, START, None)
        assert len(asks) == asked
        assert asks[0] == ([0.5, 0.5], 1.0)
        assert all(ask == (point, pytest.approx(10.0**-k)) for k, ask in enumerate(asks) if k)
        assert path.failure is failure
        assert len(ends) == finished
        assert all(end["search"] and end["corner"] == pytest.approx(0.3) for end in ends)

    def test_its_finish_must_not_lose_what_it_has_gained(self, monkeypatch):
        """Known: f = 4 on the other branch; the relaxed point (2, 0.1) has f = 0.81."""
        ends = []
        run = ScriptedRun()
        monkeypatch.setattr(run, "unlifted", lambda x, t: ended([2.0, 0.1]))
        monkeypatch.setattr(homotopy, "finish", lambda run, z, **names: ends.append(names) or UNSOLVED)
        second_path(run, Path(), START, Finish(np.array([0.0, 1.0]), 4.0, Status.CONVERGED))
        assert (ends[0]["search"], ends[0]["ceiling"]) == (False, pytest.approx(8 - 0.81))

    def test_it_is_an_option_and_needs_pairs(self):
        def phases(mpcc=None, **options):
            return {step.phase for step in solve(mpcc or two_minima(), [0.5, 0.5], **options).history}

        assert "second" in phases()
        assert "second" not in phases(second_path=False)
        assert "second" not in phases(MPCC(XY, x**2 + y**2, None, None, None))


@pytest.mark.slow
def test_penalty_that_ends_at_a_violation_is_not_followed_to_the_end():
    """Both members at least 0.2: empty for every t below 0.04, not for t = 1."""
    empty = MPCC(XY, (x - 1) ** 2 + y**2, XY, x, y, lbg=0.2)
    run, path = Run(CompiledNLPs(empty, Options()), np.zeros(0)), Path()
    follow(run, path, "l1-penalty", START, 1.0)
    assert path.failure is Status.INFEASIBLE
    assert min(step.t for step in run.steps if step.phase == "relaxed") > 1e-8
    result = solve(empty, START)
    assert (result.status, result.success) == (Status.INFEASIBLE, False)
    assert result.counts["nlp_solves"] <= 25
    assert result.counts["rescues"] > 0  # another relaxation was asked all the same
    run, path = Run(CompiledNLPs(two_minima(), Options()), np.zeros(0)), Path()
    follow(run, path, "l1-penalty", START, 1.0)
    assert path.finish.solved
