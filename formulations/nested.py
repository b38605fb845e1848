"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there; the default outer solver is a Newton method
with the second derivative of the active set at hand. Other objectives have kinks there, from which
:mod:`formulations.finish` goes on.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from formulations import outer_solvers
from formulations.finish import finished
from formulations.outer_solvers import NEWTON, NestedSettings, OuterResult
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work

WINDOW, LONG_WINDOW, CREEPING = 10, 50, 1e-2
"""A descent has met a kink if its last so many iterates had several contact sets, and the best of them is
below those before by less than this part of the decrease so far: of the violation of constraints, and once
they hold of the objective. An energy has no kinks: it creeps if that goes on for the longer window."""

AUDITED = 64
"""After so many iterations of a descent of the energy, and whenever their number has doubled since, the
energy of the continuous problem is looked at: where it is not below that of the mesh as given, all that was
gained is an error of the discretisation. It takes a few contact solves each time."""


@dataclass(frozen=True)
class Nested(NestedSettings, Formulation):
    """Minimises an outer objective with exact contact solves inside.

    The energy needs no adjoint; other objectives get one with the active set held, which is their gradient
    wherever strict complementarity holds. Where the outer solver stalls at a kink, the exact finish of the
    KKT model goes on from there, and an exact contact solve ends it; ``outer`` of the record says so.
    The contact nodes where strict complementarity fails at the end are its ``biactive_nodes``.
    """

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        track, energy = monitor.track(outer), outer.objective.collapses
        creeps = Creeping(LONG_WINDOW if energy else WINDOW, is_kinked=not energy)
        is_asked = self.enough is not None or self.iterations is not None
        may_creep = not is_asked and (energy or outer.discretisation.n_contact > 0)
        why: str | None = None

        def watch(iteration: int, at: Array) -> bool:
            nonlocal why
            point = outer.function(at)
            over, (times, rest) = track.exact(iteration, at, point), divmod(iteration, AUDITED)
            is_due = rest == 0 and times.bit_count() == 1
            if may_creep and creeps(point, *outer.merit(point)):
                why = "stopped as hardly anything is gained"
            elif may_creep and outer.objective.is_energy and is_due:
                monitor.work += Work(contact_solves=1)
                if outer.continuous(at).energy >= outer.initial.energy:
                    why = "stopped as an error of the discretisation was minimised"
            return why is not None or over

        if q.size == 0:  # nothing can move, and not every solver takes a program without unknowns
            watch(0, q)
            result = OuterResult(q, Status.CONVERGED, NEWTON)
        else:
            result = outer_solvers.solved(outer, q, watch, self)
        monitor.work += Work(kkt_factorisations=result.factorised)
        monitor.budget.check()
        end, status, method = result.q, result.status, result.method
        if status is Status.INTERRUPTED:  # it creeps, and its last step may be a long one
            end, status = track.best(end), Status.STALLED
        if energy and why is not None:
            method = f"{method}, {why}"
        elif not is_asked:
            finish = finished(outer, end, monitor)
            end, method = finish.q, ", then ".join(filter(None, (method, finish.method)))
            if finish.is_stationary:
                status = Status.CONVERGED
        weak = outer.contact.contact_nodes[outer.function(end).weak]
        return Outcome(outer, end, status, details={"outer": method, "biactive_nodes": weak.tolist()})


class Creeping:
    """Tells that a descent does not get on; where there are kinks, that it goes to and fro over them."""

    def __init__(self, window: int = WINDOW, *, is_kinked: bool = True) -> None:
        self._window, self._is_kinked = window, is_kinked
        self._best: list[tuple[float, float]] = []
        self._contact = deque[bytes](maxlen=window)

    def __call__(self, point: ReducedPoint, violation: float, value: float) -> bool:
        """Take note of an iterate; whether the descent is to stop.

        ``violation`` is that of constraints, ``value`` that of the objective.
        """
        self._best.append(min([(violation, value), *self._best[-1:]]))
        self._contact.append(point.equilibrium.active.key())
        if len(self._best) <= self._window or (self._is_kinked and len(set(self._contact)) == 1):
            return False
        # what counts before constraints hold is their violation, then the objective
        before, now = self._best[-1 - self._window], self._best[-1]
        which = 0 if before[0] > 0 else 1
        first = next(best[1] for best in self._best if best[0] == 0) if which else self._best[0][0]
        return before[which] - now[which] <= CREEPING * (first - now[which])
