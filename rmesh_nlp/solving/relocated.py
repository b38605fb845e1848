"""What a solve found: the assessment of where it ended, and how it got there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from skfem import MeshTri

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.residual import OuterMultipliers
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import ByName, Values
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.parts import Certificate, Constrained, Step, Trace
from rmesh_nlp.solving.refinement import ReducedError, SurvivingGain
from rmesh_nlp.solving.state import State
from rmesh_nlp.solving.verification import error_terms


@dataclass(frozen=True, kw_only=True, repr=False)
class Relocated:
    """A relocated mesh with its contact solution, as it was assessed, and how it was found.

    Attributes
    ----------
    assessment : Assessment
        The mesh as given and the final one, measured and compared.
    trace : Trace
        Steps, work and seconds of the solve.
    formulation : str
        Its name.
    start : str
        "given", "random", "positions", or the formulation whose solution was the start.
    settings : dict
        Settings that differ from the defaults of the formulation.
    seed : int or None
        Of random node positions, where the solve began there.
    limits : Limits
        Seconds and iterations that it was given.
    safe : str, optional
        What followed an exploited end.
    chosen_by : str, optional
        Who chose the formulation.
    chosen : str, optional
        Why it was chosen.
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
    trace: Trace = Trace()  # noqa: RUF009 frozen
    formulation: str = ""
    start: str = "given"
    settings: Values = field(default_factory=dict)
    seed: int | None = None
    limits: Limits = Limits()  # noqa: RUF009 frozen
    safe: str | None = None
    chosen_by: str | None = None
    chosen: str | None = None
    details: ByName = field(default_factory=dict)
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
    def given(self) -> State:
        """The mesh as given, measured."""
        return self.assessment.given

    @property
    def final(self) -> State:
        """The mesh where the solve ended, measured."""
        return self.assessment.final

    @property
    def history(self) -> tuple[Step, ...]:
        """The steps of all iterations."""
        return self.trace.steps

    @property
    def problem(self) -> ContactProblem:
        """The problem that was solved last, with numbers in the place of design variables."""
        return self.final.problem

    @property
    def objective(self) -> str:
        """What was minimised."""
        return str(self.assessment.objective)

    @property
    def mesh(self) -> MeshTri:
        """The relocated mesh, boundaries named as before."""
        return self.final.mesh

    @property
    def displacement(self) -> Array:
        """(components, nodes) of the contact solution, in units of length."""
        return self.final.displacement

    @property
    def contact(self) -> dict[str, dict[str, float]]:
        """Forces, peak pressure and length of the contact, by contact boundary and name of the result.

        ``force_x``, ``force_y`` and ``moment`` (about the origin) are those of the foundation on the body,
        pressure and friction together.

        On the final mesh, with ``_initial`` on the given one, and with ``_refined`` where its refinement was
        solved.
        """
        final = self.final.contact
        meshes = {
            "_initial": self.given.contact,
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
    def pairs(self) -> dict[str, list[str]]:
        """By the first of two boundaries in contact with each other the names of both."""
        pairs = [one for one in self.problem.obstacles if one.other and one.place != one.boundary]
        return {str(one.boundary): [str(one.boundary), one.other] for one in pairs}

    @property
    def tools(self) -> dict[str, dict[str, list[float]]]:
        """Displacement of each foundation that moves, and its force on the body, by contact boundary."""
        contact = self.final.contact
        obstacles = self.final.placed.obstacles if contact else ()
        return {
            name: {
                "displacement": list(obstacle.displacement),
                "force": [result.force_x or 0.0, result.force_y or 0.0],
            }
            for (name, result), obstacle in zip(contact.items(), obstacles, strict=True)
            if obstacle.displacement is not None
        }

    @property
    def energy(self) -> float:
        """J of the contact solution by the problem's own rules."""
        return self.final.energy

    @property
    def energy_initial(self) -> float:
        """``energy`` on the mesh as given."""
        return self.given.energy

    @property
    def energy_audited(self) -> float:
        """J of the continuous problem, of an admissible displacement: the energy that is compared."""
        return self.final.energy_audited

    @property
    def energy_initial_audited(self) -> float:
        """``energy_audited`` on the mesh as given."""
        return self.given.energy_audited

    @property
    def design(self) -> Mapping[str, float]:
        """Design variables by their names."""
        return self.final.design

    @property
    def constraints(self) -> Mapping[str, Constrained]:
        """What the problem constrains, by the texts."""
        return self.final.constraints

    @property
    def multipliers(self) -> OuterMultipliers | None:
        """Of move limits, areas and angles; where they are large, position or connectivity is the limit."""
        return self.assessment.first_order.multipliers

    @property
    def error_reduction(self) -> ErrorReduction | None:
        """By how much the error of the energy fell, where ``auto`` chose: as proved, else as estimated."""
        estimated, certificate = self.reduced_error.reduction, self.certificate
        return estimated if estimated is None or certificate is None else certificate.of_reduction(estimated)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is suspicious about the problem, the mesh, or the gain."""
        surviving = () if self.surviving_gain is None else self.surviving_gain.warnings
        return (*self.assessment.warnings, *self.reduced_error.warnings, *surviving)

    @cached_property
    def error_terms(self) -> tuple[dict[str, float], float]:
        """The terms of Theorem 4.1 and the seconds that they take, which only a record is worth."""
        if self.problem.exact is None or not self.final.min_area_ratio > 0:
            return {}, 0.0
        watch = Budget()
        return error_terms(self.problem, self.mesh.p), watch.elapsed
