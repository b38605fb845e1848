"""The homotopy: relaxations with t going down, and the exact finish as soon as the sides are clear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import Finish, exact, finish
from rmesh_nlp.mpcc.programs import BoolArray, Log, Programs
from rmesh_nlp.optimize.nlp import NLPResult, Status

_MAX_RETREATS = 3
_UNSETTLED = 0.01  # share of the pairs that may still change sides: the finish puts them right
_BELOW = 0.1
_GAP = 0.05  # an early finish further than this (relative) above the relaxed objective is not yet final


@dataclass(frozen=True, eq=False)
class Path:
    """End of one homotopy: the best finish, the last relaxed result, why the last step failed if it did."""

    finish: Finish | None
    relaxed: NLPResult
    failure: Status | None


def follow(programs: Programs, relaxation: str, z0: Array, p: Array, t0: float, log: Log) -> Path:
    """Follow the relaxed solutions from ``t0`` to ``t_final`` and finish exactly.

    A step that fails is retried cold (from ``z0``); if that fails too, t retreats half of the way (in
    its logarithm) and goes down by a smaller factor from there.
    """
    options = programs.options
    t, factor, retreats = t0, options.factor, 0
    last: NLPResult | None = None
    sides: BoolArray | None = None
    best: Finish | None = None
    failure: Status | None = None
    while True:
        result = _step(programs, relaxation, log, z0, last, p, t)
        if result.converged:
            last, failure = result, None
            product = log.steps[-1].product
            before, sides = sides, _sides(programs, result.x)
            settled = before is not None and t <= options.crossover and _settled(before, sides)
            complementary = exact(programs, result.x, p)
            final = complementary or t <= options.t_final
            if settled or final:
                best = _better(best, finish(programs, result.x, p, log, search=final))
                if final or (best.solved and _close(result.f, best.f)):
                    break
            # where the products are already smaller than t the relaxation does not act: go below them
            t = max(min(factor * t, _BELOW * product), options.t_final)
        else:
            failure = result.status
            retreats += 1
            if last is None or retreats > _MAX_RETREATS:
                break
            factor = np.sqrt(factor)
            t = t / factor
    if last is not None and best is None:
        best = finish(programs, last.x, p, log, search=True)
    return Path(best, last or result, failure)


def _step(
    programs: Programs, relaxation: str, log: Log, z0: Array, last: NLPResult | None, p: Array, t: float
) -> NLPResult:
    """Solve the relaxation at ``t`` from the last solution, and from the start if that fails."""
    warm = last if programs.options.warm_duals else None
    result = programs.relaxed(relaxation, z0 if last is None else last.x, p, t, warm)
    log.add("relaxed", t, result)
    if not result.converged and last is not None:
        cold = programs.relaxed(relaxation, z0, p, t)
        log.add("relaxed", t, cold)
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
