"""The paths of the relaxations: which t follows which, when they retreat, and when they end."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path, follow, second_path
from rmesh_nlp.mpcc.lifting import automatic_derivatives
from rmesh_nlp.optimize.status import Status
from support.scripted_run import START, XY, Answer, ScriptedRun, ended, run_of, two_minima, x, y

S = Status
SOLVED = Finish(np.array([2.0, 0.0]), 1.0, S.CONVERGED)
TENTHS = [10.0**-k for k in range(9)]
HALVES = [10.0 ** (-k / 2) for k in range(17)]


def followed(answers, **options):
    own = {name: options.pop(name) for name in ("first", "patience") if name in options}
    run, path = ScriptedRun(answers, **options), Path()
    follow(run, path, "scholtes", START, 1.0, **own)
    return run, path


def restless(call, product=None):
    """Sides that change from step to step, products that follow t."""
    even = round(np.log10(call.t)) % 2 == 0
    return Answer((1.0, 0.5) if even else (0.5, 1.0), product=call.t if product is None else product)


def settled(objective=1.0, lam_x=(0.0, 0.0), z=(1.0, 0.5)):
    """The branch whose minimum is 1; its objective, and the change as H = 0.5 goes to zero."""
    return lambda call: Answer(z, product=call.t, objective=objective, lam_x=lam_x)


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


def never(z):
    return False


@pytest.mark.parametrize(
    ("answers", "options", "ts", "failure"),
    [
        (restless, {}, TENTHS, None),  # sides that change are not finished early
        (restless, {"exact": lambda z: z[0] == 0.5 or z[1] == 0.0}, TENTHS[:2], None),
        # above the products a relaxation does not act
        (lambda call: Answer(product=0.05 * call.t, objective=1.0), {}, [1.0, 0.01], None),
        # settled sides are finished early from the crossover on; two steps are needed to see that they are
        (settled(), {}, TENTHS[:3], None),
        (settled(), {"crossover": 1.0}, TENTHS[:2], None),
        (settled(), {"newton_finish": False}, TENTHS[:3], None),
        (settled(z=(0.2, 0.1)), {}, TENTHS, None),  # too far from the minimum for Newton's method
        # a minimum above what the path foretells lets it go on
        (settled(1.5), {}, TENTHS[:3], None),
        (settled(0.9995), {}, TENTHS[:3], None),
        (settled(0.998), {}, TENTHS, None),
        (settled(), {"weight": 100.0}, TENTHS[:3], None),
        (settled(2.0, (9.0, -2.0)), {}, TENTHS[:3], None),
        (settled(1.5, (0.0, -2.0)), {}, TENTHS, None),
        # a step that ran long is not repeated from the start, others are; infeasible ones count twice
        (failing_below(S.STALLED, 9), {}, [1.0], S.STALLED),
        (failing_below(S.ITERATION_LIMIT, 1), {}, retreats([1, 0.5, 0.25, 0.125]), S.ITERATION_LIMIT),
        (failing_below(S.ITERATION_LIMIT, 1), {"patience": 0}, TENTHS[:2], S.ITERATION_LIMIT),
        (failing_below(S.STALLED, 1), {"patience": 0}, retreats([1], True), S.STALLED),
        (failing_below(S.INFEASIBLE, 1), {}, retreats([1, 0.5], True), S.INFEASIBLE),
        (STALLED_FAR, {"exact": never}, retreats(range(1, 9), True), None),
        # a failure below the crossover is finished from the point before it
        (LONG, {}, TENTHS[:4], S.ITERATION_LIMIT),
        (lambda call: settled(0.9)(call) if call.t > 0.5e-2 else LONG(call), {}, TENTHS[:4],
         S.ITERATION_LIMIT),
        (LONG, {"patience": 1, "exact": never, "newton_finish": False}, [*TENTHS[:4], HALVES[5]],
         S.ITERATION_LIMIT),
        # products ten times t from t = 0.01 on that do not fall by a tenth: the third in turn is the last
        (stuck(0.95), {}, TENTHS[:5], S.INFEASIBLE),
        (stuck(0.8), {}, TENTHS, None),
    ],
)  # fmt: skip
def test_path_goes_down_retreats_and_ends(answers, options, ts, failure):
    run, path = followed(answers, **options)
    assert run.ts == pytest.approx(ts)
    assert path.failure == failure
    if "exact" not in options:
        assert path.finish.solved
        assert path.finish.f == pytest.approx(options.get("weight", 1.0))


def test_path_without_a_point_has_no_end():
    run, path = followed(lambda _: Answer((np.nan, 1), S.FAILED))
    assert (run.ts, path.failure, path.finish) == ([1.0], S.FAILED, None)


def test_each_step_starts_at_the_one_before():
    run, _ = followed(restless, warm_duals=True)
    assert [list(call.z) for call in run.calls[:4]] == [[0.5, 0.5], [1.0, 0.5], [0.5, 1.0], [1.0, 0.5]]
    assert [call.warm is not None for call in run.calls] == [False] + [True] * 8
    run, _ = followed(STALLED_FAR)
    assert [list(call.z) for call in run.calls[1:4]] == [[1.0, 0.5], [0.5, 0.5], [0.5, 1.0]]


@pytest.mark.parametrize(("larger", "steps"), [(0.29, 3), (0.31, 9)])
def test_corner_of_an_early_finish_is_of_size_sqrt_t(larger, steps):
    """Three times that at t = 0.01; a linear objective has its minimum at the corner alone."""
    answers = settled(0.0, z=(0.2, larger))
    run, path = followed(answers, mpcc=MPCC(XY, x + y, None, x, y))
    assert (len(run.ts), path.finish.solved) == (steps, True)


@pytest.mark.parametrize(("expected", "steps"), [(2.0, 6), (1.95, 6), (1.8, 9)])
def test_branches_are_descended_over_early_only_from_a_good_point_at_small_t(expected, steps):
    """The branch of the path ends at the corner with f = 2, from which f falls to 1 along y."""
    trap = MPCC(XY, (x + 1) ** 2 + (y - 1) ** 2, None, x, y)
    run, path = followed(settled(expected, z=(0.5, 0.1)), mpcc=trap)
    assert (len(run.ts), path.finish.pivots, path.finish.f) == (steps, 1, pytest.approx(1.0))


def test_step_that_fails_retreats_half_of_the_way_and_goes_on_by_smaller_steps():
    """From 1 to 0.1 and from 0.316 to 0.1: the factor becomes its square root."""
    failed = []

    def once(call):
        if call.t > 0.5 or failed:
            return restless(call)
        failed.append(call.t)
        return Answer(status=S.ITERATION_LIMIT)

    run, _ = followed(once, crossover=1e-12, exact=never)
    assert run.ts == pytest.approx([1.0, 0.1, *HALVES[1:]])


def test_t_of_a_solve_is_that_of_its_options():
    result = solve(two_minima(), [0.5, 0.6], t0=0.5, factor=0.2, crossover=1e-12)
    ts = [step.t for step in result.history if step.phase == "relaxed"]
    assert ts == pytest.approx([max(0.5 * 0.2**k, 1e-8) for k in range(len(ts))])
    assert ts[-1] < 2e-8  # the point at the last t may already be exact


class TestSecondPath:
    """The trajectory in the unknowns as they were given; minima (0, 1) with f = 4 and (2, 0) with f = 1."""

    HIGHER = Finish(np.array([0.0, 1.0]), 4.0, S.CONVERGED)

    @staticmethod
    def looked(known, levels=(), answer=None, mpcc=None, **options):
        """The path, what it asked for, by a run that is answered always the same if a test gives it."""
        run, path, asked = run_of(mpcc or two_minima(), **options), Path(), []
        honest = run.unlifted
        run.unlifted = lambda z, t: asked.append((list(z), t)) or (honest(z, t) if answer is None else answer)
        second_path(run, path, START, Path(finish=known, levels=dict(levels)))
        return path, asked

    @pytest.mark.parametrize(
        ("known", "options", "ts"),
        [(HIGHER, {}, TENTHS[:3]), (None, {}, TENTHS[:3]), (None, {"crossover": 0.1}, TENTHS[:2]),
         (Finish(np.zeros(2), 5.0, S.CONVERGED), {}, TENTHS[:3])],  # a corner is no branch
    )  # fmt: skip
    def test_lower_minimum_than_the_first_is_found_at_the_crossover(self, known, options, ts):
        path, asked = self.looked(known, **options)
        assert (path.finish.solved, path.finish.f) == (True, pytest.approx(1.0))
        assert [t for _, t in asked] == pytest.approx(ts)

    @pytest.mark.parametrize(("f", "steps"), [(0.0, 1), (1 + 1e-4, 3), (0.9, 2)])
    def test_it_ends_where_it_cannot_help(self, f, steps):
        """It lies above, or ends in the same branch."""
        path, asked = self.looked(replace(SOLVED, f=f))
        assert path.finish is None
        assert 1 <= len(asked) <= steps

    @pytest.mark.parametrize(
        ("below", "options", "seen"),
        [(1e-6, {}, 1), (-0.01, {}, 3), (1e-6, {"relaxation": "kanzow-schwartz"}, 3)],
    )
    def test_it_joins_the_first_one_where_that_is_as_low_at_the_same_t(self, below, options, seen):
        """Levels of other relaxations are not comparable."""
        probe = run_of(two_minima())
        level = probe.objective(probe.unlifted(START, 1.0).x) - below
        path, asked = self.looked(self.HIGHER, {1.0: level}, **options)
        assert (path.finish is None, len(asked)) == (seen == 1, seen)

    @pytest.mark.parametrize(
        ("status", "point", "steps", "failure"),
        [(S.STALLED, [1.0, 0.5], 3, S.STALLED), (S.FAILED, [1.0, 0.5], 1, S.FAILED),
         (S.STALLED, [np.nan, 1.0], 1, S.STALLED), (S.CONVERGED, [1.0, 0.5], 3, None)],
    )  # fmt: skip
    def test_steps_that_fail_end_it_unless_they_stalled(self, status, point, steps, failure):
        path, asked = self.looked(None, answer=ended(point, status, lam_g=np.zeros(0)))
        expected = [([0.5, 0.5], 1.0), (point, pytest.approx(0.1)), (point, pytest.approx(0.01))]
        assert (asked, path.failure) == (expected[:steps], failure)
        assert (path.finish is None) == (steps == 1)

    @pytest.mark.parametrize(("rise", "status"), [(0.2, S.CONVERGED), (3.0, S.WORSE)])
    def test_its_finish_must_not_lose_what_it_has_gained(self, rise, status):
        """From (2, 1/2), where f is 1 - rise / 4 below the known 4, to (2, 0), where it is 4 + rise."""
        mpcc = MPCC(XY, 4 + rise * (y - 1) ** 2 - x * y + (x - 2) ** 2, None, x, y)
        path, _ = self.looked(self.HIGHER, answer=ended([2.0, 0.5], lam_g=np.zeros(0)), mpcc=mpcc)
        assert path.finish.status is status
        assert path.finish.f == pytest.approx(4 + rise)

    @pytest.mark.parametrize(
        ("mpcc", "options", "looks"),
        [(two_minima(), {}, True), (two_minima(), {"second_path": False}, False),
         (MPCC(XY, x**2 + y**2, None, None, None), {}, False),
         (MPCC(XY, x + y, None, x, y, derivatives=automatic_derivatives(XY, ca.SX(0, 1), x + y, XY)), {},
          False)],
    )  # fmt: skip
    def test_it_is_an_option_and_needs_pairs_and_expressions(self, mpcc, options, looks):
        history = solve(mpcc, START, **options).history
        assert any(step.phase == "second" for step in history) == looks
