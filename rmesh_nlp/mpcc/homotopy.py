"""The homotopy: relaxations with t going down, and the exact finish as soon as the sides are clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Mask, is_finite
from rmesh_nlp.mpcc.finish import Finish, finish, proved
from rmesh_nlp.mpcc.result import is_same
from rmesh_nlp.mpcc.run import Run, Warm
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

_UNSETTLED = 0.01  # share of the pairs that may still change sides: the finish puts them right
_GAP, _GAP_FLOOR = 1e-3, 1e-6  # an early finish further above the expected objective is not yet final
_FREE = 1e-6  # relative change of the objective in which pairs cost nothing


@dataclass(eq=False)
class Path:
    """One homotopy as far as it has come, also if a limit stops it.

    ``finish`` is the best so far, ``relaxed`` the last relaxed solution, or the failed one if there is none,
    and ``failure`` says why the last step failed, if it did. ``levels`` are the weighted objectives of the
    relaxed solutions, by t. ``joined`` is the number of the former trajectory that this one came upon.
    """

    finish: Finish | None = None
    relaxed: NLPResult | None = None
    failure: Status | None = None
    levels: dict[float, float] = field(default_factory=dict)
    joined: int | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing more is to be tried: stationary, unbounded, or one with a former trajectory."""
        end = self.finish
        return self.joined is not None or (end is not None and (end.solved or end.status is Status.UNBOUNDED))

    def keep(self, end: Finish) -> bool:
        """Take an end if it is better than the one there is; whether it is stationary."""
        if self.finish is None or end.rank > self.finish.rank:
            self.finish = end
        return end.solved


def ran_out(paths: Sequence[Path]) -> bool:
    """Whether a limit, an error or a missing bound ended one of the paths, and not a violation."""
    ends = {path.finish.status for path in paths if path.finish is not None}
    over = {Status.UNBOUNDED, Status.ITERATION_LIMIT, Status.EVALUATION_ERROR}
    return bool(over & {*ends, *(path.failure for path in paths)})


def follow(
    run: Run,
    path: Path,
    z0: Array,
    first: Warm = None,
    former: Sequence[Mapping[float, float]] = (),
    dependent: bool = False,
) -> None:
    """Follow the relaxed solutions from t0 to t_final, finish exactly, keep all in ``path``.

    Where the pairs cost nothing at t0, to first order, they hold nothing up, and the next step is the
    last. Where a step fails, the finish begins at the one before. ``first`` are multipliers for the
    first step, ``former`` the levels of trajectories that this one may join; ``dependent``
    relaxations reckon with equations that follow from each other.
    """
    options = run.options
    t, t_final = options.t0, options.t_final
    z, warm, lam, is_first = z0, first, None, True
    sides: Mask | None = None
    while True:
        result = run.relaxed(z, t, warm, first=is_first, dependent=dependent)
        if not result.converged:
            path.relaxed, path.failure = path.relaxed or result, result.status
            break
        path.relaxed, product, objective = result, run.steps[-1].product, run.steps[-1].objective * run.p[-1]
        path.levels[t] = objective
        matches = (k for k, levels in enumerate(former) if is_same(objective, levels.get(t, np.inf)))
        path.joined = next(matches, None)
        if path.joined is not None:
            return
        if t == options.t0 and run.cost(result, t) <= _FREE * abs(objective):
            last = run.relaxed(result.x, t_final, (result.lam_x, result.lam_g), last=True)
            if last.converged and _at_the_limit(run.objective(last.x), objective):
                path.relaxed = result = last
                t = t_final
        before, sides = sides, run.lifted.smaller(result.x)
        lam = result.lam_x, result.lam_g
        if run.exact(result.x) or t <= t_final:
            break
        is_settled = before is not None and _settled(before, sides)
        if is_settled and t <= options.crossover * (1 + ROUNDING):
            near = proved(run, run.branch(result.x, sides, warm=lam))
            if near.solved and path.keep(near) and _at_the_limit(near.f, objective):
                return
        z, is_first, warm = result.x, False, lam if options.warm_duals else None
        t = _next(t, options.factor, product, t_final)
    z = path.relaxed.x
    if is_finite(z) and (path.finish is None or path.failure is None):
        path.keep(finish(run, z, search=lam is not None, warm=lam))


def _next(t: float, factor: float, product: float, t_final: float) -> float:
    """The next t of the sequence that acts: above the largest product the relaxation changes nothing.

    The sequence itself is kept. Going on from the product instead lost good minima (family sliding-modes).
    """
    t = factor * t
    while t > product and t > t_final:
        t *= factor
    return t_final if t <= t_final * (1 + ROUNDING) else t


def _at_the_limit(finished: float, expected: float) -> bool:
    """Whether an early finish is where the homotopy was going, or lower: else a smaller t may end better."""
    return finished - expected <= _GAP * max(abs(finished), abs(expected)) + _GAP_FLOOR


def _settled(before: Mask, sides: Mask) -> bool:
    return bool(np.count_nonzero(before != sides) <= _UNSETTLED * sides.size)
