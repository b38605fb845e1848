"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there; the default outer solver is a Newton method
with the second derivative of the active set at hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rmesh_nlp.errors import unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.outer_solvers import OUTER_SOLVERS, NestedSettings, OuterResult
from rmesh_nlp.models.reduced_nlp import reduced_nlp
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.clock import Falling
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work


@dataclass(frozen=True)
class OuterFigures(Part):
    """The outer solver, the method that it used, and the contact nodes without strict complementarity."""

    outer: str
    biactive_nodes: list[int]
    outer_method: str | None = None


@dataclass(frozen=True)
class Nested(NestedSettings, Formulation):
    """Minimises an outer objective with exact contact solves inside.

    The energy needs no adjoint; other objectives get one with the active set held, which is their gradient
    wherever strict complementarity holds. The contact nodes where it fails at the end are listed in the
    record as ``biactive_nodes``: they are what may have stopped it.

    Attributes
    ----------
    outer : str
        "newton" (projected trust-region Newton-CG where move limits alone keep the elements valid, else an
        interior-point Newton method), "newton-cg" (the former along element areas too, and the latter only
        where it stalls: cheaper, often to another minimum) or "ipopt" (with exact second derivatives; with
        limited memory for many outer variables and another objective than the energy).
    """

    outer: str = "newton"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.outer not in OUTER_SOLVERS:
            raise unknown("outer solver", self.outer, OUTER_SOLVERS)

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        track, function = monitor.track(outer), outer.function
        ends = None if self.enough is None else _Decrease(self.enough)

        def watch(iteration: int, at: Array, _: float) -> bool:
            point = function(at)
            known = {} if ends is None else {"seconds_left": ends(monitor.clock.elapsed, point.value)}
            return track.exact(iteration, at, point, **known)

        if q.size == 0:  # nothing can move, and not every solver takes a program without unknowns
            watch(0, q, 0.0)
            found = OuterResult(q, Status.CONVERGED, 0)
        else:
            with monitor.clock.during("build"):
                program = replace(
                    reduced_nlp(
                        outer.relocation,
                        function,
                        outer.is_valid,
                        outer.residual,
                        outer.tolerance,
                        outer.constraints,
                    ),
                    out_of_time=lambda: monitor.remaining == 0.0,
                    warm=outer.is_near,
                )
            found = OUTER_SOLVERS[self.outer](program, q, watch, self)
        if self.outer == "ipopt":
            monitor.work += Work(kkt_factorisations=found.iterations)
        monitor.check()
        weak = outer.contact.contact_nodes[function(found.q).weak]
        figures = OuterFigures(self.outer, weak.tolist(), found.method or None)
        return Outcome(outer, found.q, found.status, details=(figures,))


class _Decrease:
    """Guesses the seconds that are left of a descent that ends as soon as a step is not worth taking."""

    def __init__(self, enough: float) -> None:
        self._falling, self._first, self._last = Falling(enough), float("nan"), float("nan")

    def __call__(self, seconds: float, value: float) -> float:
        if self._first != self._first:
            self._first = value
        else:
            gain = self._first - value
            self._falling(seconds, (self._last - value) / gain if gain > 0 else 0.0)
        self._last = value
        left = self._falling.seconds_left
        return float("nan") if left is None else left
