"""``solve``: an MPCC in, a measured result out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice

from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import finish, settled
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.mpcc.lifting import warm_start
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.outcome import end_of, leave_saddles, result_of
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.rescues import rescue
from rmesh_nlp.mpcc.result import Duals, Iterate, MPCCResult, Step
from rmesh_nlp.mpcc.run import Progress, Run, Watchers
from rmesh_nlp.mpcc.starts import MultiStart, moved_starts
from rmesh_nlp.optimize.budget import Budget, StoppedError
from rmesh_nlp.optimize.solver import NLPResult


class MPCCSolver:
    """An MPCC compiled once and solved for many starts and parameters.

    Parameters
    ----------
    mpcc : MPCC
    options : Options, optional
        Single fields may be given by name instead: ``MPCCSolver(mpcc, relaxation="l1-penalty")``.
    """

    def __init__(self, mpcc: MPCC, options: Options | None = None, **changes: object) -> None:
        self.mpcc = mpcc
        self.options = (options or Options()).having(changes)
        self.nlps = CompiledNLPs(mpcc, self.options)

    def __call__(
        self,
        x0: ArrayLike,
        *,
        p: ArrayLike = (),
        start: MPCCResult | Duals | None = None,
        progress: Progress | bool = False,
        on_step: Callable[[Step], None] | None = None,
        on_iteration: Callable[[Iterate], None] | None = None,
        budget: Budget | None = None,
    ) -> MPCCResult:
        """Solve from ``x0`` with parameters ``p``; see :func:`solve`. A ``budget`` replaces the limits."""
        show = print if progress is True else (progress or None)
        many = self._several(x0, p, start, (show, on_step, on_iteration), budget)
        return many.results[0] if self.options.starts == 1 else many.summary()

    def several(
        self,
        x0: ArrayLike,
        *,
        p: ArrayLike = (),
        progress: Progress | bool = False,
        budget: Budget | None = None,
    ) -> MultiStart:
        """Solve from ``x0`` and from ``starts - 1`` others; the results of all."""
        show = print if progress is True else (progress or None)
        return self._several(x0, p, None, (show, None, None), budget)

    def _several(
        self,
        x0: ArrayLike,
        p: ArrayLike,
        start: MPCCResult | Duals | None,
        watchers: Watchers,
        budget: Budget | None,
    ) -> MultiStart:
        options, budget = self.options, budget or self.options.budget()
        parameters = self.mpcc.parameters(p)
        given = self.mpcc.start(x0, parameters)
        weight = self.nlps.lifted.weight(given, parameters)
        first = None
        if start is not None:
            first = warm_start(self.nlps.lifted, self.nlps.lifted.start(given, parameters), weight, start)
        results: list[MPCCResult] = []
        joined: list[int | None] = []
        former: list[dict[float, float]] = []
        others = islice(moved_starts(self.mpcc, given, options.seed), options.starts - 1)
        starts = [given, *others]
        for x in starts:
            run = Run(self.nlps, parameters, weight, *watchers, budget)
            result, path = self._one(run, x, first, former)
            joined.append(path.joined)
            results.append(result if path.joined is None else results[path.joined])
            former.append(path.levels if result.success else {})
            if budget.is_over():
                break
        return MultiStart(tuple(results), tuple(starts[: len(results)]), options.seed, tuple(joined))

    def _one(
        self, run: Run, given: Array, first: NLPResult | None, former: Sequence[dict[float, float]]
    ) -> tuple[MPCCResult, Path]:
        """Solve from one start; also the trajectory of the homotopy, which may have joined a former one."""
        watch, nlps, built = Budget(), self.nlps, self.nlps.build_seconds
        z0, is_first = nlps.lifted.start(given, run.p[:-1]), not former
        paths, main = [], Path()
        limit, rescues, infeasible, curvature = None, 0, False, "not tested"
        try:
            if first is not None and is_first:
                paths.append(Path(finish=settled(run, run.branch(z0, nlps.lifted.smaller(z0), warm=first))))
            if not any(path.ended for path in paths):
                paths.append(main)
                follow(run, main, z0, self.options.t0, first if is_first else None, former)
            if is_first:
                before = len(paths)
                infeasible = rescue(run, paths, given, z0)
                rescues = len(paths) - before
            if main.joined is None:
                curvature = leave_saddles(run, paths)
        except StoppedError as stop:
            limit = stop.status
        end = end_of(run, paths, z0, limit, infeasible)
        return result_of(run, end, nlps.build_seconds - built, watch.elapsed, rescues, curvature), main

    def finish(self, x0: ArrayLike, *, p: ArrayLike = (), budget: Budget | None = None) -> MPCCResult:
        """Only the exact finish, from a point whose pairs are complementary or nearly so.

        It descends over the branches from the one that ``x0`` is next to, without any relaxation.
        """
        watch, built, path = Budget(), self.nlps.build_seconds, Path()
        parameters = self.mpcc.parameters(p)
        given = self.mpcc.start(x0, parameters)
        z0, weight = self.nlps.lifted.start(given, parameters), self.nlps.lifted.weight(given, parameters)
        run, limit = Run(self.nlps, parameters, weight, budget=budget), None
        try:
            path.keep(finish(run, z0, search=not run.exact(z0)))
        except StoppedError as stop:
            limit = stop.status
        end = end_of(run, [path], z0, limit)
        return result_of(run, end, self.nlps.build_seconds - built, watch.elapsed, 0)


def solve(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    p: ArrayLike = (),
    start: MPCCResult | Duals | None = None,
    options: Options | None = None,
    progress: Progress | bool = False,
    on_step: Callable[[Step], None] | None = None,
    on_iteration: Callable[[Iterate], None] | None = None,
    **changes: object,
) -> MPCCResult:
    """Solve an MPCC locally from ``x0``: homotopy of relaxations, then the exact finish.

    Parameters
    ----------
    mpcc : MPCC
    x0 : array_like
        Start; need not be feasible. A scalar fills it.
    p : array_like
        Values of the parameters.
    start : MPCCResult or Duals, optional
        Multipliers that belong to ``x0``, say the result of a neighbouring problem. The branch of ``x0`` is
        tried at once with them, and if it does not end at a stationary point, the first relaxation starts
        from them.
    options : Options, optional
    progress : bool or callable
        True prints one line per NLP solve; a callable receives the line.
    on_step : callable, optional
        Receives the ``Step`` of each NLP: t, residuals, product, number of biactive pairs.
    on_iteration : callable, optional
        Receives an ``Iterate`` after each Ipopt iteration; costs an evaluation of the problem each.
    **changes
        Single fields of ``Options`` by name, e.g. ``relaxation="kanzow-schwartz"``.

    Returns
    -------
    MPCCResult

    Raises
    ------
    ValueError
        If ``x0`` or ``p`` has the wrong length or is not finite, or an option is out of range.
    KeyboardInterrupt
        If the user interrupts; it is never turned into a failed result.
    """
    chosen = (options or Options()).having(changes)
    budget = chosen.budget()  # what is built counts too
    solver = MPCCSolver(mpcc, chosen)
    result = solver(
        x0, p=p, start=start, progress=progress, on_step=on_step, on_iteration=on_iteration, budget=budget
    )
    seconds = {**result.seconds, "build": solver.nlps.build_seconds, "total": budget.elapsed}
    return replace(result, seconds=seconds)


def multistart(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    n: int = 10,
    seed: int = 0,
    p: ArrayLike = (),
    options: Options | None = None,
    progress: Progress | bool = False,
    **changes: object,
) -> MultiStart:
    """Solve from ``x0`` and from ``n - 1`` seeded random starts around it; the results of all.

    ``solve(..., starts=n, seed=seed)`` returns the best of them. Starts are uniform between the bounds where
    both are near enough, else normal around ``x0`` and around 0, clipped to the bounds. The same seed gives
    the same starts. A start whose trajectory comes upon a former one has that one's result. Limits hold for
    all starts together.
    """
    if n < 1:
        raise ValueError(f"n = {n} starts: at least 1 is needed")
    return MPCCSolver(mpcc, options, **{**changes, "starts": n, "seed": seed}).several(
        x0, p=p, progress=progress
    )
