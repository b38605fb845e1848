"""``solve``: an MPCC in, a measured result out."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import chain, islice

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.errors import BadInputError, expect
from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import finish, labelled, resolved
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.mpcc.lifting import warm_start
from rmesh_nlp.mpcc.newton import sensitivity
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.options import Options, OptionsLike
from rmesh_nlp.mpcc.outcome import best_of, end_of, leave_saddles, result_of
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.rescues import moved_starts, rescue
from rmesh_nlp.mpcc.result import Duals, Iterate, MPCCResult
from rmesh_nlp.mpcc.run import Run, Watchers
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.status import Status

_APART = 1e-3  # of t0, from which a start is followed that joins a former one at once
Progress = Callable[[str], None] | bool


class MPCCSolver:
    """An MPCC compiled once and solved for many starts and parameters.

    Parameters
    ----------
    mpcc : MPCC
        The problem.
    options : Options or mapping of its fields, optional
        Single fields may be given by name instead: ``MPCCSolver(mpcc, relaxation="l1-penalty")``.
    """

    def __init__(self, mpcc: MPCC, options: OptionsLike = None, **changes: object) -> None:
        expect("mpcc", mpcc, MPCC)
        self.mpcc = mpcc
        self.options = Options.of(options).having(changes)
        self.nlps = CompiledNLPs(mpcc, self.options)

    def __call__(
        self,
        x0: ArrayLike,
        *,
        p: ArrayLike = (),
        start: MPCCResult | Duals | None = None,
        progress: Progress = False,
        on_iteration: Callable[[Iterate], None] | None = None,
        budget: Budget | None = None,
    ) -> MPCCResult:
        """Solve from ``x0`` with parameters ``p``; see :func:`solve`. A ``budget`` replaces the limits."""
        watchers: Watchers = (print if progress is True else (progress or None), on_iteration)
        for name, watcher in zip(("progress", "on_iteration"), watchers, strict=True):
            if not (watcher is None or callable(watcher)):
                raise BadInputError(f"{name} must be callable, got {watcher!r}")
        parameters, budget, options = self.mpcc.parameters(p), budget or self.options.budget(), self.options
        given, weight = self.mpcc.start(x0, parameters), None
        ends: list[MPCCResult] = []
        former: list[dict[float, float]] = []
        for x in islice(chain([given], moved_starts(self.mpcc, given, options.seed)), options.starts):
            run = self._run(x, parameters, budget, watchers, weight)
            weight = run.p[-1]
            result, path = self._one(run, None if ends else start, former)
            ends.append(result if path.joined is None else ends[path.joined])
            former.append(path.levels if result.success else {})
            if budget.is_over():
                break
        return best_of(ends)

    def _one(
        self,
        run: Run,
        start: MPCCResult | Duals | None,
        former: Sequence[dict[float, float]],
    ) -> tuple[MPCCResult, Path]:
        """Solve from one start; also the trajectory of the homotopy, which may have joined a former one."""
        paths, main, z0 = list[Path](), Path(), run.z0
        first = None if start is None else warm_start(run.lifted, run.p[-1], start)
        with run.limited():
            if first is not None:
                paths.append(Path(finish=resolved(run, z0, first)))
            if not any(path.ended for path in paths):
                follow(run, main, z0, first, former)
                if main.joined is not None and len(main.levels) == 1:
                    main = Path()
                    follow(run, main, z0, first, former, t0=_APART * run.options.t0)
                paths.append(main)
            if not former:
                rescue(run, paths)
            if main.joined is None:
                leave_saddles(run, paths)
        return result_of(run, end_of(run, paths)), main

    def map(
        self, x0s: ArrayLike, ps: Sequence[ArrayLike], *, processes: int | None = None
    ) -> list[MPCCResult]:
        """Solve for each of the parameters ``ps`` in processes of their own, by default one per processor.

        ``x0s`` is one start, or one for each of the parameters. Limits are those of each solve.
        """
        given = np.asarray(x0s, dtype=float)
        starts = given if given.ndim == 2 else [given] * len(ps)
        fork = multiprocessing.get_context("fork")  # what is compiled is shared
        with ProcessPoolExecutor(processes, fork, _workers.append, (self,)) as pool:
            return list(pool.map(_solved, starts, ps))

    def sensitivity(self, result: MPCCResult, *, p: ArrayLike = ()) -> Array:
        """Derivatives of a solution's x by the parameters (n_x, n_p), by one KKT matrix.

        NaN where they are not shown to exist: without S, where something active has no multiplier, and where
        the Hessian of the Lagrangian is not positive along what is active.
        """
        run = self._run(result.x, p)
        duals = warm_start(self.nlps.lifted, run.p[-1], result)
        if result.stationarity != "S":
            return np.full((self.mpcc.n_x, run.p.size - 1), np.nan)
        return sensitivity(run, run.z0, *duals)[: self.mpcc.n_x]

    def finish(self, x0: ArrayLike, *, p: ArrayLike = (), budget: Budget | None = None) -> MPCCResult:
        """Only the exact finish, from a point whose pairs are complementary or nearly so.

        It descends over the branches from the one that ``x0`` is next to, without any relaxation.
        """
        run, path = self._run(x0, p, budget), Path()
        with run.limited():
            path.keep(finish(run, run.z0, search=not run.exact(run.z0)))
        return result_of(run, end_of(run, [path]))

    def classify(self, x: ArrayLike, *, p: ArrayLike = ()) -> MPCCResult:
        """Measure and label a given point; see :func:`classify`."""
        run = self._run(x, p)
        return result_of(run, labelled(run, run.z0, run.objective(run.z0), Status.CONVERGED))

    def _run(
        self,
        x: ArrayLike,
        p: ArrayLike,
        budget: Budget | None = None,
        watchers: Watchers = (None, None),
        weight: float | None = None,
    ) -> Run:
        """A run from a point of the source problem, by default with the weight that suits it."""
        lifted, parameters = self.nlps.lifted, self.mpcc.parameters(p)
        given = self.mpcc.start(x, parameters)
        weight = weight or lifted.weight(given, parameters)
        return Run(self.nlps, lifted.start(given, parameters), parameters, weight, watchers, budget)


_workers: list[MPCCSolver] = []
"""The solver of a process that :meth:`MPCCSolver.map` has made."""


def _solved(x0: ArrayLike, p: ArrayLike) -> MPCCResult:
    return _workers[-1](x0, p=p)


def solve(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    p: ArrayLike = (),
    start: MPCCResult | Duals | None = None,
    options: OptionsLike = None,
    progress: Progress = False,
    on_iteration: Callable[[Iterate], None] | None = None,
    **changes: object,
) -> MPCCResult:
    """Solve an MPCC locally from ``x0``: homotopy of relaxations, then the exact finish.

    Parameters
    ----------
    mpcc : MPCC
        The problem.
    x0 : array_like
        Start; need not be feasible. A scalar fills it.
    p : array_like
        Values of the parameters.
    start : MPCCResult or Duals, optional
        Multipliers that belong to ``x0``, say the result of a neighbouring problem. The branch of ``x0`` is
        tried at once with them, and if it does not end at a stationary point, the first relaxation starts
        from them.
    options : Options or mapping of its fields, optional
        Single fields may be given by name instead.
    progress : bool or callable
        True prints one line per NLP solve; a callable receives the line.
    on_iteration : callable, optional
        Receives an ``Iterate`` after each Ipopt iteration: t, residuals, product, number of biactive pairs;
        costs an evaluation of the problem each.
    **changes
        Single fields of ``Options`` by name, e.g. ``relaxation="kanzow-schwartz"``, ``starts=10``.

    Returns
    -------
    MPCCResult
        Of several starts that of the best end, with all of them in ``ends``.

    Raises
    ------
    ValueError
        If ``x0`` or ``p`` has the wrong length or is not finite, or an option is out of range.
    KeyboardInterrupt
        If the user interrupts; it is never turned into a failed result.
    """
    chosen = Options.of(options).having(changes)
    budget = chosen.budget()  # what is built counts too
    solver = MPCCSolver(mpcc, chosen)
    result = solver(x0, p=p, start=start, progress=progress, on_iteration=on_iteration, budget=budget)
    seconds = {**result.seconds, "build": solver.nlps.build_seconds, "total": budget.elapsed}
    return replace(result, seconds=seconds)


def classify(mpcc: MPCC, x: ArrayLike, *, p: ArrayLike = (), options: OptionsLike = None) -> MPCCResult:
    """Measure and label a given point, without solving the MPCC.

    The status of a point that is not feasible and complementary is ``inaccurate``; it has no label.

    Raises
    ------
    ValueError
        If ``x`` or ``p`` has the wrong length or is not finite.
    """
    return MPCCSolver(mpcc, options).classify(x, p=p)
