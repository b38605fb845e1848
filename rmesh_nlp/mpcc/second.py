"""A second, cheap trajectory in the unknowns as the user gave them; the lower of the two ends is kept.

An MPCC has many local minima, and which one a homotopy ends in is decided in its first relaxations. The
same relaxations without slacks, each by Ipopt's own settings from its largest barrier on, take another way:
of small bilevel programs one in twenty ended lower there, and about as many lower on the first one. It
ends at the first ``t <= crossover`` and costs a tenth to a third of a loop down to 1e-8.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import Finish, finish
from rmesh_nlp.mpcc.homotopy import CORNER, ROUNDING, Path
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

_SAME = 1e-4  # relaxed solutions that are not lower than this, relative, end no lower either


def second_look(run: Run, path: Path, x0: Array, first: Finish | None) -> None:
    """Follow Scholtes' relaxation from ``x0`` to ``crossover`` and finish exactly, all kept in ``path``.

    Parameters
    ----------
    run : Run
    path : Path
    x0 : array
        Start of the source problem.
    first : Finish or None
        End of the first trajectory. Where this one cannot end lower, or ends in the same branch, it is
        left at once. Its exact point counts only if it is not further above the known end than the relaxed
        one is below.
    """
    options = run.programs.options
    known = first if first is not None and first.solved else None
    t, x = options.t0, x0
    while True:
        result = run.unlifted(x, t)
        if not result.converged:
            path.failure = result.status
            path.relaxed = path.relaxed or result
            if result.status is not Status.STALLED:
                return
        else:
            path.relaxed, path.failure = result, None
        if not np.all(np.isfinite(result.x)) or _pointless(run, result, known):
            return
        if t <= options.crossover * ROUNDING:
            break
        x, t = result.x[: x0.size], max(options.factor * t, options.t_final)
    if known is None or not _same_branch(run, result.x, known.z):
        corner = CORNER * np.sqrt(t)
        ceiling = np.inf if known is None else 2 * known.f - _objective(run, result)
        path.finish = finish(run, result.x, search=known is None, warm=result, corner=corner, ceiling=ceiling)


def _pointless(run: Run, result: NLPResult, known: Finish | None) -> bool:
    """Whether the relaxed solution lies above a known exact one: its feasible set only shrinks."""
    if known is None or not result.converged:
        return False
    return _objective(run, result) >= known.f - _SAME * (1 + abs(known.f))


def _objective(run: Run, result: NLPResult) -> float:
    """The weighted objective, as in a Finish; Ipopt's own belongs to the unlifted program."""
    return float(run.programs.lifted.value(result.x, run.p)[0][0])


def _same_branch(run: Run, z: Array, known: Array) -> bool:
    """Whether a relaxed point has the larger member of every pair where the known point has it."""
    lifted, corner = run.programs.lifted, run.programs.options.corner
    G, H = known[lifted.first], known[lifted.second]
    on_G = z[lifted.first] <= z[lifted.second]
    return bool(np.all(np.where(on_G, G, H) <= corner)) and not np.any(np.maximum(G, H) <= corner)
