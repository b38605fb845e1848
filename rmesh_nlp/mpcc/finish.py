"""The exact finish: fix every pair on one side, solve, and descend over the branches.

At a biactive point that is not S-stationary a relaxed solution is only accurate to ``sqrt(t)``. A branch
NLP (each pair fixed on one side by a bound) has no such error. Where its solution admits a linearised
descent direction in a neighbouring branch, the LPEC names that branch, and the search goes on there;
each step lowers f, so it ends. A. Nurkanovic and S. Leyffer, A globally convergent method for computing
B-stationary points of mathematical programs with equilibrium constraints, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lpec import Linearisation, linearise
from rmesh_nlp.mpcc.newton import newton
from rmesh_nlp.mpcc.run import Run, Warm
from rmesh_nlp.mpcc.stationarity import UNLABELLED, Stationarity, stationarity
from rmesh_nlp.optimize.status import Status

_GAP, _GAP_FLOOR = 1e-3, 1e-6  # an end further above the expected objective is not yet final
_DECREASE = 1e-9  # a branch is better if f falls by more than this, relative to 1 + |f|


@dataclass(frozen=True, eq=False)
class Finish:
    """End of the exact finish: a lifted point, its weighted objective, and its label.

    ``status`` is CONVERGED: S- or B-stationary; ACCEPTABLE: a label, B undecided; otherwise why it stopped.
    The linearisation is that of an exact point.
    """

    z: Array
    f: float
    status: Status
    stationarity: Stationarity = UNLABELLED
    lin: Linearisation | None = None
    pivots: int = 0

    @property
    def solved(self) -> bool:
        """Whether the point is exact and stationary."""
        return self.status in (Status.CONVERGED, Status.ACCEPTABLE)

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """Sort key: solved, unbounded, exact but not stationary, inexact; of equals the lower objective."""
        is_unbounded, f = self.status is Status.UNBOUNDED, self.f if np.isfinite(self.f) else np.inf
        return self.solved, is_unbounded, self.lin is not None, -f


def is_below(f: float, other: float) -> bool:
    """Whether an objective is below another one by more than rounding."""
    return f < other - _DECREASE * (1 + abs(other))


def finish(run: Run, z: Array, *, search: bool, warm: Warm = None) -> Finish:
    """Make the pairs of a relaxed point exact and descend to a stationary branch.

    ``search`` looks for another branch if the one next to the point is infeasible, from the multipliers
    ``warm`` at ``z`` on.
    """
    end = resolved(run, z, warm) if search else None
    if end is not None and at_the_limit(end.f, run.objective(z)):
        return end
    branch = run.branch(z, run.lifted.smaller(z))
    other = pivot(run, labelled(run, branch.x, branch.f, branch.status, branch.lam_g, is_last=False))
    return other if end is None or other.rank > end.rank else end


def at_the_limit(finished: float, expected: float) -> bool:
    """Whether an end is where the relaxed solutions were going, or lower: else another may be better."""
    return finished - expected <= _GAP * max(abs(finished), abs(expected)) + _GAP_FLOOR


def resolved(run: Run, z: Array, warm: Warm) -> Finish | None:
    """The solution next to a point, by Newton steps; None if they lead to none."""
    result = newton(run, z, warm)
    if result is None:
        return None
    run.monitor("newton", 0.0)(result.iterations, result.x, result.f, result.lam_g)  # its end alone is shown
    run.record("newton", 0.0, result)
    end = labelled(run, result.x, result.f, result.status, result.lam_g, search=False)
    return end if end.solved else None


def labelled(
    run: Run,
    z: Array,
    f: float,
    status: Status,
    lam_rows: Array | None = None,
    *,
    search: bool = True,
    is_last: bool = True,
) -> Finish:
    """The end of a branch; an exact one is labelled, unless f falls without end in it."""
    if not run.exact(z):
        is_solution = status in (Status.CONVERGED, Status.ACCEPTABLE)
        return Finish(z, f, Status.INACCURATE if is_solution else status)
    if status is Status.UNBOUNDED:
        return Finish(z, f, status)
    options = run.options
    lin = linearise(run.lifted, z, run.p, options.activity, options.corner)
    label = stationarity(run.lifted, lin, options.stationarity, run.budget, lam_rows, search, is_last)
    return Finish(z, f, label.status, label, lin)


def pivot(run: Run, point: Finish) -> Finish:
    """Descend over the branches, from one that is not B-stationary to the one its LPEC names.

    Each is solved from the multipliers of the one before. Of the points along which f falls only the last is
    labelled. A branch that is only as low counts where it is stationary.
    """
    most = run.options.max_pivots
    while (direction := point.stationarity.direction) is not None and point.pivots < most:
        own = point.stationarity.multipliers
        better = run.branch(point.z, direction.zero, warm=None if own is None else (own.z, own.rows))
        if own is not None and not (better.converged and run.exact(better.x)):
            better = run.branch(point.z, direction.zero)
        if not run.exact(better.x) or is_below(point.f, better.f):
            break
        lower = labelled(run, better.x, better.f, better.status, better.lam_g, is_last=False)
        if not (lower.solved or is_below(better.f, point.f)):
            break
        point = replace(lower, pivots=point.pivots + 1)
    if direction is None:
        return point
    last = labelled(run, point.z, point.f, Status.CONVERGED)
    status = Status.ITERATION_LIMIT if point.pivots == most else last.status
    return replace(last, pivots=point.pivots, status=status)
