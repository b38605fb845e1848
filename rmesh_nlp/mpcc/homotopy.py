"""The homotopy: relaxations with t going down, and the exact finish as soon as the sides are clear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import Finish, finish
from rmesh_nlp.mpcc.programs import BoolArray, Programs
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.nlp import NLPResult, Status

_MAX_RETREATS = 3
_UNSETTLED = 0.01  # share of the pairs that may still change sides: the finish puts them right
_BELOW = 0.1
_GAP = 0.05  # an early finish further than this (relative) above the relaxed objective is not yet final


@dataclass(eq=False)
class Path:
    """One homotopy as far as it has come, also if a limit stops it.

    Attributes
    ----------
    finish : Finish or None
        The best so far.
    relaxed : NLPResult or None
        The last relaxed solution, or the failed one if there is none.
    failure : Status or None
        Why the last step failed, if it did.
    """

    finish: Finish | None = None
    relaxed: NLPResult | None = None
    failure: Status | None = None


def follow(
    run: Run, path: Path, relaxation: str, z0: Array, t0: float, first: NLPResult | None = None
) -> None:
    """Follow the relaxed solutions from ``t0`` to ``t_final``, finish exactly, keep all in ``path``.

    A step that fails is retried cold (from ``z0``); if that fails too, t retreats half of the way (in
    its logarithm) and goes down by a smaller factor from there. ``first`` holds multipliers of the lifted
    program for the first step.
    """
    options = run.programs.options
    t, factor, retreats = t0, options.factor, 0
    last: NLPResult | None = None
    sides: BoolArray | None = None
    while True:
        result = _step(run, relaxation, z0, last, t, first)
        if result.converged:
            last, path.relaxed, path.failure = result, result, None
            product = run.steps[-1].product
            before, sides = sides, _sides(run.programs, result.x)
            settled = before is not None and t <= options.crossover and _settled(before, sides)
            final = run.exact(result.x) or t <= options.t_final
            if settled or final:
                path.finish = _better(path.finish, _finish(run, relaxation, result, t, search=final))
                if final or (path.finish.solved and _close(result.f, path.finish.f)):
                    return
            # where the products are already smaller than t the relaxation does not act: go below them
            t = max(min(factor * t, _BELOW * product), options.t_final)
        else:
            path.relaxed, path.failure = last or result, result.status
            retreats += 1
            if last is None or retreats > _MAX_RETREATS:
                break
            factor = np.sqrt(factor)
            t = t / factor
    if last is not None and path.finish is None:
        path.finish = finish(run, last.x, search=True)


def _finish(run: Run, relaxation: str, result: NLPResult, t: float, *, search: bool) -> Finish:
    """The exact finish from a relaxed solution, with its multipliers if so wished."""
    warm = (
        run.programs.without_relaxation(relaxation, result, t) if run.programs.options.warm_finish else None
    )
    return finish(run, result.x, search=search, warm=warm)


def _step(
    run: Run, relaxation: str, z0: Array, last: NLPResult | None, t: float, first: NLPResult | None
) -> NLPResult:
    """Solve the relaxation at ``t`` from the last solution, and from the start if that fails."""
    if last is None:
        return run.relaxed(
            relaxation, z0, t, None if first is None else run.programs.padded(relaxation, first)
        )
    result = run.relaxed(relaxation, last.x, t, last if run.programs.options.warm_duals else None)
    if not result.converged:
        cold = run.relaxed(relaxation, z0, t)
        return cold if cold.converged else result
    return result


def _close(relaxed: float, finished: float) -> bool:
    """The relaxed objective is locally a lower bound: far above it a lower t may show a better branch."""
    return finished - relaxed <= _GAP * max(abs(finished), abs(relaxed))


def _settled(before: BoolArray, sides: BoolArray) -> bool:
    return bool(np.count_nonzero(before != sides) <= _UNSETTLED * sides.size)


def _sides(programs: Programs, z: Array) -> BoolArray:
    return z[programs.lifted.first] <= z[programs.lifted.second]


def _better(a: Finish | None, b: Finish) -> Finish:
    return b if a is None or b.rank > a.rank else a
