"""The mesh as given and the mesh where a formulation ended, compared: what is called a success, and why.

Valid
    The contact problem is solved on both meshes: equilibrium and complementarity hold, no element is
    inverted, the constraints of the problem hold, and every figure is a number. Where the solver met its
    own test, the displacement and the forces that it found hold too.
Improved
    The minimised objective, measured by the assessment, is not above its value on the mesh as given. The
    energy is the continuous one of an admissible displacement (:mod:`rmesh_nlp.assessment.admissible`).
    Nor is the energy of the displacement in the files above both energies on the mesh as given, that of the
    contact solution and the continuous one: a minimiser of a barrier may lie above its start.
Stationary
    The first-order residual of the outer problem (:mod:`rmesh_nlp.models.residual`) is at most the
    tolerance of the solve.

A success is valid and improved, also if a limit stopped the solve, unless an accuracy was not reached.
Converged is a success that is stationary, whatever the solver said. A status never contradicts that: where a
solver failed after it had found a better mesh, the mesh is a success, its status is STALLED, and the solver's
own word is kept beside.
A valid solution whose own energy fell while the continuous one rose is EXPLOITED: the optimiser has found an
error of the discretisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from rmesh_nlp.assessment.measures import ContactResiduals
from rmesh_nlp.evaluation import ROUNDING, difference
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.first_order import MET, FirstOrder
from rmesh_nlp.solving.state import State

FAILURES = (
    Status.INFEASIBLE,
    Status.UNBOUNDED,
    Status.TOO_FEW_FREEDOMS,
    Status.EVALUATION_ERROR,
    Status.FAILED,
)
"""Ends of a solver that say nothing for the point where it stopped: only a gain makes that a success."""

LIMITS = (Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.INTERRUPTED, Status.STALLED)
"""Ends of a solver that leave the point where it stopped usable. Every other end is a failure."""

EXPLOITED = {
    "quadrature": "The rule for the loads is too coarse: take a higher degree.",
    "penetration": "Between its nodes the body passes into the foundation: take {remedy}.",
    "friction": "The friction bound varies within edges.",
    "geometry": "The edges along a curve have grown.",
}
"""What the message of an exploited solution adds."""


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """Two states compared.

    Attributes
    ----------
    given, final : State
        ``given`` is the mesh of the problem; ``final`` is that mesh with its nodes moved, or a new one.
    first_order : FirstOrder
        At the end.
    solver_status : Status
        How the solver says that it ended.
    own_residuals : ContactResiduals
        Of the displacement and the forces that the formulation itself found.
    objective : Objective
    is_same_mesh : bool
        Whether ``given`` and ``final`` have the same triangles.
    tolerance : float
        Of the first-order residual.
    designed : ContactProblem or None
        The problem with its design variables, where it has any.
    domain_area_change : float, optional
        Relative, where nodes slide along curves.
    warnings : tuple of str
    lacks : str
        What was asked for and not reached, as a sentence.
    """

    given: State
    final: State
    first_order: FirstOrder
    solver_status: Status
    own_residuals: ContactResiduals
    objective: Objective
    is_same_mesh: bool
    tolerance: float
    designed: ContactProblem | None = field(default=None, repr=False)
    domain_area_change: float | None = None
    warnings: tuple[str, ...] = ()
    lacks: str = ""

    @property
    def is_audited(self) -> bool:
        """Whether the energies of the continuous problem were measured."""
        return self.final.continuous is not None

    @property
    def gain(self) -> float:
        """Decrease of the energy by the problem's own rules."""
        return difference(self.given.energy, self.final.energy)

    @property
    def gain_audited(self) -> float:
        """Decrease of the energy of the continuous problem."""
        return difference(self.given.energy_audited, self.final.energy_audited)

    @property
    def gain_computed(self) -> float:
        """Decrease to the energy by the problem's own rules, from the larger of both on the given mesh."""
        return max(self.given.energy, self.given.energy_audited) - self.final.energy

    @property
    def decrease(self) -> float:
        """Decrease of what is minimised, audited; terms in the positions of two meshes do not compare."""
        if self.objective.collapses and not self.is_same_mesh:
            return self.gain_audited
        return self.given.objective_audited - self.final.objective_audited

    @property
    def rounding(self) -> float:
        """Change of what is minimised that is none."""
        return ROUNDING * max(self.given.size, self.final.size)

    @property
    def corrections(self) -> dict[str, float]:
        """What the continuous energy rose by beyond the problem's own, by the names in ``EXPLOITS``."""
        before = self.given.corrections
        return {name: value - before[name] for name, value in self.final.corrections.items()}

    @property
    def costliest(self) -> str:
        """The correction that costs most; empty where none is known."""
        corrections = self.corrections
        return max(corrections, key=lambda name: corrections[name], default="")

    @property
    def fault(self) -> Status | None:
        """Why the solution is not valid; None if it is."""
        given, final = self.given, self.final
        if not final.min_area_ratio > 0:
            return Status.INVALID_MESH
        for state in (given, final):
            if state.contact_status is not Status.CONVERGED:
                return state.contact_status
        if not final.residuals.hold:
            return Status.INACCURATE
        audited = (self.gain_audited, self.decrease, self.rounding) if self.is_audited else ()
        figures = self.gain, *audited, final.violation
        if not all(map(math.isfinite, figures)):
            return Status.EVALUATION_ERROR
        if final.violation > 0:
            return Status.VIOLATED
        return Status.INACCURATE if self.solver_status in MET and not self.own_residuals.hold else None

    @property
    def valid(self) -> bool:
        """Whether the contact problem is solved on the final mesh."""
        return self.fault is None

    @property
    def is_exploited(self) -> bool:
        """Whether the energy fell by the problem's own rules only."""
        fell = self.gain >= -self.rounding
        return self.objective.collapses and fell and self.gain_audited < -self.rounding

    @property
    def improved(self) -> bool:
        """Whether the minimised objective is not above its value on the given mesh, up to rounding.

        A point that obeys the constraints is better than a start that does not, whatever the objective.
        """
        if not self.is_audited:
            return False
        if self.final.min_area_ratio > 0 and self.given.violation > 0:
            return True
        rose = self.objective.collapses and self.gain_computed < -self.rounding
        return self.decrease >= -self.rounding and not rose and not self.is_exploited

    @property
    def status(self) -> Status:
        """What follows, whatever the solver said.

        - The status is CONVERGED if and only if the solution is a success and stationary.
        - What is valid and was not audited is UNAUDITED.
        - What is valid and improved is a success, unless the solver failed and nothing was gained: then the
          status is one of ``FAILURES``.
        - What is valid but not improved is EXPLOITED or WORSE, and the status of what is not valid names the
          fault.
        """
        if self.fault is not None:
            return self.fault
        if not self.is_audited:
            return Status.UNAUDITED
        if not self.improved:
            return Status.EXPLOITED if self.is_exploited else Status.WORSE
        if self.first_order.is_stationary:
            return Status.CONVERGED
        if self.solver_status in MET:
            return Status.NOT_STATIONARY
        if self.solver_status in LIMITS:
            return self.solver_status
        if self.decrease > self.rounding:  # failed on the way from a better mesh
            return Status.STALLED
        return self.solver_status if self.solver_status in FAILURES else Status.FAILED

    @property
    def success(self) -> bool:
        """Valid and improved, nothing lacks, and the solver did not fail where it began."""
        usable = Status.CONVERGED, Status.NOT_STATIONARY, *LIMITS
        return not self.lacks and self.valid and self.improved and self.status in usable

    @property
    def detail(self) -> str:
        """What the status leaves open, such as the degree of quadrature to take."""
        if self.status is Status.UNAUDITED:
            return f"The solver says: {self.solver_status.message}"
        if self.status is Status.EXPLOITED:
            is_kept_off = with_edge_gaps(self.final.problem) is self.final.problem
            remedy = "smaller elements there" if is_kept_off else "gap = 'edge'"
            return EXPLOITED.get(self.costliest, "").format(remedy=remedy)
        if self.status is Status.VIOLATED:
            broken = {
                text: constrained
                for text, constrained in self.final.constraints.items()
                if constrained.violation > self.tolerance
            }
            return "; ".join(f"{text} = {constrained.in_words()}" for text, constrained in broken.items())
        return self.lacks

    @property
    def message(self) -> str:
        """What the status means, and what to do about it."""
        return f"{self.status.message} {self.detail}".strip()
