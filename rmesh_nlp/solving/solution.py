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

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.assessor import Audit
from rmesh_nlp.assessment.conclusion import Measured
from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.contact.factorisation import HAS_CHOLMOD
from rmesh_nlp.display import Rows, html_table, plain_table, rich_table
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.mmg import is_available
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.clock import Limits
from rmesh_nlp.solving.parts import (
    Certificate,
    Choices,
    Constrained,
    ContactQuantities,
    Findings,
    Label,
    Part,
    Step,
    Work,
    entries,
    plain,
)
from rmesh_nlp.solving.summary import summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """What was measured of where a formulation ended; the defaults are those of an invalid mesh.

    Attributes
    ----------
    problem : ContactProblem
    objective : str
    mesh : skfem.MeshTri
        The relocated mesh, boundaries named as before.
    displacement : (components, nodes) array
        Values in units of length, at the vertices and of order 2 at the middles of edges.
    pressure : (nodes,) array
        Likewise: contact pressure in N/m^2, >= 0, zero off the contact boundary: nodal force over omega_i.
    tangential_stress : (nodes,) array
        Friction on the body in N/m^2, along the tangent; zero without friction.
    energy : float
        J(u) on the relocated mesh with the problem's own quadrature.
    energy_initial : float
        The same on the initial mesh.
    energy_initial_audited : float
        The same with the rule of the assessment.
    audit : Audit
    status : Status
    valid, improved, success : bool
        See :mod:`rmesh_nlp.assessment.conclusion`; a success is valid and improved.
    stationarity : str
        "KKT" or an MPCC label (W, C, M, S, B) where it was computed, else "".
    stationarity_residual : float
        First-order residual of the outer problem, relative to that on the mesh as given
        (:mod:`rmesh_nlp.models.residual`).
    solver_status : Status
        How the solver says that it ended; ``status`` is what the assessment says.
    initial_nodes : (2, nodes) array
        Positions before relocation, on the mesh of ``problem``: the given one, or a new one where the problem
        was remeshed or refined.
    initial_areas : (elements,) array
        Areas in the mesh as given of the triangles of the solution; one that it does not have counts as the
        mean of the given ones around its vertices.
    multipliers : Multipliers or None
        Of move limits, areas and angles; where they are large, position or connectivity is the limit.
    detail : str
        What the status leaves open, such as the degree of quadrature to take.
    measured : Measured or None
        What the status rests on; None where the contact problem could not be solved.
    assessed : tuple of Admissible, optional
        The admissible displacements on the given and on the last mesh.
    findings, quantities : optional
        None where the contact problem could not be solved; ``quantities`` also without contact.
    label : Label, optional
        Stationarity where contact is about to change, for other objectives than the energy.
    details : tuple of Part
        What the formulation adds to the record.
    design : mapping of str to float
        Design variables by their names; ``problem`` has these numbers in their place.
    designed : ContactProblem or None
        The problem with its design variables, where it has any.
    constraints : mapping of str to Constrained
        What the problem constrains, by the texts.
    """

    problem: ContactProblem
    objective: str
    mesh: MeshTri
    displacement: Array
    pressure: Array
    tangential_stress: Array
    energy: float = float("nan")
    energy_initial: float
    energy_initial_audited: float
    audit: Audit
    status: Status
    valid: bool = False
    improved: bool = False
    success: bool = False
    stationarity: str = ""
    stationarity_residual: float = float("nan")
    solver_status: Status
    initial_nodes: Array
    initial_areas: Array
    multipliers: Multipliers | None = None
    detail: str = ""
    measured: Measured | None = field(default=None, repr=False)
    assessed: tuple[Admissible, Admissible] | None = field(default=None, repr=False)
    findings: Findings | None = None
    quantities: ContactQuantities | None = None
    label: Label | None = None
    details: tuple[Part, ...] = ()
    design: Mapping[str, float] = field(default_factory=dict)
    designed: ContactProblem | None = field(default=None, repr=False)
    constraints: Mapping[str, Constrained] = field(default_factory=dict)

    @property
    def message(self) -> str:
        """What the status means, and what to do about it."""
        return f"{self.status.message} {self.detail}".strip()

    @property
    def gain(self) -> float:
        """Decrease of the energy by the problem's own rule."""
        return self.energy_initial - self.energy

    @property
    def gain_audited(self) -> float:
        """Decrease of the energy by the rule of the audit."""
        return self.energy_initial_audited - self.audit.energy_audited


@dataclass(frozen=True, kw_only=True)
class Solution(Assessment):
    """A relocated mesh with its contact solution, as it was assessed, and how it was found.

    Attributes
    ----------
    formulation : str
    history : tuple of Step
    iterations : int
    work : Work
    contact_time_s : float
        One cold contact solve on the initial mesh with its assembly, the unit of cost.
    build_time_s, solve_time_s, audit_time_s : float
        Wall time by the one clock of all formulations (:mod:`rmesh_nlp.solving.clock`).
    start : str
        "given", "random", "positions", or the formulation whose solution was the start.
    settings : dict
        Settings that differ from the defaults of the formulation.
    seed : int or None
    limits : Limits
    choices : Choices
    error_reduction : ErrorReduction, optional
        By how much the error of the energy fell, where ``auto`` chose.
    certificate : Certificate, optional
        Bounds of the error, if they were asked for.
    certificate_remark : str, optional
        Why there is none although it was asked for.
    """

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
    error_reduction: ErrorReduction | None = None
    certificate: Certificate | None = field(default=None, repr=False)
    certificate_remark: str | None = None

    @property
    def contact_solves(self) -> int:
        """Contact solves of the formulation."""
        return self.work.contact_solves

    @property
    def extra(self) -> dict[str, Any]:
        """The entries of the record that not every solution has."""
        extra = entries(*self.details, self.findings, self.quantities, self.label, self.choices, self.work)
        if changed := self.limits.changed():
            extra["limits"] = changed
        if self.certificate is not None:
            extra |= self.certificate.record()
        elif self.certificate_remark is not None:
            extra["certificate_remark"] = self.certificate_remark
        if self.error_reduction is not None:
            found = self.error_reduction.record()
            proved = self.certificate
            extra["error_reduction"] = found if proved is None else proved.of_reduction(found)
        return extra

    @property
    def wall_time_s(self) -> float:
        """Build, solve and audit."""
        return self.build_time_s + self.solve_time_s + self.audit_time_s

    def record(self) -> dict[str, Any]:
        """Everything a table needs, as plain JSON values. NaN becomes None."""
        problem = self.problem
        row = {
            "example": problem.name,
            **self._own("formulation", "objective"),
            "n": problem.size,
            "delta": problem.motion.delta_record(),
            "status": self.status.value,
            **self._own("success", "valid", "improved", "message"),
            "solver_status": self.solver_status.value,
            **self._own("energy_initial", "energy", "energy_initial_audited"),
            "energy_audited": self.audit.energy_audited,
            **self._own("gain", "gain_audited"),
            "u_min": float(self.displacement.min()),
            "u_max": float(self.displacement.max()),
            "min_area_ratio": self.audit.min_area_ratio,
            **self._own("iterations", "contact_solves", "wall_time_s", "build_time_s", "solve_time_s"),
            **self._own("audit_time_s", "contact_time_s"),
            "equilibrium_residual": self.audit.equilibrium_residual,
            "complementarity_residual": self.audit.complementarity_residual,
            "penetration": self.audit.penetration,
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
        entries: dict[str, Any] = {}
        if self.designed is not None:
            own = [one for one in self.designed.design if one.name in self.design]
            entries = {"design": dict(self.design), "design_initial": {one.name: one.start for one in own}}
            entries["design_bounds"] = {one.name: list(one.bounds) for one in own}
        if self.constraints:
            entries["constraints"] = {text: one.record() for text, one in self.constraints.items()}
        return entries

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
