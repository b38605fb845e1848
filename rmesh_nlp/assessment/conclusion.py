"""What was measured of a solution, and the status that says it in one word.

Valid
    The contact problem is solved on the final mesh: equilibrium and complementarity hold to ``TOLERANCE``,
    no element is inverted, the constraints of the problem hold, and every figure is a number.
Improved
    The minimised objective, measured by the assessment, is not above its value on the mesh as given. The
    energy is the continuous one of an admissible displacement (:mod:`rmesh_nlp.assessment.admissible`).
    Nor is the energy of the displacement in the files above both energies on the mesh as given, the
    formulation's own and the continuous one: a minimiser of a barrier may lie above its start.
Stationary
    The first-order residual of the outer problem (:mod:`rmesh_nlp.models.residual`) is at most the
    tolerance of the solve.

A success is valid and improved, also if a limit stopped the solve. Converged is a success that is
stationary, whatever the solver said. A status never contradicts that: where a solver failed after it had
found a better mesh, the mesh is a success, its status is STALLED, and the solver's own word is kept beside.
A valid solution whose own energy fell while the continuous one rose is EXPLOITED: the optimiser has found an
error of the discretisation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rmesh_nlp.assessment.assessor import TOLERANCE, Audit
from rmesh_nlp.evaluation import ROUNDING
from rmesh_nlp.optimize.status import Status

FAILURES = (
    Status.INFEASIBLE,
    Status.UNBOUNDED,
    Status.TOO_FEW_FREEDOMS,
    Status.EVALUATION_ERROR,
    Status.FAILED,
)
"""Ends of a solver that say nothing for the point where it stopped: only a gain makes that a success."""

MET = (Status.CONVERGED, Status.ACCEPTABLE, Status.NOT_STATIONARY)
"""Ends of a solver that met a test of its own."""

LIMITS = (Status.ITERATION_LIMIT, Status.TIME_LIMIT, Status.INTERRUPTED, Status.STALLED)
"""Ends of a solver that leave the point where it stopped usable. Every other end is a failure."""


@dataclass(frozen=True)
class Measured:
    """What the assessment has measured."""

    audit: Audit
    contact: Status  # of all contact solves, on both meshes: CONVERGED if all of them have
    consistent: bool  # whether the formulation's own energy is that of the contact solve
    gain: float  # decrease of the energy by the formulation's own measure
    gain_audited: float  # decrease of the continuous energy
    gain_computed: float  # to the formulation's own energy, from the larger of both on the given mesh
    decrease: float  # of the minimised objective, measured by the assessment
    size: float  # of the minimised objective, in units of which ``ROUNDING`` is
    is_energy: bool  # whether the energy is minimised, perhaps with terms in the positions
    stationary: bool
    violation: float = 0.0  # of the constraints of the problem, if above the tolerance
    begins_violated: bool = False  # whether they are at the start
    # what the continuous energy rose by beyond the formulation's own, by the names in EXPLOITS
    corrections: Mapping[str, float] = field(default_factory=dict)

    @property
    def fault(self) -> Status | None:
        """Why the solution is not valid; None if it is."""
        audit = self.audit
        if not audit.min_area_ratio > 0:
            return Status.INVALID_MESH
        if self.contact is not Status.CONVERGED:
            return self.contact
        residuals = audit.equilibrium_residual, audit.complementarity_residual
        if not all(residual <= TOLERANCE for residual in residuals):  # also if one is no number
            return Status.INACCURATE
        figures = self.gain, self.gain_audited, self.decrease, self.size, self.violation
        if not all(map(math.isfinite, figures)):
            return Status.EVALUATION_ERROR
        return Status.VIOLATED if self.violation > 0 else None

    @property
    def improved(self) -> bool:
        """Whether the minimised objective is not above its value on the given mesh, up to rounding.

        A point that obeys the constraints is better than a start that does not, whatever the objective.
        """
        if self.begins_violated:
            return True
        rounding = ROUNDING * self.size
        rose = self.is_energy and self.gain_computed < -rounding
        return self.decrease >= -rounding and not rose and not self.is_exploited

    @property
    def is_exploited(self) -> bool:
        """Whether the energy fell by the formulation's own measure only."""
        rounding = ROUNDING * self.size
        return self.is_energy and self.gain_audited < -rounding and self.gain >= -rounding

    @property
    def costliest(self) -> str:
        """The correction that costs most; empty where none is known."""
        return max(self.corrections, key=lambda name: self.corrections[name], default="")

    @property
    def exploits(self) -> str:
        """The correction that costs most where the energy was exploited; empty elsewhere."""
        return self.costliest if self.is_exploited else ""


@dataclass(frozen=True)
class Conclusion:
    """Three things apart, and what follows from them, whatever was measured and whatever the solver said.

    - A success is valid and improved, and its status is CONVERGED, NOT_STATIONARY or one of ``LIMITS``.
    - The status is CONVERGED if and only if the solution is a success and stationary.
    - What is valid and improved is a success, unless the solver failed and nothing was gained: then the
      status is one of ``FAILURES``.
    - What is valid but not improved is EXPLOITED or WORSE, and the status of what is not valid names the
      fault.
    """

    valid: bool
    improved: bool
    stationary: bool
    success: bool
    status: Status


def conclusion(said: Status, measured: Measured) -> Conclusion:
    """What follows from the measurements; ``said`` is how the solver says that it ended."""
    fault = measured.fault
    if fault is None and said in MET and not measured.consistent:
        fault = Status.INACCURATE
    if fault is not None:
        status = fault
    elif not measured.improved:
        status = Status.EXPLOITED if measured.is_exploited else Status.WORSE
    elif measured.stationary:
        status = Status.CONVERGED
    elif said in MET:
        status = Status.NOT_STATIONARY
    elif said in LIMITS:
        status = said
    elif measured.decrease > ROUNDING * measured.size:  # failed on the way from a better mesh
        status = Status.STALLED
    else:
        status = said if said in FAILURES else Status.FAILED
    usable = Status.CONVERGED, Status.NOT_STATIONARY, *LIMITS
    success = fault is None and measured.improved and status in usable
    return Conclusion(fault is None, measured.improved, measured.stationary, success, status)
