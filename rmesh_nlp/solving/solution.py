"""What a solve returns: the assessment of where it ended, how it got there, and the record of both."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table
from skfem import MeshTri

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.contact.factorisation import HAS_CHOLMOD
from rmesh_nlp.display import Rows, html_table, plain_table, rich_table
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.mmg import is_available
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.optimize.budget import Limits
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.parts import (
    Certificate,
    Choices,
    Constrained,
    Part,
    Step,
    Work,
    entries,
    plain,
)
from rmesh_nlp.solving.refinement import ReducedError, SurvivingGain
from rmesh_nlp.solving.summary import summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True)
class Solution:
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
    choices : Choices
    details : tuple of Part
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
    choices: Choices = Choices()  # noqa: RUF009 frozen
    details: tuple[Part, ...] = ()
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
    def initial_areas(self) -> Array:
        """(elements,) areas of the triangles before relocation."""
        return signed_areas(self.initial_nodes, self.problem.triangles)

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
        """By how much the error of the energy fell, where ``auto`` chose."""
        return self.reduced_error.reduction

    @property
    def contact_solves(self) -> int:
        """Contact solves of the formulation."""
        return self.work.contact_solves

    @property
    def wall_time_s(self) -> float:
        """Build, solve and audit."""
        return self.build_time_s + self.solve_time_s + self.audit_time_s

    @property
    def extra(self) -> dict[str, Any]:
        """The entries of the record that not every solution has."""
        extra = entries(*self.details, self.reduced_error.attained)
        extra |= self._measured_record()
        extra |= entries(self.assessment.first_order.label, self.choices, self.work)
        if changed := self.limits.changed():
            extra["limits"] = changed
        if self.certificate is not None:
            extra |= self.certificate.record()
        elif self.certificate_remark is not None:
            extra["certificate_remark"] = self.certificate_remark
        if self.error_reduction is not None:
            estimated, proved = self.error_reduction.record(), self.certificate
            extra["error_reduction"] = estimated if proved is None else proved.of_reduction(estimated)
        return extra

    def _measured_record(self) -> dict[str, Any]:
        """What was measured beside the energies; nothing of a mesh with inverted elements."""
        assessment, given, final = self.assessment, self.assessment.given, self.assessment.final
        if final.point is None:
            return {}
        always = {
            "tolerance": assessment.tolerance,
            "own_equilibrium_residual": assessment.own_residuals.equilibrium,
            "own_complementarity_residual": assessment.own_residuals.complementarity,
            "assessed_equilibrium_residual": final.residuals.equilibrium,
            "assessed_complementarity_residual": final.residuals.complementarity,
            "exploits": assessment.costliest if assessment.is_exploited else None,
            "warnings": list(self.warnings),
            "objective_value": final.objective,
        }
        optional = {
            "sticking_nodes": final.sticking_nodes,
            "sliding_nodes": final.sliding_nodes,
            "objective_initial": given.objective if assessment.is_same_mesh else None,
            "domain_area_change": assessment.domain_area_change,
            "gain_surviving": None if self.surviving_gain is None else self.surviving_gain.share,
            "coulomb_residual": final.coulomb_residual,
            "coulomb_residual_initial": given.coulomb_residual,
        }
        record = always | {name: value for name, value in optional.items() if value is not None}
        if given.quantities is not None and final.quantities is not None:
            record |= given.quantities.entries("_initial") | final.quantities.entries()
            if self.reduced_error.quantities is not None:
                record |= self.reduced_error.quantities.entries("_refined")
        return record

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is suspicious about the problem, the mesh, or the gain."""
        surviving = () if self.surviving_gain is None else self.surviving_gain.warnings
        return (*self.assessment.warnings, *self.reduced_error.warnings, *surviving)

    def record(self) -> dict[str, Any]:
        """Everything a table needs, as plain JSON values. NaN becomes None."""
        problem, assessment, final = self.problem, self.assessment, self.assessment.final
        row = {
            "example": problem.name,
            **self._own("formulation", "objective"),
            "n": problem.size,
            "delta": problem.motion.delta_record(),
            "status": self.status.value,
            **self._own("success", "valid"),
            "improved": assessment.improved,
            "message": self.message,
            "solver_status": assessment.solver_status.value,
            **self._own("energy_initial", "energy", "energy_initial_audited", "energy_audited"),
            **self._own("gain", "gain_audited"),
            "u_min": float(self.displacement.min()),
            "u_max": float(self.displacement.max()),
            "min_area_ratio": final.min_area_ratio,
            **self._own("iterations", "contact_solves", "wall_time_s", "build_time_s", "solve_time_s"),
            **self._own("audit_time_s", "contact_time_s"),
            "equilibrium_residual": final.residuals.equilibrium,
            "complementarity_residual": final.residuals.complementarity,
            "penetration": final.penetration,
            **self._own("stationarity", "stationarity_residual"),
            "order": problem.order,
            "nodes": int(self.mesh.p.shape[1]),
            "triangles": int(self.mesh.t.shape[1]),
            "unknowns": int(np.sum(~DisplacementSpace.of(problem).given()[0])),
            "quadrature": problem.rule,
            "units": asdict(problem.units),
            "versions": versions(),
            **self._own("start", "settings", "seed"),
            **self._design_record(),
            **self.extra,
        }
        return {key: plain(value) for key, value in row.items()}

    def _design_record(self) -> dict[str, Any]:
        """Design variables at the end and at the start, their bounds, and what is constrained."""
        record: dict[str, Any] = {}
        if self.designed is not None:
            own = [variable for variable in self.designed.design if variable.name in self.design]
            record["design"] = dict(self.design)
            record["design_initial"] = {variable.name: variable.start for variable in own}
            record["design_bounds"] = {variable.name: list(variable.bounds) for variable in own}
        if self.constraints:
            record["constraints"] = {
                text: constrained.record() for text, constrained in self.constraints.items()
            }
        return record

    def _own(self, *names: str) -> dict[str, Any]:
        return {name: getattr(self, name) for name in names}

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

        X = np.asarray(self.mesh.p)
        return plotting.plot(self.problem, X, self.displacement, self.pressure, what, axes, **style)

    def summary(self) -> Rows:
        """Status, what was minimised, and measured residuals, as (label, value) rows for people."""
        return summary(self)

    def __rich__(self) -> Table:
        return rich_table(f"{self.problem.name!r} by {self.formulation}", self.summary())

    def __repr__(self) -> str:
        return plain_table(f"Solution of {self.problem.name!r} by {self.formulation}", self.summary())

    def _repr_html_(self) -> str:
        return html_table(f"{self.problem.name!r} by {self.formulation}", self.summary())


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the figures."""
    packages: tuple[str, ...] = ("rmesh-nlp", "casadi", "numpy", "scipy", "scikit-fem")
    if HAS_CHOLMOD:  # factors by CHOLMOD differ by rounding
        packages = (*packages, "scikit-sparse")
    if is_available():
        packages = (*packages, "mmgpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
