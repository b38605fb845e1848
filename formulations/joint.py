"""All at once without complementarity: min over (X, u) of the energy.

Outer and inner objective are the same energy, so the bilevel problem collapses to one NLP.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from formulations.nested import Nested
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.energy_nlp import Relocation, relocation
from rmesh_nlp.models.outer_solvers import RISE
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import NLPResult, Solver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Positive
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor, Track
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work

MOST = 3000
"""Ipopt's own limit of iterations."""

NEAR = 1e-2
"""First-order residual up to which the end of Ipopt is near a stationary point."""

ACCEPTABLE, AREAS = 1e-7, 1e-2
"""Ipopt's tolerance where rounding stops it before ``tol``, and how much finer both are with areas.

Without it Example 6.3 with 20 x 10 squares and a weighted quality ends a hundred times less stationary."""

STEPS = 10
"""Most Newton steps from there. Three random problems (seeds 3039, 3133 and 3277) take five, two and two."""

ORDINARY = (1e-4, 1e4)
"""Sizes of displacements that Ipopt is given as they are; others are measured in the largest of them."""

_BARRIER: Mapping[str, Any] = {
    # Ipopt would add a factor of its own, which depends on the unit of force.
    "nlp_scaling_method": "none",
    # Start in the middle of the move limits and let the nodes choose their corners as the barrier
    # falls; with a small barrier they choose too early.
    "mu_init": 2.0,
    "bound_mult_init_method": "mu-based",
    # The energy is concave in some direction at nearly every iterate, so the Hessian is shifted.
    # A shift within a factor 1.5 of the least one takes half of the steps that Ipopt's own
    # search, within a factor 8, needs, and repays the factorisations that it costs.
    "perturb_dec_fact": 0.2,
    "perturb_inc_fact": 1.5,
}


@dataclass(frozen=True)
class NewtonSteps(Part):
    """How many Newton steps followed Ipopt."""

    newton_steps: int


@dataclass(frozen=True)
class Joint(Formulation):
    """Minimises the energy over node positions and displacement together, by Ipopt.

    Where Ipopt stops close to a stationary point but not at one, Newton steps on the reduced energy follow.
    The record then has their number as ``newton_steps``. Where it ends above its start, Newton's method
    begins again from there, which never rises. docs/notes/speed.md has the benchmarks that chose
    the settings.

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
    ipopt: Mapping[str, Any] = field(default_factory=dict)

    def options(self, areas: bool, unit: float, distorted: bool = False) -> dict[str, Any]:
        """Ipopt's options, the objective in units of ``unit``, ``areas`` as constraints or without.

        ``distorted`` says that the objective has a distortion, which stands in the place of areas.
        """
        common = {"max_iter": MOST, "obj_scaling_factor": 1 / unit}
        if areas:
            own = {
                "nlp_scaling_method": "none",
                "tol": AREAS * self.tol,
                "compl_inf_tol": AREAS * self.tol,
                "acceptable_tol": AREAS * ACCEPTABLE,
            }
            if distorted:
                own["mu_init"] = self.first_barrier
        else:
            own = {**_BARRIER, "tol": self.tol, "acceptable_tol": ACCEPTABLE}
        return {**common, **own, **self.ipopt}

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        if problem.has_coulomb:
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
        if is_above(result.f, first):
            return Nested().run(outer, q, monitor)
        before = monitor.budget.iterations
        last = end if status is Status.ITERATION_LIMIT else self._finished(outer, end, monitor)
        if last is not end:
            return Outcome(outer, last, status, details=(NewtonSteps(monitor.budget.iterations - before),))
        return Outcome(outer, end, status, own=_own(outer, end, program, result))

    def minimised(self, outer: Outer, q: Array, track: Track) -> tuple[Relocation, NLPResult]:
        """The energy NLP, and where Ipopt ends from outer variables ``q`` and the contact solution there."""
        contact, objective = outer.energy(q), outer.objective
        areas = outer.relocation.n_valid > 0 or objective.has_barrier
        unit, length = half_energy(contact) if areas else pull(contact.gradient), _length(contact)
        with track.monitor.budget.during("build"):
            program = outer.relocation
            if length != 1:
                program = relocation(outer.discretisation, objective, length)
            options = self.options(areas, unit, objective.has_barrier)
            solver = Solver(program.nlp, options=options, monitor=track)
        track.residual = lambda x, lam_g: outer.residual.of_state(
            *program.split(x)[:2], *program.forces(lam_g)
        )
        begin = outer.relocation.split(outer.energy.unknowns(q, contact.equilibrium.u))
        result = solver(program.unknowns(*begin))
        track.with_violations(result.history["inf_pr"])
        return program, result

    def _finished(self, outer: Outer, q: Array, monitor: Monitor) -> Array:
        """Newton steps from where an interior point stopped, if a stationary point is near; else ``q``.

        An interior point meets weakly active move limits to the square root of its tolerance only, and
        rounding can hold the multipliers of many least areas off it. Newton's method on the reduced energy
        then takes one to five steps, kept if the first-order residual falls and the energy does not rise.
        """
        energy, measure = outer.energy, outer.residual
        if not q.size or energy.relocation.objective.has_barrier or not outer.is_valid(q):
            return q
        residual, value = measure(energy(q)), energy(q).value
        if not outer.tolerance < residual <= NEAR:
            return q
        outcome = Nested(iterations=STEPS).run(outer.near(), q, monitor)
        if not (outer.is_valid(outcome.q) and energy.is_defined(outcome.q)):
            return q
        point = energy(outcome.q)
        better = measure(point) < residual and point.value <= value + RISE * abs(value)
        return outcome.q if better else q


def build(problem: ContactProblem) -> NLP:
    """The symbolic NLP in ``x = (q, u, s)``, see :mod:`rmesh_nlp.models.energy_nlp`.

    Extend it with :meth:`rmesh_nlp.optimize.nlp.NLP.extended`, or hand ``x``, ``f`` and ``g`` to any
    CasADi solver.
    """
    return relocation(problem).nlp


def is_above(energy: float, start: float) -> bool:
    """Whether an end is above the start, whose valley a barrier may leave."""
    return energy > start + ROUNDING * abs(start)


def _own(outer: Outer, q: Array, program: Relocation, result: NLPResult) -> Equilibrium:
    """The program's own displacement, and contact forces: the multipliers of its gaps and slips."""
    (_, u, _), (normal, friction) = program.split(result.x), program.forces(result.lam_g)
    tangential = np.zeros(program.n_contact if program.n_s else 0)
    tangential[program.friction_rows] = friction
    active = ActiveSet(normal > 0, np.sign(tangential).astype(np.int8))
    system = outer.contact.system_at(q)
    return Equilibrium(u, system.energy(u), normal, tangential, active, Status.CONVERGED, 0)


def _length(contact: ReducedPoint) -> float:
    """The largest displacement if it is far from one, as Ipopt's tolerances are absolute; else 1."""
    length = float(np.max(np.abs(contact.equilibrium.u)))
    return 1.0 if length == 0 or ORDINARY[0] <= length <= ORDINARY[1] else length


def pull(gradient: Array) -> float:
    """The unit of the objective in which a barrier of order one suits the outer variables.

    Three times the mean of the gradient in the outer variables; 1 where nothing pulls. For the energy it
    falls like the gain per node, by a factor near 20 with every halving of the mesh size, while
    Ipopt's barrier and tolerances are absolute.
    """
    return 3 * float(np.mean(np.abs(gradient))) if np.any(gradient) else 1.0


def half_energy(point: ReducedPoint) -> float:
    """Half the size of the energies in a contact solution, which may cancel in their sum; 1 where all vanish.

    Ipopt's tolerances and barrier are absolute. Of 1, 2, 5 and 10 parts of the energy two gave the
    least iterations and energies on the examples and the gallery.
    """
    u = point.equilibrium.u
    return 0.5 * max(abs(point.value), 0.5 * float(u @ (point.system.stiffness @ u))) or 1.0
