"""What is tried while no stationary point is found: phase I, then homotopies from moved starts.

Phase I begins at the point nearest to a solution so far. Where it shows a minimum of the violation, that is
the answer. Else homotopies that reckon with dependent equations come last, and from elsewhere, as the cause
may be the start itself: functions that are not defined beside it, or a valley that leads to a violation.
"""

from __future__ import annotations

from itertools import islice

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import finish
from rmesh_nlp.mpcc.homotopy import Path, follow, ran_out
from rmesh_nlp.mpcc.phase_one import phase_one
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.starts import moved_starts
from rmesh_nlp.optimize.status import Status


def rescue(run: Run, paths: list[Path], x0: Array, z0: Array) -> bool:
    """Add a path for each attempt to ``paths`` until one has ended; whether the violation has a minimum."""
    if any(path.ended for path in paths):
        return False
    paths.append(Path())
    z, status = phase_one(run, z0 if run.nearest is None else run.nearest[0])
    if status is Status.CONVERGED:
        paths[-1].keep(finish(run, z, search=False))
    else:
        paths[-1].failure = status
    if status is Status.INFEASIBLE and not ran_out(paths):
        return True
    for x in islice(moved_starts(run.lifted.source, x0, run.options.seed), run.options.moves):
        if any(path.ended for path in paths):
            break
        paths.append(Path())
        follow(run, paths[-1], run.lifted.start(x, run.p[:-1]), run.options.t0, dependent=True)
    return False
