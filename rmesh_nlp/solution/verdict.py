"""What a solution is worth: valid, improved, stationary, and the status that says it in one word.

Valid
    The contact problem is solved on the final mesh: equilibrium and complementarity hold to ``TOLERANCE``,
    no element is inverted, the penetration between contact nodes is bounded, and for the energy the
    gain is confirmed by the audit and is not penetration for the larger part.
Improved
    The minimised objective, by the rule of the audit, is not above its value on the mesh as given.
Stationary
    The first-order residual of the outer problem (:mod:`rmesh_nlp.programs.residual`) is at most the
    tolerance of the solve.

A success is valid and improved, also if a limit stopped the solve. Converged is a success that is
stationary, whatever the solver said. A status never contradicts that: where a solver failed after it had
found a better mesh, the mesh is a success, its status is STALLED, and the solver's own word is kept beside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solution.audit import TOLERANCE, Audit

GAIN_AGREEMENT = 0.1
"""Largest difference of the gains by the problem's own rule and the audit's, relative to the larger."""

ROUNDING = 1e-9
"""Part of the objective's size below which differences of it are rounding."""

MOST = 0.5
"""Part of a gain from which on it is not a gain if penetration between contact nodes is worth that much."""

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
    """What the referee has measured.

    Attributes
    ----------
    audit : Audit
    contact : Status
        Of the contact solves on the given and the final mesh, by the rules of the problem and of the
        audit: CONVERGED if all of them have.
    consistent : bool
        Whether the strategy's own energy is that of the contact solve.
    gain, gain_audited : float
        Decrease of the energy by the problem's own rule and by that of the audit.
    decrease : float
        Decrease of the minimised objective by the rule of the audit.
    size : float
        Size of the minimised objective, in units of which ``ROUNDING`` is.
    is_energy : bool
        Whether the energy is minimised.
    stationary : bool
    penetrated : float
        Increase of the energy that penetration between contact nodes is worth,
        :func:`rmesh_nlp.contact.penetration.penetration_work`, from the given mesh to the final one.
    penetrated_given : float
        The same on the given mesh.
    """

    audit: Audit
    contact: Status
    consistent: bool
    gain: float
    gain_audited: float
    decrease: float
    size: float
    is_energy: bool
    stationary: bool
    penetrated: float = 0.0
    penetrated_given: float = 0.0

    @property
    def is_known(self) -> bool:
        """Whether every figure that the verdict compares is a number."""
        figures = (self.gain, self.gain_audited, self.decrease, self.size, self.penetrated)
        return all(math.isfinite(figure) for figure in figures)

    @property
    def is_penetration(self) -> bool:
        """Whether most of the gain is penetration between contact nodes, not accuracy."""
        return self.is_energy and self.penetrated > max(MOST * self.gain, ROUNDING * self.size)

    @property
    def exploited(self) -> bool:
        """Whether the gain is one of the quadrature rule to more than a tenth."""
        larger = max(abs(self.gain), abs(self.gain_audited))
        wrong = not abs(self.gain - self.gain_audited) <= GAIN_AGREEMENT * larger
        return self.is_energy and wrong and larger > ROUNDING * self.size

    @property
    def fault(self) -> Status | None:
        """Why the solution is not valid; None if it is."""
        audit = self.audit
        if not audit.min_area_ratio > 0:
            return Status.INVALID_MESH
        if self.contact is not Status.CONVERGED:
            return self.contact
        if not max(audit.equilibrium_residual, audit.complementarity_residual) <= TOLERANCE:
            return Status.INACCURATE
        if not self.is_known:
            return Status.EVALUATION_ERROR
        if not audit.penetration_excess <= 1:
            return Status.PENETRATION
        if self.exploited:
            return Status.QUADRATURE_EXPLOITED
        return Status.PENETRATION_EXPLOITED if self.is_penetration else None

    @property
    def improved(self) -> bool:
        """Whether the minimised objective is not above its value on the given mesh, up to rounding."""
        return self.decrease >= -ROUNDING * self.size


@dataclass(frozen=True)
class Verdict:
    """Three things apart, and what follows from them.

    Whatever was measured, and whatever the solver said,

    - a success is valid and improved, and its status is CONVERGED, NOT_STATIONARY or one of ``LIMITS``;
    - the status is CONVERGED if and only if the solution is a success and stationary;
    - what is valid and improved is a success, unless the solver failed and nothing was gained: then the
      status is one of ``FAILURES``;
    - what is valid but not improved is WORSE, and the status of what is not valid names the fault.
    """

    valid: bool
    improved: bool
    stationary: bool
    success: bool
    status: Status


def verdict(said: Status, measured: Measured) -> Verdict:
    """Judge what was measured; ``said`` is how the solver says that it ended."""
    fault, improved, stationary = measured.fault, measured.improved, measured.stationary
    if fault is None and said in MET and not measured.consistent:
        fault = Status.INACCURATE
    if fault is not None or not improved:
        return Verdict(fault is None, improved, stationary, False, fault or Status.WORSE)
    if stationary:
        return Verdict(True, True, True, True, Status.CONVERGED)
    if said in MET:
        return Verdict(True, True, False, True, Status.NOT_STATIONARY)
    if said in LIMITS:
        return Verdict(True, True, False, True, said)
    if measured.decrease > ROUNDING * measured.size:  # the solver failed on the way from a valid, better mesh
        return Verdict(True, True, False, True, Status.STALLED)
    return Verdict(True, True, False, False, said if said in FAILURES else Status.FAILED)
