"""``solve``: an MPCC in, a measured result out."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.homotopy import Path, follow
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.programs import Log, Programs, Progress
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.optimize.nlp import Status

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
        self.options = replace(options or Options(), **changes)  # type: ignore[arg-type]
        self.programs = Programs(mpcc, self.options)

    def __call__(self, x0: ArrayLike, *, p: ArrayLike = (), progress: Progress | bool = False) -> MPCCResult:
        """Solve from ``x0`` with parameters ``p``; see :func:`solve`."""
        began = time.perf_counter()
        built = self.programs.build_seconds
        parameters = self.mpcc.parameters(p)
        z0 = self.programs.lifted.start(self.mpcc.start(x0), parameters)
        show = print if progress is True else (progress or None)
        log = Log(self.programs, parameters, show)
        paths: list[Path] = []
        for relaxation, t0 in self._attempts():
            paths.append(follow(self.programs, relaxation, z0, parameters, t0, log))
            end = paths[-1].finish
            if end is not None and (end.solved or end.status is Status.UNBOUNDED):
                break
        total = time.perf_counter() - began
        build = self.programs.build_seconds - built
        return _result(self.programs, paths, parameters, log, build, total)

    def _attempts(self) -> list[tuple[str, float]]:
        """The homotopy asked for, the same from other t0, and the elastic mode as the last resort."""
        options = self.options
        starts = [(options.relaxation, t0) for t0 in (options.t0, *options.rescue_t0)]
        elastic = [("l1-penalty", t0) for t0 in options.rescue_t0[:1] if options.relaxation != "l1-penalty"]
        return starts + elastic


def solve(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    p: ArrayLike = (),
    options: Options | None = None,
    progress: Progress | bool = False,
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
    options : Options, optional
    progress : bool or callable
        True prints one line per NLP solve; a callable receives the line.
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
    result = solver(x0, p=p, progress=progress)
    seconds = {**result.seconds, "build": solver.programs.build_seconds, "total": time.perf_counter() - began}
    return replace(result, seconds=seconds)


def _result(
    programs: Programs, paths: list[Path], p: Array, log: Log, build: float, total: float
) -> MPCCResult:
    """Measure the best point on the source problem and say how the solve ended."""
    path = _choose(paths)
    lifted, mpcc = programs.lifted, programs.lifted.source
    end = path.finish
    z = path.relaxed.x if end is None else end.z
    f, res, (g, G, H) = programs.measure(z, p)
    status = _status(paths, end, f, z)
    solved = status in (Status.CONVERGED, Status.ACCEPTABLE)
    if solved and programs.excess(z, p) > 1.0:
        status, solved = Status.INACCURATE, False
    lin = end.lin if end is not None else None
    verdict = None if end is None else end.verdict
    multipliers = None if verdict is None else verdict.label.multipliers
    column = np.full(mpcc.n_g + 2 * mpcc.n_pairs, np.nan)
    lam_x = np.full(mpcc.n_x, np.nan)
    if multipliers is not None:
        column[:] = 0.0
        column[lifted.rows] = multipliers.rows
        plain = np.setdiff1d(np.arange(mpcc.n_g, column.size), lifted.rows)
        column[plain] = np.concatenate([multipliers.G, multipliers.H])[plain - mpcc.n_g]
        lam_x = multipliers.z[: mpcc.n_x]
    history = tuple(log.steps)
    phases = {"homotopy": 0.0, "finish": 0.0}
    for step in history:
        phases["homotopy" if step.phase == "relaxed" else "finish"] += step.seconds
    return MPCCResult(
        x=z[: mpcc.n_x],
        f=f,
        status=status,
        success=solved,
        message=status.message,
        constraint_violation=res.constraint_violation,
        complementarity=res.complementarity,
        product=res.product,
        stationarity="" if verdict is None else verdict.label.name,
        b_stationary=None if verdict is None else verdict.b_stationary,
        lam_x=lam_x,
        lam_g=column[: mpcc.n_g],
        lam_G=column[mpcc.n_g : mpcc.n_g + mpcc.n_pairs],
        lam_H=column[mpcc.n_g + mpcc.n_pairs :],
        g=g,
        G=G,
        H=H,
        biactive=np.zeros(0, dtype=np.int64) if lin is None else lin.biactive,
        history=history,
        counts={
            "nlp_solves": len(history),
            "ipopt_iterations": sum(step.iterations for step in history),
            "pivots": 0 if end is None else end.pivots,
            "lpecs": 0 if end is None else end.lpecs,
            "rescues": len(paths) - 1,
        },
        seconds={"build": build, **phases, "total": total},
    )


def _choose(paths: list[Path]) -> Path:
    """The path with a solved or unbounded finish (it is the last one), else that with the best finish."""
    end = paths[-1].finish
    if end is not None and (end.solved or end.status is Status.UNBOUNDED):
        return paths[-1]
    worst = (False, False, -np.inf)
    return max(paths, key=lambda path: worst if path.finish is None else path.finish.rank)


def _status(paths: list[Path], end: Finish | None, f: float, z: Array) -> Status:
    """Name the end: where the finish stopped, or why no relaxation could be solved."""
    failures = [path.failure for path in paths if path.failure is not None]
    if end is not None and end.solved:
        return end.status
    if abs(f) > _HUGE or np.max(np.abs(z), initial=0.0) > _HUGE:
        return Status.UNBOUNDED
    if end is not None:
        return end.status
    return Status.INFEASIBLE if Status.INFEASIBLE in failures else failures[0]
