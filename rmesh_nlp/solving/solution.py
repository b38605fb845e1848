"""What a solve returns: the assessment of where it ended, how it got there, and the record of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from skfem import MeshTri

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.display import Rows, Shown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.entries import written
from rmesh_nlp.solving.parts import Certificate, Constrained, Step, Work, plain
from rmesh_nlp.solving.refinement import ReducedError, SurvivingGain
from rmesh_nlp.solving.summary import summary
from rmesh_nlp.solving.verification import error_terms

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Shown):
    """A relocated mesh with its contact solution, as it was assessed, and how it was found.

    Attributes
    ----------
    assessment : Assessment
        The mesh as given and the final one, measured and compared.
    formulation : str
    history : tuple of Step
    iterations : int
    work : Work
    contact_time_s : float
        One cold contact solve on the initial mesh with its assembly, the unit of cost.
    build_time_s, solve_time_s, audit_time_s : float
        Wall time by the one clock of all formulations (:class:`rmesh_nlp.optimize.budget.Budget`).
    start : str
        "given", "random", "positions", or the formulation whose solution was the start.
    settings : dict
        Settings that differ from the defaults of the formulation.
    seed : int or None
    limits : Limits
    safe : str, optional
        What followed an exploited end.
    chosen_by, chosen : str, optional
        Who chose the formulation, and why.
    details : mapping of str to object
        What the formulation adds to the record.
    reduced_error : ReducedError
        By how much the error of the energy fell, where ``auto`` chose.
    surviving_gain : SurvivingGain, optional
        What refined meshes leave of a gain in another objective than the energy.
    certificate : Certificate, optional
        Bounds of the error, if they were asked for.
    certificate_remark : str, optional
        Why there is none although it was asked for.
    is_interrupted : bool
        Whether Ctrl-C stopped the solve, or what follows the assessment.
    """

    assessment: Assessment
    formulation: str = ""
    history: tuple[Step, ...] = ()
    iterations: int = 0
    work: Work = Work()  # noqa: RUF009 frozen
    contact_time_s: float = float("nan")
    build_time_s: float = 0.0
    solve_time_s: float = 0.0
    audit_time_s: float = 0.0
    start: str = "given"
    settings: dict[str, Any] = field(default_factory=dict)
    seed: int | None = None
    limits: Limits = Limits()  # noqa: RUF009 frozen
    safe: str | None = None
    chosen_by: str | None = None
    chosen: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    reduced_error: ReducedError = ReducedError()  # noqa: RUF009 frozen
    surviving_gain: SurvivingGain | None = None
    certificate: Certificate | None = field(default=None, repr=False)
    certificate_remark: str | None = None
    is_interrupted: bool = False

    @property
    def valid(self) -> bool:
        """Whether the contact problem is solved on the final mesh, and no proven bound contradicts it."""
        return self.assessment.valid and not self._is_disproved

    @property
    def success(self) -> bool:
        """Valid and not worse than the mesh as given, see :mod:`rmesh_nlp.solving.assessment`."""
        return self.assessment.success and not self._is_disproved

    @property
    def status(self) -> Status:
        """That of the assessment, unless Ctrl-C stopped the solve or a proven bound is violated."""
        if self.is_interrupted:
            return Status.INTERRUPTED
        return Status.INACCURATE if self._is_disproved else self.assessment.status

    @property
    def message(self) -> str:
        """What the status means, and what to do about it."""
        assessment, detail = self.assessment, self.assessment.detail
        if self.is_interrupted and not self.success and assessment.status is not Status.INTERRUPTED:
            status = Status.INACCURATE if self._is_disproved else assessment.status
            detail = f"That point is no success, {status.value}: {status.message}"
        return f"{self.status.message} {detail}".strip()

    @property
    def _is_disproved(self) -> bool:
        return self.certificate is not None and self.certificate.is_disproved

    @property
    def problem(self) -> ContactProblem:
        """The problem that was solved last, with numbers in the place of design variables."""
        return self.assessment.final.problem

    @property
    def objective(self) -> str:
        """What was minimised."""
        return str(self.assessment.objective)

    @property
    def mesh(self) -> MeshTri:
        """The relocated mesh, boundaries named as before."""
        return self.assessment.final.mesh

    @property
    def initial_nodes(self) -> Array:
        """(2, nodes) positions before relocation, on the mesh of ``problem``: the given one or a new one."""
        return self.assessment.final.before

    @property
    def displacement(self) -> Array:
        """(components, nodes) of the contact solution, in units of length."""
        return self.assessment.final.displacement

    @property
    def pressure(self) -> Array:
        """(nodes,) contact pressure in N/m^2, >= 0."""
        return self.assessment.final.pressure

    @property
    def tangential_stress(self) -> Array:
        """(nodes,) friction on the body in N/m^2, along the tangent."""
        return self.assessment.final.tangential_stress

    @property
    def contact(self) -> dict[str, dict[str, float]]:
        """Forces, peak pressure and length of the contact, by contact boundary and name of the result.

        ``force_x``, ``force_y`` and ``moment`` (about the origin) are those of the foundation on the body,
        pressure and friction together.

        On the final mesh, with ``_initial`` on the given one, and with ``_refined`` where its refinement was
        solved.
        """
        final = self.assessment.final.contact
        meshes = {
            "_initial": self.assessment.given.contact,
            "": final,
            "_refined": self.reduced_error.contact,
        }
        return {
            boundary: {
                name + suffix: getattr(of[boundary], name)
                for name, value in vars(result).items()
                for suffix, of in meshes.items()
                if boundary in of and value is not None
            }
            for boundary, result in final.items()
        }

    @property
    def energy(self) -> float:
        """J of the contact solution by the problem's own rules."""
        return self.assessment.final.energy

    @property
    def energy_initial(self) -> float:
        """The same on the mesh as given."""
        return self.assessment.given.energy

    @property
    def energy_audited(self) -> float:
        """J of the continuous problem, of an admissible displacement: the energy that is compared."""
        return self.assessment.final.energy_audited

    @property
    def energy_initial_audited(self) -> float:
        """The same on the mesh as given."""
        return self.assessment.given.energy_audited

    @property
    def gain(self) -> float:
        """Decrease of the energy by the problem's own rules."""
        return self.assessment.gain

    @property
    def gain_audited(self) -> float:
        """Decrease of the audited energy."""
        return self.assessment.gain_audited

    @property
    def design(self) -> Mapping[str, float]:
        """Design variables by their names."""
        return self.assessment.final.design

    @property
    def designed(self) -> ContactProblem | None:
        """The problem with its design variables, where it has any."""
        return self.assessment.designed

    @property
    def constraints(self) -> Mapping[str, Constrained]:
        """What the problem constrains, by the texts."""
        return self.assessment.final.constraints

    @property
    def multipliers(self) -> Multipliers | None:
        """Of move limits, areas and angles; where they are large, position or connectivity is the limit."""
        return self.assessment.first_order.multipliers

    @property
    def stationarity(self) -> str:
        """The label "KKT" or that of an MPCC (W, C, M, S, B); empty where there is none."""
        return self.assessment.first_order.stationarity

    @property
    def stationarity_residual(self) -> float:
        """First-order residual of the outer problem, relative to that on the mesh as given."""
        return self.assessment.first_order.residual

    @property
    def error_reduction(self) -> ErrorReduction | None:
        """By how much the error of the energy fell, where ``auto`` chose: as proved, else as estimated."""
        estimated, certificate = self.reduced_error.reduction, self.certificate
        return estimated if estimated is None or certificate is None else certificate.of_reduction(estimated)

    @property
    def contact_solves(self) -> int:
        """Contact solves of the formulation."""
        return self.work.contact_solves

    @property
    def wall_time_s(self) -> float:
        """Build, solve and audit."""
        return self.build_time_s + self.solve_time_s + self.audit_time_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is suspicious about the problem, the mesh, or the gain."""
        surviving = () if self.surviving_gain is None else self.surviving_gain.warnings
        return (*self.assessment.warnings, *self.reduced_error.warnings, *surviving)

    def record(self) -> dict[str, Any]:
        """The entries of :mod:`rmesh_nlp.solving.entries` as plain JSON values. NaN becomes None."""
        terms, seconds = self._error_terms
        timed = replace(self, audit_time_s=self.audit_time_s + seconds)
        return plain({**written(timed), **terms, **self.details, **self.assessment.first_order.label})

    @cached_property
    def _error_terms(self) -> tuple[dict[str, float], float]:
        """The terms of Theorem 4.1 and the seconds that they take, which only a record is worth."""
        if self.problem.exact is None or not self.assessment.final.min_area_ratio > 0:
            return {}, 0.0
        watch = Budget()
        return error_terms(self.problem, self.mesh.p), watch.elapsed

    def plot(self, what: str = "mesh", axes: Axes | None = None, **style: Any) -> Axes:
        """Draw a field of the solution on the relocated mesh.

        Parameters
        ----------
        what : "mesh", "displacement", "stress" or "pressure"
            The mesh over the given one; the displacement or its size; von Mises' stress or the
            size of the flux; the pressure along the contact boundary.
        axes : matplotlib Axes, optional
            Where to draw; a new figure by default.
        style
            Keywords of matplotlib's function that draws, such as ``cmap`` or ``color``.
        """
        from rmesh_nlp.solving import plotting  # matplotlib takes a while to load

        X = self.mesh.p
        return plotting.plot(self.problem, X, self.displacement, self.pressure, what, axes, **style)

    def summary(self) -> Rows:
        """Status, what was minimised, and measured residuals, as (label, value) rows for people."""
        return summary(self)

    @property
    def title(self) -> str:
        """What it is, for people."""
        return f"Solution of {self.problem.name!r} by {self.formulation}"
