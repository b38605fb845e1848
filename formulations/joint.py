"""All at once without complementarity: min over (X, u) of the energy.

Outer and inner objective are the same energy, so the bilevel problem collapses to one NLP.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from formulations.finish import Finished, finished, is_above
from formulations.ipopt import CENTRED, length, pull
from rmesh_nlp.contact.system import OwnState
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.energy_nlp import Relocation, relocation
from rmesh_nlp.models.residual import size_of
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import LEAST_SHIFTS, NLPResult, PluginOptions, Solver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Positive
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor, Track
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work


@dataclass(frozen=True)
class Joint(Formulation):
    """Minimises the energy over node positions and displacement together, by Ipopt.

    Where Ipopt does not stop at a stationary point, Newton steps on the reduced energy follow
    (:mod:`formulations.finish`), from the start where it ends above that. The record then has their number as
    ``newton_steps``.

    Attributes
    ----------
    tol : float
        Ipopt's tolerance: in units of `pull` where move limits alone keep the elements valid, of which many
        are weakly active, and an interior point meets those only to the square root of its tolerance; a
        hundredth of it, in those of `half_energy`, where element areas are constraints. There, in units of
        `pull`, the rounding of the forces can be above every tolerance, and Ipopt's restoration then leaves
        the minimiser and ends as infeasible (6.2 on 36 x 18 squares).
    first_barrier : float
        Ipopt's first barrier where a distortion keeps the elements valid, in units of `half_energy`. With its
        own one, 0.1, the first steps leave the start, which with a schedule of weights is the minimiser for
        the last weight. Of 0.1, 1e-2, 1e-3, 1e-4 and 1e-6 it was chosen on random
        problems without move limits.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    tol: Positive = 1e-10
    first_barrier: Positive = 1e-3
    ipopt: PluginOptions = field(default_factory=dict)

    def options(self, areas: bool, unit: float, distorted: bool = False) -> PluginOptions:
        """Ipopt's options, the objective in units of ``unit``, ``areas`` as constraints or without.

        ``distorted`` says that the objective has a distortion, which stands in the place of areas.
        """
        own = {"nlp_scaling_method": "none", "obj_scaling_factor": 1 / unit, "tol": self.tol}
        if not areas:
            own |= {**CENTRED, **LEAST_SHIFTS}
        else:
            own |= {"tol": 1e-2 * self.tol, "compl_inf_tol": 1e-2 * self.tol}
        if distorted:
            own["mu_init"] = self.first_barrier
        return {**own, **self.ipopt}

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        if not problem.has_energy:
            raise BadInputError(
                "joint minimises an energy, and with Coulomb friction there is none: use mpcc or nested"
            )
        if not objective.collapses:
            raise BadInputError(
                f"joint minimises the energy only, or with terms in the positions, not {objective.text!r}: "
                "with another outer objective the inner problem must stay a constraint; use mpcc or nested"
            )

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        track, first = monitor.track(outer), outer.energy(q).value
        program, result = self.minimised(outer, q, track)
        monitor.work += Work(kkt_factorisations=track.iterations)
        monitor.budget.check()
        # it may leave the move limits by 2e-12
        end = outer.clipped(result.x[: outer.n])
        status = Status.CONVERGED if result.converged else result.status
        if not result.converged and not outer.is_valid(end):
            return Outcome(outer, track.best(q), status)
        above = is_above(result.f, first)
        last = q if above else end
        before = monitor.budget.iterations
        finish = Finished(last, False) if status is Status.ITERATION_LIMIT else finished(outer, last, monitor)
        if not (above or finish.method):
            return Outcome(outer, end, status, own=_own(program, result))
        status = Status.CONVERGED if finish.is_stationary else status
        return Outcome(outer, finish.q, status, details={"newton_steps": monitor.budget.iterations - before})

    def minimised(self, outer: Outer, q: Array, track: Track) -> tuple[Relocation, NLPResult]:
        """The energy NLP, and where Ipopt ends from outer variables ``q`` and the contact solution there."""
        contact, objective = outer.energy(q), outer.objective
        areas = outer.relocation.n_valid > 0 or objective.has_barrier
        # of 1, 2, 5 and 10 parts of the energy two gave the least iterations and energies on the examples and
        # the gallery
        unit = 0.5 * size_of(contact) or 1.0 if areas else pull(contact.gradient)
        with track.monitor.budget.during("build"):
            program = outer.relocation
            if length(contact) != 1:
                program = relocation(outer.discretisation, objective, length(contact))
            options = self.options(areas, unit, objective.has_barrier)
            solver = Solver(program.nlp, options=options)
        track.residual = lambda x, lam_g: outer.residual.of_state(
            *program.split(x)[:2], *program.forces(lam_g)
        )
        begin = outer.relocation.split(outer.energy.unknowns(q, contact.equilibrium.u))
        result = solver(program.joined(*begin), monitor=track)
        track.with_violations(result.history.get("inf_pr", []))
        return program, result


def build(problem: ContactProblem) -> NLP:
    """The symbolic NLP in ``x = (q, u, s)``, see :mod:`rmesh_nlp.models.energy_nlp`.

    Extend it with :meth:`rmesh_nlp.optimize.nlp.NLP.extended`, or hand ``x``, ``f`` and ``g`` to any
    CasADi solver.
    """
    return relocation(problem).nlp


def _own(program: Relocation, result: NLPResult) -> OwnState:
    """The program's own displacement, and contact forces: the multipliers of its gaps and slips."""
    (_, u, _), (normal, friction) = program.split(result.x), program.forces(result.lam_g)
    tangential = np.zeros(program.parts.n_contact)
    tangential[program.parts.friction_rows] = friction
    return OwnState(u, normal, tangential)
