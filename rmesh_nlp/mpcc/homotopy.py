"""The homotopy: relaxations with t going down, and the exact finish as soon as the sides are clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Mask, is_finite
from rmesh_nlp.mpcc.finish import Finish, at_the_limit, finish, resolved
from rmesh_nlp.mpcc.result import is_same
from rmesh_nlp.mpcc.run import Run, Warm
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

_UNSETTLED = 0.01  # share of the pairs that may still change sides: the finish puts them right
_FREE = 1e-6  # relative change of the objective in which pairs cost nothing
_SLOPES, _ABOVE = 3.0, 1e-2  # a step may end above the last by so many of its slopes and this share of f
_SMALL = 5.0  # members whose means have a larger product are large for t = 1
_LARGE = 10.0  # times the product of the means: most pairs are free


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


def follow(
    run: Run,
    path: Path,
    z0: Array,
    first: Warm = None,
    former: Sequence[Mapping[float, float]] = (),
    t0: float | None = None,
) -> None:
    """Follow the relaxed solutions from t0 to t_final, finish exactly, keep all in ``path``.

    A step that fails, or ends above what the slope of the last objective in t allows, has left the path: it
    is done once more from the multipliers of the last, and the lower end counts. Where both fail, the finish
    begins at the one before. Where the pairs cost nothing at t0, to first order, they hold nothing up:
    Newton steps are tried at once, and else the next step is the last. ``first`` are multipliers for the
    first step, ``former`` the levels of trajectories that this one may join.
    """
    options = run.options
    t0, t_final = t0 or options.t0, options.t_final
    t, z, warm, lam, allowed = t0, z0, first, None, np.inf
    sides: Mask | None = None
    while True:
        ends = [_step(run, z, t, warm, first=lam is None)]
        if lam is None:
            ends += _from_above(run, z, t, ends[0])
        elif warm is None and not ends[0].is_on(allowed):
            ends.append(_step(run, z, t, lam))
        result, objective, product = min(ends, key=lambda end: (not end.result.converged, end.objective))
        if not result.converged:
            path.relaxed, path.failure = path.relaxed or result, result.status
            break
        path.relaxed, path.levels[t] = result, objective
        matches = (k for k, levels in enumerate(former) if is_same(objective, levels.get(t, np.inf)))
        path.joined = next(matches, None)
        if path.joined is not None:
            return
        cost = run.cost(result, t)
        is_free = cost <= _FREE * abs(objective)
        before, sides = sides, run.lifted.smaller(result.x)
        lam = result.lam_x, result.lam_g
        if run.exact(result.x) or t <= t_final:
            break
        is_settled = before is not None and np.sum(before != sides) <= _UNSETTLED * sides.size
        if (t == t0 and is_free) or (is_settled and t <= options.crossover * (1 + ROUNDING)):
            near = resolved(run, result.x, lam)
            if near is not None and path.keep(near) and at_the_limit(near.f, objective):
                return
        if t == t0 and is_free:
            last = run.relaxed(result.x, t_final, lam, last=True)
            if last.converged and at_the_limit(run.objective(last.x), objective):
                path.relaxed, lam = last, (last.lam_x, last.lam_g)
                break
        # pairs that cost nothing yet do not say what they will cost
        allowed = np.inf if is_free else _allowed(objective, cost)
        z, warm = result.x, lam if options.warm_duals else None
        t = _next(t, options.factor, product, t_final)
    z = path.relaxed.x
    is_violated = lam is None and path.failure is Status.INFEASIBLE
    if is_finite(z) and not is_violated and (path.finish is None or path.failure is None):
        path.keep(finish(run, z, search=lam is not None, warm=lam))


class _End(NamedTuple):
    """A relaxed solution, its weighted objective and the largest product of its pairs."""

    result: NLPResult
    objective: float
    product: float

    def is_on(self, allowed: float) -> bool:
        """Whether nothing is gained by a second try: at most as high as ``allowed``, or at a violation."""
        is_low = self.result.converged and self.objective <= allowed
        return is_low or self.result.status is Status.INFEASIBLE


def _step(run: Run, z: Array, t: float, warm: Warm = None, *, first: bool = False) -> _End:
    result = run.relaxed(z, t, warm, first=first)
    return _End(result, run.steps[-1].objective * run.p[-1], run.steps[-1].product)


def _from_above(run: Run, z: Array, t: float, end: _End) -> list[_End]:
    """The relaxed solution at t by way of a larger one, where t is small in the unit of the products.

    That is the mean of G times the mean of H where the first relaxation ended: forces of 10 N and lengths of
    0.5 m have products of 5, and t = 1 is a narrow valley, which the start may lie in the wrong one of.
    """
    G, H = end.result.x[run.lifted.pairs]
    size = float(np.mean(G) * np.mean(H)) if G.size and end.result.converged else 0.0
    cost = run.cost(end.result, t) if size > _SMALL else 0.0
    if cost <= _FREE * abs(end.objective):
        return []
    above = _step(run, z, _LARGE * size * t, first=True)
    if above.result.converged:
        above = _step(run, above.result.x, size * t)
    if not above.result.converged or end.objective <= _allowed(above.objective, size * cost):
        return []
    return [_step(run, above.result.x, t)]


def _allowed(objective: float, cost: float) -> float:
    """The highest end of a step down from ``objective`` that is still on the path."""
    return objective + _SLOPES * cost + _ABOVE * abs(objective)


def _next(t: float, factor: float, product: float, t_final: float) -> float:
    """The next t of the sequence that acts: above the largest product the relaxation changes nothing.

    The sequence itself is kept. Going on from the product instead lost good minima (family sliding-modes).
    """
    t = factor * t
    while t > product and t > t_final:
        t *= factor
    return t_final if t <= t_final * (1 + ROUNDING) else t
