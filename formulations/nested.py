"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there; the default outer solver is a Newton method
with the second derivative of the active set at hand. Other objectives have kinks there, from which
:mod:`formulations.kinks` goes on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from formulations.kinks import EXACT_FINISH, Zigzag, finished, is_stationary
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models import outer_solvers
from rmesh_nlp.models.outer_solvers import NEWTON, NestedSettings, OuterResult
from rmesh_nlp.models.reduced_model import ReducedObjective, ReducedPoint
from rmesh_nlp.models.reduced_nlp import ReducedNLP, reduced_nlp
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work

ROUNDS = 3
"""Descents of the outer solver, each but the first from where the exact finish at a kink has ended; the last
one is not stopped at kinks."""


@dataclass(frozen=True)
class OuterFigures(Part):
    """The outer solvers that were used, and the contact nodes without strict complementarity."""

    outer: str
    biactive_nodes: list[int]


@dataclass(frozen=True)
class Nested(NestedSettings, Formulation):
    """Minimises an outer objective with exact contact solves inside.

    The energy needs no adjoint; other objectives get one with the active set held, which is their gradient
    wherever strict complementarity holds. Where the outer solver stalls at a kink, the exact finish of the
    KKT model goes on from there, and an exact contact solve ends it; ``outer`` of the record says so.
    The contact nodes where strict complementarity fails at the end are its ``biactive_nodes``.
    """

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        descent = _Descent(self, outer, monitor)
        if q.size == 0:  # nothing can move, and not every solver takes a program without unknowns
            descent.note(0, q)
            monitor.budget.check()
            result = OuterResult(q, Status.CONVERGED, 0, NEWTON)
        else:
            result = descent(q)
        weak = outer.contact.contact_nodes[outer.function(result.q).weak]
        figures = OuterFigures(result.method, weak.tolist())
        return Outcome(outer, result.q, result.status, details=(figures,))


class _Descent:
    """One run: the outer solver, and where the objective has kinks what goes on from them."""

    def __init__(self, settings: Nested, outer: Outer, monitor: Monitor) -> None:
        self._settings, self._outer, self._monitor = settings, outer, monitor
        self._track, self._before = monitor.track(outer), 0
        unlimited = settings.enough is None and settings.iterations is None
        is_other = isinstance(outer.function, ReducedObjective)
        self._has_kinks = unlimited and is_other and outer.discretisation.n_contact > 0
        self._lowest: ReducedPoint | None = None

    def note(self, iteration: int, q: Array) -> bool:
        """Report an iterate; whether the solve is over."""
        outer, lowest = self._outer, self._lowest
        point = outer.function(q)
        if self._has_kinks and (lowest is None or outer.merit(point) < outer.merit(lowest)):
            self._lowest = point if outer.is_valid(q) else lowest
        return self._track.exact(self._before + iteration, q, point)

    def __call__(self, q: Array) -> OuterResult:
        outer, monitor = self._outer, self._monitor
        with monitor.budget.during("build"):
            program = replace(
                reduced_nlp(
                    outer.relocation,
                    outer.function,
                    outer.is_valid,
                    outer.residual,
                    outer.tolerance,
                    outer.constraints,
                ),
                warm=outer.is_near,
            )
        if not self._has_kinks:
            return self._solved(program, q)
        methods: list[str] = []
        for attempt in range(ROUNDS):
            result = self._solved(program, q, Zigzag() if attempt < ROUNDS - 1 else None)
            methods.append(result.method)
            method = ", then ".join(methods)
            if is_stationary(outer, outer.function(result.q)):
                stopped = result.status is Status.INTERRUPTED
                return replace(result, status=Status.CONVERGED if stopped else result.status, method=method)
            if attempt == ROUNDS - 1:
                break
            lowest = self._lowest or outer.function(result.q)
            end, iterations = finished(outer, lowest, monitor)
            self._before += iterations
            q, program = lowest.q, replace(program, warm=True)
            if end is None:
                continue
            methods.append(EXACT_FINISH)
            q = end.q
            self.note(0, q)
            monitor.budget.check()
            if is_stationary(outer, end):
                return OuterResult(q, Status.CONVERGED, self._before, ", then ".join(methods))
        return replace(result, method=method)

    def _solved(self, program: ReducedNLP, q: Array, zigzag: Zigzag | None = None) -> OuterResult:
        """Where the outer solver ends, or a descent that ``zigzag`` stops, or that gets nowhere."""
        outer, stops = self._outer, zigzag or Zigzag(at_kinks=False)

        def watch(iteration: int, at: Array, _: float) -> bool:
            over, point = self.note(iteration, at), outer.function(at)
            return stops(point, *outer.merit(point)) or over

        result = outer_solvers.solved(program, q, watch, self._settings)
        self._monitor.work += Work(kkt_factorisations=result.factorised)
        self._monitor.budget.check()
        self._before += result.iterations
        stalled = zigzag is None and result.status is Status.INTERRUPTED
        return replace(result, status=Status.STALLED) if stalled else result
