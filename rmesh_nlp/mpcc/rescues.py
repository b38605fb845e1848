"""What is tried, in turn, while no stationary point is found: other relaxations, phase I, other starts.

The relaxations of ``Options.rescues`` begin at the given start and reckon with dependent equations. Phase I
begins at the point nearest to a solution so far. Last come homotopies from moved starts, as the cause may
be the start itself: functions that are not defined beside it, or a valley that leads to a violation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.finish import finish
from rmesh_nlp.mpcc.homotopy import RETREATS, Path, first_t, follow, ran_out
from rmesh_nlp.mpcc.options import LARGE
from rmesh_nlp.mpcc.phase_one import phase_one
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.starts import moved_starts
from rmesh_nlp.optimize.status import Status


def rescue(run: Run, paths: list[Path], x0: Array, z0: Array) -> int:
    """Add a path for each attempt to ``paths`` until one has ended; the number of attempts."""
    before = len(paths)
    for attempt in _attempts(run, paths, x0, z0):
        if any(path.ended for path in paths):
            break
        paths.append(Path())
        attempt(paths[-1])
    return len(paths) - before


def _attempts(run: Run, paths: list[Path], x0: Array, z0: Array) -> Iterator[Callable[[Path], None]]:
    options, lifted = run.options, run.lifted
    asked = (options.relaxation, first_t(run, z0))

    def homotopy(relaxation: str, z: Array, t0: float, dependent: bool) -> Callable[[Path], None]:
        # where every relaxation was empty the next one is hardly worth a retreat
        patience = 0 if _is_hopeless(paths) else RETREATS
        return lambda path: follow(
            run, path, relaxation, z, t0, patience=patience, dependent=dependent)  # fmt: skip

    for relaxation, t0 in options.rescues:
        is_smaller = _is_hopeless(paths) and relaxation == options.relaxation  # than a set that was empty
        if (relaxation, t0) != asked and not is_smaller:
            yield homotopy(relaxation, z0, t0, True)
    yield lambda path: _from_phase_one(run, path, z0 if run.nearest is None else run.nearest[0])
    # from a minimum of the violation on, NLPs are solved only where a feasible point was found before
    is_minimum = paths[-1].failure is Status.INFEASIBLE and not ran_out(paths)
    moves = options.moves if lifted.source.n_pairs < LARGE else 0
    for x in islice(moved_starts(lifted.source, x0, options.seed), moves):
        z = lifted.start(x, run.p[:-1])
        if is_minimum:
            yield partial(_from_phase_one, run, z=z)
        else:
            yield homotopy(options.relaxation, z, options.t0, False)


def _from_phase_one(run: Run, path: Path, z: Array) -> None:
    near = phase_one(run, z)
    if near.status is Status.CONVERGED:
        path.keep(finish(run, near.z, search=False))
    else:
        path.failure = near.status


def _is_hopeless(paths: list[Path]) -> bool:
    return all(path.failure is Status.INFEASIBLE for path in paths)
