"""By how much relocation lowers the error of the energy: an interval, from refinements of the last mesh.

``J_0`` and ``J_1`` are the continuous energies of the given and of the last mesh. A uniform refinement of the
last one lowers its energy by ``d``, so its error ``e_1`` is at least that. Errors of displacements of order k
fall by a factor r between 4^k, where the solution is smooth, and ``SLOWEST`` at the singularities that occur,
so ``e_1`` is at most ``d / (1 - 1 / r)``; a second refinement tells r. With ``e_0 = e_1 + J_0 - J_1`` the
factor is ``1 + (J_0 - J_1) / e_1``.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.display import figure
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import difference
from rmesh_nlp.meshes.curves import Two
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem.contact_problem import refined

FEW = 100
"""Nodes up to which a mesh is refined twice; a larger one once, or this would cost more than the audit. A new
mesh so small was made for what the given one shows, and may be coarse where the load has a narrow feature:
its bounds are also those of the given mesh, by refinements of that, less the fall of the energy."""

SLOWEST = 1.7
"""Least factor by which the error falls with a refinement: that of N^-0.38. On 40 random problems
(:mod:`rmesh_nlp.examples.random_problems`, seeds 0 to 39, 12 to 99 nodes) the error of a relocated mesh fell
by 2.0 to 8 with the first refinement."""

FASTEST = {1: 8.0, 2: np.inf}
"""The largest one by the order: on coarse meshes more than ``4^k`` occurs, up to 240 at order 2 (seeds 200 to
239). No bound there costs a fifteenth of ``d`` at most."""

SOURCES = {
    "exact": "by the exact energy",
    "refinement": "by refining the last mesh",
    "certified": "proved by the certificate",
}
"""What the bounds of an error rest on."""


@dataclass(frozen=True)
class ErrorReduction:
    """Errors of the energy before and after a relocation."""

    error_initial: Two  # lower and upper bound
    error: Two
    factor: float  # by which the error fell at least
    factor_upper: float  # and at most
    source: str  # one of ``SOURCES``
    nodes: int
    contact_solves: int

    def text(self) -> str:
        """In plain words."""
        before, after = (_interval(*bounds) for bounds in (self.error_initial, self.error))
        factor = _interval(self.factor, self.factor_upper, digits=2)
        return (
            f"error of the energy {before} before, {after} after ({SOURCES[self.source]}): {factor} times "
            f"less on {self.nodes} nodes, for {self.contact_solves} contact solves"
        )

    def record(self) -> dict[str, Any]:
        """As plain values, with the text; what is not bounded is None."""
        upper = self.factor_upper if np.isfinite(self.factor_upper) else None
        return {**asdict(self), "factor_upper": upper, "text": self.text()}


def _interval(low: float, high: float, digits: int = 3) -> str:
    if not np.isfinite(high):
        return f"at least {low:.{digits}g}"
    if low == 0:
        return f"at most {figure(high)}"
    least, most = (f"{value:.{digits}g}" for value in (low, high))
    return least if least == most else f"{least} to {most}"


def error_reduction(
    before: Admissible, after: Admissible, contact_solves: int
) -> tuple[ErrorReduction | None, Admissible | None]:
    """The error reduction from one mesh to another, and the displacement on the finest mesh that was needed.

    The first is None where nothing can be claimed: the energy did not fall, or refinements do not show how
    the error falls.
    """
    exact, fall, finest = after.problem.exact, difference(before.energy, after.energy), None
    size = after.body.nodes.shape[1]
    if exact is not None and np.isfinite(exact.energy) and not after.problem.motion.curves:
        error = difference(after.energy, exact.energy)
        source, bounds = "exact", (error, error) if error > 0 else None
    else:
        source, (bounds, finest) = "refinement", _bounds(after)
        if bounds and size <= FEW and not np.array_equal(before.problem.triangles, after.problem.triangles):
            given, _ = _bounds(before)
            bounds = given and (max(bounds[0], given[0] - fall), max(bounds[1], given[1] - fall))
    if bounds is None or not fall > 0:
        return None, finest
    low, high = bounds
    factors = 1 + fall / high, 1 + fall / low
    reduction = ErrorReduction((low + fall, high + fall), bounds, *factors, source, size, contact_solves)
    return reduction, finest


def _bounds(last: Admissible) -> tuple[Two | None, Admissible | None]:
    """Lower and upper bound of the error of the energy; the admissible displacement on the finest mesh."""
    finest, falls = last, []
    if last.problem.locking:
        return None, None  # a refinement that locks as well is no yardstick
    for _ in range(2 if last.body.nodes.shape[1] <= FEW else 1):
        try:
            finer = on_refined(finest)
        except ProblemError:  # new nodes on a curve would fold a thin element
            return None, None
        if finer.status is not Status.CONVERGED:
            return None, None
        falls.append(difference(finest.energy, finer.energy))
        finest = finer
    if not min(falls) > 0 or any(b >= a for a, b in pairwise(falls)):
        return None, finest
    earlier, rest, fastest = sum(falls[:-1]), falls[-1], FASTEST[last.problem.order]
    return (earlier + rest / (1 - 1 / fastest), earlier + rest / (1 - 1 / SLOWEST)), finest


def on_refined(last: Admissible) -> Admissible:
    """The admissible displacement on the uniform refinement."""
    moved = relocated_mesh(last.problem.mesh, last.body.nodes)
    return admissible(refined(last.problem, mesh=moved))


def by_certificate(estimated: ErrorReduction, before: float, after: float) -> ErrorReduction:
    """An error reduction with the guaranteed bounds of a certificate in the place of what was estimated.

    ``before`` and ``after`` are ``E_0 - lower`` and ``E_1 - lower``, which bound the errors of these energies
    from above. The true factor ``(E_0 - J) / (E_1 - J)``, with J the least energy, grows with J, so that
    ``(E_0 - lower) / (E_1 - lower)`` bounds it from below. What is measured against an exact energy stays.
    """
    if estimated.source == "exact" or not before >= after > 0:
        return estimated
    errors = (before - after, before), (0.0, after)
    solved = estimated.nodes, estimated.contact_solves
    return ErrorReduction(*errors, before / after, float("inf"), "certified", *solved)
