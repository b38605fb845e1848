"""``solve``: an MPCC in, a measured result out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.clock import LimitReachedError
from rmesh_nlp.mpcc.curvature import descent_of_curvature
from rmesh_nlp.mpcc.diagnosis import largest_residual, where_not_finite
from rmesh_nlp.mpcc.finish import Finish, finish, polished
from rmesh_nlp.mpcc.homotopy import RETREATS, Path, follow, second_path
from rmesh_nlp.mpcc.lifting import warm_start
from rmesh_nlp.mpcc.lower_level import DENSE
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.options import LARGE, Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import Duals, Iterate, MPCCResult, Step
from rmesh_nlp.mpcc.run import Progress, Run
from rmesh_nlp.mpcc.violation import is_locally_infeasible
from rmesh_nlp.optimize.status import Status

_LOWER = 1e-7  # of two stationary points the later one is taken if it is lower by this, relative
_SADDLES, _LENGTHS = 4, (0.1, 1e-2, 1e-3)  # saddles left, by steps of these lengths, relative
_HUGE = 1e15  # |f| or |x| beyond this: the iterates diverge


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
        spent: float = 0.0,
    ) -> MPCCResult:
        """Solve from ``x0`` with parameters ``p``; see :func:`solve`. ``spent`` seconds count too."""
        began = time.perf_counter()
        nlps, lifted, built = self.nlps, self.nlps.lifted, self.nlps.build_seconds
        parameters = self.mpcc.parameters(p)
        given = self.mpcc.start(x0, parameters)
        z0, weight = lifted.start(given, parameters), lifted.weight(given, parameters)
        first = None if start is None else warm_start(lifted, z0, weight, start)
        show = print if progress is True else (progress or None)
        run = Run(nlps, parameters, weight, show, on_step, on_iteration, time.perf_counter() - began + spent)
        paths: list[Path] = []
        limit, rescues, infeasible, curvature = None, 0, False, "not tested"
        nlps.dependent = False
        try:
            if first is not None:
                paths.append(Path(finish=polished(run, z0, first)))
            for number, (relaxation, t0) in enumerate(self._attempts(z0)):
                if any(path.ended for path in paths):
                    break
                hopeless = number > 0 and all(path.failure is Status.INFEASIBLE for path in paths)
                if hopeless and relaxation == self.options.relaxation:
                    continue  # a smaller set of what was empty
                rescues = number
                nlps.dependent = number > 0
                path = Path()
                paths.append(path)
                follow(run, path, relaxation, z0, t0, first, patience=0 if hopeless else RETREATS)
                used = time.perf_counter() - began + nlps.build_seconds
                if number == 0 and self._looks_twice(path) and run.seconds_left > used:
                    paths.append(Path())
                    second_path(run, paths[-1], given, path)
            curvature = _leave_saddles(run, paths)
            infeasible = _is_infeasible(run, paths, z0)
        except LimitReachedError as stop:
            limit = stop.status
        total, end = time.perf_counter() - began, _end(run, paths, z0, limit, infeasible)
        return _result(run, end, nlps.build_seconds - built, total, rescues, curvature)

    def finish(self, x0: ArrayLike, *, p: ArrayLike = ()) -> MPCCResult:
        """Only the exact finish, from a point whose pairs are complementary or nearly so.

        It descends over the branches from the one that ``x0`` is next to, without any relaxation.
        """
        began, built, path = time.perf_counter(), self.nlps.build_seconds, Path()
        parameters = self.mpcc.parameters(p)
        given = self.mpcc.start(x0, parameters)
        z0, weight = self.nlps.lifted.start(given, parameters), self.nlps.lifted.weight(given, parameters)
        run, limit = Run(self.nlps, parameters, weight), None
        try:
            path.keep(finish(run, z0, search=True))
        except LimitReachedError as stop:
            limit = stop.status
        total = time.perf_counter() - began
        return _result(run, _end(run, [path], z0, limit), self.nlps.build_seconds - built, total, 0)

    def _looks_twice(self, path: Path) -> bool:
        """Whether another trajectory may end lower, and can be had."""
        unbounded = path.finish is not None and path.finish.status is Status.UNBOUNDED
        has_expressions = self.mpcc.derivatives is None
        is_short = 0 < self.mpcc.n_pairs < LARGE
        return self.options.second_path and has_expressions and is_short and not unbounded

    def _attempts(self, z0: Array) -> list[tuple[str, float]]:
        """The homotopy asked for, then the rescues; a rescue by the same relaxation and t is left out."""
        first = (self.options.relaxation, self._first_t(z0))
        return [first, *(rescue for rescue in self.options.rescues if rescue != first)]

    def _first_t(self, z0: Array) -> float:
        """``t0``, or of a large problem the product of the largest members at the start, if that is smaller.

        A relaxation far above the products does not act, and the first one of a large problem is long.
        """
        options, scale = self.options, 0.0
        if self.mpcc.n_pairs >= LARGE:
            scale = float(np.prod(np.max(np.abs(z0[self.nlps.lifted.pairs]), axis=1)))
        return float(np.clip(scale, options.t_final, options.t0)) if scale > 0 else options.t0


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
        Multipliers that belong to ``x0``, say the result of a neighbouring problem. Newton's method is tried
        at once with them, and if it does not end at a stationary point, the first relaxation starts from
        them.
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
    began = time.perf_counter()
    solver = MPCCSolver(mpcc, options, **changes)
    result = solver(
        x0, p=p, start=start, progress=progress, on_step=on_step, on_iteration=on_iteration,
        spent=time.perf_counter() - began,
    )  # fmt: skip
    seconds = {**result.seconds, "build": solver.nlps.build_seconds, "total": time.perf_counter() - began}
    return replace(result, seconds=seconds)


def _leave_saddles(run: Run, paths: list[Path]) -> str:
    """Go on from ends with negative curvature, keep what is lower, and say what was found at the last."""
    word = "not tested"
    for _ in range(_SADDLES):
        here = _choose(paths)
        if here is None or not here.solved:
            return word
        word, d = descent_of_curvature(run, here)
        if d is None:
            return word
        lower = _beyond(run, here, d)
        if lower is None:
            return word
        paths.append(Path(finish=lower))
    return word


def _beyond(run: Run, here: Finish, d: Array) -> Finish | None:
    """A stationary point lower than a saddle, from steps along a direction of negative curvature."""
    nlp, size = run.lifted.nlp, 1.0 + float(np.max(np.abs(here.z)))
    for length in _LENGTHS:
        z = np.clip(here.z + length * size / np.max(np.abs(d)) * d, nlp.lbx, nlp.ubx)
        found = finish(run, z, search=False)
        if found.solved and _beats(found, here):
            return found
    return None


def _is_infeasible(run: Run, paths: Sequence[Path], z0: Array) -> bool:
    """Whether a local minimum of the violation is certified, where no end is feasible or ran out."""
    z, _, excess = run.nearest or (z0, np.nan, np.inf)
    ends = [path.finish.status for path in paths if path.finish is not None]
    over = {Status.UNBOUNDED, Status.ITERATION_LIMIT, Status.EVALUATION_ERROR}
    if excess <= 1.0 or over & {*ends, *(path.failure for path in paths)}:
        return False
    return is_locally_infeasible(run, z)


def _end(
    run: Run, paths: Sequence[Path], z0: Array, limit: Status | None, infeasible: bool = False
) -> Finish:
    """The best point of all homotopies, and why the solve stopped there."""
    end = _choose(paths)
    if end is not None and end.solved:
        return end if run.exact(end.z) else replace(end, status=Status.INACCURATE)
    if end is not None and end.stationarity is not None:  # exact, but not shown to be stationary
        return replace(end, status=limit or end.status)
    z, f, excess = run.nearest or (z0, np.nan, np.inf)
    if limit is not None:
        return Finish(z, f, limit)
    tried = [path.relaxed.x for path in paths if path.relaxed is not None]
    tried += [path.finish.z for path in paths if path.finish is not None]
    for point in [z, *tried]:
        f = run.nlps.measure(point, run.p)[0]
        if f < -_HUGE or (np.all(np.isfinite(point)) and np.max(np.abs(point), initial=0.0) > _HUGE):
            return Finish(point, f, Status.UNBOUNDED)
    return Finish(z, f, _failure(paths, excess, infeasible))


def _choose(paths: Sequence[Path]) -> Finish | None:
    """The lowest stationary end, the earlier of equals; an unbounded one if none is stationary."""
    best: Finish | None = None
    for end in (path.finish for path in paths if path.finish is not None):
        if best is None or _beats(end, best):
            best = end
    return best


def _beats(end: Finish, best: Finish) -> bool:
    if end.solved and best.solved:
        return end.f < best.f - _LOWER * (1 + abs(best.f))
    if end.solved != best.solved:
        return end.solved
    return (end.status is Status.UNBOUNDED, end.rank) > (best.status is Status.UNBOUNDED, best.rank)


def _failure(paths: Sequence[Path], excess: float, infeasible: bool) -> Status:
    """Why no exact point was found: INFEASIBLE only if a local minimum of the violation was certified."""
    ends = [path.failure for path in paths if path.failure is not None]
    ends += [path.finish.status for path in paths if path.finish is not None]
    if excess <= 1.0:  # feasible after all: whatever Ipopt called it
        return next((status for status in ends if status is not Status.INFEASIBLE), Status.STALLED)
    others = set(ends) - {Status.INFEASIBLE, Status.STALLED, Status.INACCURATE, Status.CONVERGED}
    if infeasible:
        return Status.INFEASIBLE
    return next((status for status in ends if status in others), Status.STALLED if ends else Status.FAILED)


def _result(
    run: Run, end: Finish, build: float, total: float, rescues: int, curvature: str = "not tested"
) -> MPCCResult:
    """Measure the point on the source problem and put everything together."""
    lifted, mpcc = run.lifted, run.lifted.source
    f, res, (g, G, H) = run.nlps.measure(end.z, run.p)
    found = end.stationarity
    column = np.full(mpcc.n_g + 2 * mpcc.n_pairs, np.nan)
    lam_x = np.full(mpcc.n_x, np.nan)
    if found is not None and found.multipliers is not None:
        own = found.multipliers
        column[mpcc.n_g :] = own.pairs.ravel()  # of members that keep their place
        column[lifted.rows] = own.rows
        column /= run.p[-1]
        lam_x = own.z[: mpcc.n_x] / run.p[-1]
    lam_g, lam_G, lam_H = np.split(column, [mpcc.n_g, mpcc.n_g + mpcc.n_pairs])
    level, check, status = mpcc.lower_level, None, end.status
    if level is not None and level.nlp.n_x <= DENSE:
        check = level.check(end.z[: mpcc.n_x], p=run.p[:-1])
        if end.solved and check.verdict == "no minimum":
            status = Status.NO_MINIMUM
    phases = {"homotopy": 0.0, "finish": 0.0}
    for step in run.steps:
        phases["homotopy" if step.phase in ("relaxed", "second") else "finish"] += step.seconds
    where = ""
    if status is Status.EVALUATION_ERROR:
        where = where_not_finite(mpcc, end.z[: mpcc.n_x], run.p[:-1])
    elif status in (Status.INFEASIBLE, Status.INACCURATE):
        where = largest_residual(mpcc, end.z[: mpcc.n_x], g, G, H)
    return MPCCResult(
        x=end.z[: mpcc.n_x], f=f, status=status, success=end.solved and status is end.status,
        message=f"{status.message} {where}".strip(), lower_level=check, curvature=curvature,
        **vars(res),
        stationarity="" if found is None else found.label,
        b_stationary=None if found is None else found.b_stationary,
        lam_x=lam_x, lam_g=lam_g, lam_G=lam_G, lam_H=lam_H, g=g, G=G, H=H,
        biactive=np.zeros(0, dtype=np.int64) if end.lin is None else end.lin.biactive,
        history=tuple(run.steps),
        counts={
            "nlp_solves": len(run.steps), "ipopt_iterations": run.iterations,
            "pivots": end.pivots, "lpecs": end.lpecs, "rescues": rescues,
        },
        seconds={"build": build, **phases, "total": total},
    )  # fmt: skip
