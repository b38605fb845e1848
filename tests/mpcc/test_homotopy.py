"""The paths of the relaxations: which t follows which, and when they end."""

import numpy as np
import pytest

from rmesh_nlp.mpcc import homotopy as module
from rmesh_nlp.mpcc import solve
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.optimize.status import Status
from support.scripted_run import START, Answer, ScriptedRun, two_minima

S = Status
TENTHS = [10.0**-k for k in range(9)]


def followed(answers, **options):
    run, path = ScriptedRun(answers, **options), Path()
    follow(run, path, START)
    return run, path


def restless(call, product=None):
    """Sides that change from step to step, products that follow t."""
    z = (1.0, 0.5) if round(np.log10(call.t)) % 2 == 0 else (0.5, 1.0)
    return Answer(z, product=call.t if product is None else product, objective=-call.t)


def settled(objective=1.0, z=(1.0, 0.5), cost=1e-3):
    """The branch whose minimum is 1, what the path foretells, and what the pairs cost at the first t."""
    return lambda call: Answer(z, product=call.t, objective=objective, cost=cost)


def failing(status, bad):
    return lambda call: Answer(status=status) if bad(call) else restless(call)


def failing_below(status, t):
    return failing(status, lambda call: call.t < t)


@pytest.mark.parametrize(
    ("answers", "options", "ts", "failure"),
    [
        (restless, {}, TENTHS, None),  # sides that change are not finished early
        (restless, {"exact": lambda z: z[0] == 0.5 or z[1] == 0.0}, TENTHS[:2], None),
        # above the products a relaxation does not act
        (lambda call: Answer(product=0.05 * call.t, objective=1 - 0.1 * call.t), {}, [1.0, 0.01], None),
        # settled sides are finished early from the crossover on; two steps are needed to see that they are
        (settled(), {}, TENTHS[:3], None),
        (settled(), {"crossover": 1.0}, TENTHS[:2], None),
        # a minimum above what the path foretells lets it go on
        (settled(1.5), {}, TENTHS[:3], None),
        (settled(0.9995), {}, TENTHS[:3], None),
        (settled(0.998), {}, TENTHS, None),
        (settled(), {"weight": 100.0}, TENTHS[:3], None),
        # Newton steps follow at once where the pairs cost nothing
        (settled(z=(2.0, 0.5), cost=0.9e-6), {}, [1.0], None),
        (settled(z=(2.0, 0.5), cost=1.1e-6), {}, TENTHS[:3], None),
        # a step that fails twice is the last; the finish begins at the one before
        (failing_below(S.STALLED, 9), {}, [1.0], S.STALLED),
        (failing_below(S.ITERATION_LIMIT, 1), {}, [1.0, 0.1, 0.1], S.ITERATION_LIMIT),
        (failing_below(S.INFEASIBLE, 0.5e-2), {}, TENTHS[:4], S.INFEASIBLE),
        # an exact point that was already there is kept
        (lambda call: settled(0.9)(call) if call.t > 0.5e-2 else Answer(status=S.STALLED), {},
         [*TENTHS[:4], 1e-3], S.STALLED),
    ],
)  # fmt: skip
def test_path_goes_down_and_ends(answers, options, ts, failure):
    run, path = followed(answers, **options)
    assert run.ts == pytest.approx(ts)
    assert path.failure == failure
    if "exact" not in options:
        assert path.finish.solved
        assert path.finish.f == pytest.approx(options.get("weight", 1.0))


@pytest.mark.parametrize(
    ("at_the_end", "ts"),
    [
        ({"objective": 1.0}, [1.0, TENTHS[-1]]),
        ({"status": S.ITERATION_LIMIT}, [1.0, TENTHS[-1], TENTHS[1]]),
        ({"x": (0.0, 1.0)}, [1.0, TENTHS[-1], TENTHS[1]]),  # f = 4: another minimum
    ],
)
def test_last_t_is_the_next_where_newton_steps_fail_and_pairs_cost_nothing(at_the_end, ts, monkeypatch):
    monkeypatch.setattr(module, "resolved", lambda *_: None)

    def answer(call):
        return Answer(**{"x": (2.0, 0.0)} | at_the_end) if call.is_leap else settled(cost=0.0)(call)

    run, path = followed(answer)
    assert run.ts[: len(ts)] == pytest.approx(ts)
    assert len(run.ts) > 2 or ts == pytest.approx(run.ts)
    assert path.finish.f == pytest.approx(1.0)


@pytest.mark.parametrize(("again", "kept"), [(0.9, 0.9), (2.0, 1.5), (None, 1.5)])
def test_step_that_leaves_the_path_is_done_once_more_from_the_multipliers(again, kept):
    """From 1 f may rise by three times 1e-3 and a hundredth; a second end counts if it is lower."""

    def answer(call):
        if call.t != 0.1:
            return restless(call)
        if call.warm is None:
            return Answer((1.0, 0.5), objective=1.5, product=0.1)
        return Answer(objective=again, product=0.1) if again else Answer(status=S.STALLED)

    run, path = followed(lambda call: settled()(call) if call.t == 1.0 else answer(call))
    assert run.ts[:4] == pytest.approx([1.0, 0.1, 0.1, 0.01])
    assert [call.warm is not None for call in run.calls[:4]] == [False, False, True, False]
    assert path.levels[0.1] == kept
    run, _ = followed(lambda call: settled(1.0 + 0.012 * (call.t == 0.1))(call))
    assert run.ts == pytest.approx(TENTHS[:3])


@pytest.mark.parametrize(
    ("x", "above", "ts", "level"),
    [
        ((16.0, 0.5), 6.0, [1.0, 80.0, 8.0, 1.0, 0.1], 6.2),  # 20 is no end of a path from 6
        ((16.0, 0.5), 19.0, [1.0, 80.0, 8.0, 0.1], 20.0),
        ((8.0, 0.5), 6.0, [1.0, 0.1], 20.0),  # products of 4 are not large for t = 1
    ],
)
def test_first_t_is_reached_from_above_where_it_is_small_for_the_members(x, above, ts, level):
    ends = iter([Answer(x, objective=20.0, cost=0.1, product=1.0), *[Answer(x, objective=above)] * 2,
                 Answer(x, objective=6.2, product=1.0)])  # fmt: skip
    run, path = followed(lambda call: next(ends) if call.t >= 1 else Answer(status=S.INFEASIBLE))
    assert (run.ts, path.levels[1.0]) == (pytest.approx(ts), level)


def test_limit_of_an_nlp_ends_no_path():
    """Each relaxation stops after two iterations, feasible and not settled."""
    result = solve(two_minima(), [0.5, 0.6], ipopt_relaxed={"max_iter": 2})
    assert (result.success, result.counts["rescues"]) == (True, 0)
    assert {step.status for step in result.history if step.phase == "relaxed"} >= {S.ITERATION_LIMIT}


def test_without_a_point_a_path_has_no_end_else_a_step_starts_at_the_one_before():
    run, path = followed(lambda _: Answer((np.nan, 1), S.FAILED))
    assert (run.ts, path.failure, path.finish) == ([1.0], S.FAILED, None)
    run, _ = followed(restless, warm_duals=True)
    assert [list(call.z) for call in run.calls[:4]] == [[0.5, 0.5], [1.0, 0.5], [0.5, 1.0], [1.0, 0.5]]
    assert [call.warm is not None for call in run.calls] == [False] + [True] * 8


def test_t_of_a_solve_is_that_of_its_options():
    result = solve(two_minima(), [0.5, 0.6], t0=0.5, factor=0.2, crossover=1e-12)
    ts = [step.t for step in result.history if step.phase == "relaxed"]
    assert ts == pytest.approx([max(0.5 * 0.2**k, 1e-8) for k in range(len(ts))])
    assert ts[-1] < 2e-8  # the point at the last t may already be exact
