"""What is tried while no stationary point is found: phase I, then homotopies from moved starts.

Phase I begins at the point nearest to a solution so far. The homotopies reckon with dependent equations. They
come last, and from elsewhere, as the cause may be the start itself: functions that are not defined beside it,
or a valley that leads to a violation.
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
    """Add a path for each attempt to ``paths`` until one has ended.

    Whether the first attempt ended at a local minimum of the violation.
    """
    options, lifted = run.options, run.lifted
    if any(path.ended for path in paths):
        return False
    # from a minimum of the violation on, NLPs are solved only where a feasible point was found before
    is_minimum = _from_phase_one(run, paths, z0 if run.nearest is None else run.nearest[0])
    for x in islice(moved_starts(lifted.source, x0, options.seed), options.moves):
        if any(path.ended for path in paths):
            break
        z = lifted.start(x, run.p[:-1])
        if is_minimum:
            _from_phase_one(run, paths, z)
        else:
            paths.append(Path())
            follow(run, paths[-1], z, options.t0, dependent=True)
    return is_minimum


def _from_phase_one(run: Run, paths: list[Path], z: Array) -> bool:
    """Add the path from what phase I finds; whether that is a minimum of the violation."""
    paths.append(Path())
    near = phase_one(run, z)
    if near.status is Status.CONVERGED:
        paths[-1].keep(finish(run, near.z, search=False))
    else:
        paths[-1].failure = near.status
    return near.status is Status.INFEASIBLE and not ran_out(paths)
