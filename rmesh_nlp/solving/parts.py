"""The parts of a solution: what was counted, steps of its history, bounds of its error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np

from rmesh_nlp.assessment.error_reduction import ErrorReduction, by_certificate
from rmesh_nlp.display import Spans, bounds_in_words, figure, within_in_words
from rmesh_nlp.evaluation import Array
from rmesh_nlp.settings import Values


@dataclass(frozen=True)
class Work:
    """What is counted of a solve.

    Attributes
    ----------
    contact_solves, cold_contact_solves : int
        All, and those without the active set of a neighbour.
    contact_factorisations : int
        Of the stiffness.
    kkt_factorisations : int
        Of NLPs in positions and displacement together.
    """

    contact_solves: int = 0
    cold_contact_solves: int = 0
    contact_factorisations: int = 0
    kkt_factorisations: int = 0

    def __add__(self, other: Work) -> Work:
        return Work(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))


@dataclass(frozen=True)
class Constrained:
    """A constrained quantity: its value at the end, and its bounds, which may be infinite."""

    value: float
    lower: float
    upper: float

    @property
    def violation(self) -> float:
        """In units of the largest bound."""
        unit = max(abs(bound) for bound in (self.lower, self.upper) if np.isfinite(bound)) or 1.0
        return max(self.lower - self.value, self.value - self.upper, 0.0) / unit

    def record(self) -> dict[str, float | None]:
        """The three and the violation as JSON, where an infinite bound is null."""
        return {**plain(vars(self)), "violation": self.violation}

    def in_words(self) -> str:
        """For people."""
        return f"{figure(self.value)}, {bounds_in_words(self.lower, self.upper)}"


DESIGN = "design."
"""What stands before the name of a design variable in columns of histories and tables."""


FEW = 6
"""Design variables that lines and tables name beside each other, and that have a panel each in figures.

Of more, tables have a row for each, and figures one panel."""


@dataclass(frozen=True)
class Step:
    """One line of a history.

    Attributes
    ----------
    iteration : int
    energy : float
        Objective energy at the iterate; meaningful as J only where ``primal_residual`` is small. NaN, as is
        the objective, where an all-at-once solver passes through invalid elements.
    t : float
        Relaxation parameter of the complementarity: finite and positive while a relaxation acts, ``inf``
        where the complementarity is not imposed, 0 where it holds exactly (contact solves, the
        exact finish of ``mpcc``).
    primal_residual : float
        Constraint violation as the solver scales it; 0 where a contact solve is exact.
    dual_residual : float
        First-order residual of the outer problem, :mod:`rmesh_nlp.models.residual`; of an all-at-once
        solver at its own displacement and forces. NaN where it is not known: in the steps of ``mpcc`` with
        another objective than the energy, but for the last.
    contact_solves : int
        Contact solves so far; 0 for the all-at-once formulations.
    seconds : float
        Wall time since the start.
    q : array or None
        The outer variables, only in the steps that ``on_step`` receives: a history would be too large.
    objective : float
        The outer objective that is minimised; NaN where it is not known.
    product : float
        Largest product of the members of a complementarity pair, in the units of ``mpcc``; NaN where
        there are no pairs.
    biactive : float
        Number of pairs at the corner (both members at most ``2 sqrt(t)``, in the same units); NaN
        where there are no pairs.
    energy_given, objective_given : float
        Energy and objective on the mesh of this step before any node moved; for progress, and no part of a
        history.
    design : mapping of str to float
        Design variables at the iterate, by their names.
    said : str
        What progress shows in the place of energy and residual.
    """

    iteration: int
    energy: float
    t: float
    primal_residual: float
    dual_residual: float
    contact_solves: int
    seconds: float
    q: Array | None = field(default=None, repr=False, compare=False)
    objective: float = float("nan")
    product: float = float("nan")
    biactive: float = float("nan")
    energy_given: float = field(default=float("nan"), repr=False, compare=False)
    objective_given: float = field(default=float("nan"), repr=False, compare=False)
    design: Mapping[str, float] = field(default_factory=dict, repr=False, compare=False)
    said: str = field(default="", repr=False, compare=False)

    @property
    def stationarity(self) -> float:
        """``dual_residual`` by its name in records."""
        return self.dual_residual

    def row(self) -> Values:
        """The step as a line of a history: None where unknown, ``t`` may be ``inf``."""
        row: Values = plain({name: getattr(self, name) for name in HISTORY})
        row |= plain({DESIGN + name: value for name, value in self.design.items()})
        return {**row, "t": self.t} if np.isinf(self.t) else row


HISTORY = (*(one.name for one in fields(Step) if one.repr), "stationarity")
"""Columns of every history; those of design variables follow."""


@dataclass(frozen=True)
class Trace:
    """How a solve went.

    Attributes
    ----------
    steps : tuple of Step
        Of all iterations.
    iterations : int
    work : Work
    contact_time_s : float
        One cold contact solve on the initial mesh with its assembly, the unit of cost.
    build_time_s, solve_time_s, audit_time_s : float
        Wall time by the one clock of all formulations (:class:`rmesh_nlp.optimize.budget.Budget`).
    """

    steps: tuple[Step, ...] = ()
    iterations: int = 0
    work: Work = Work()
    contact_time_s: float = float("nan")
    build_time_s: float = 0.0
    solve_time_s: float = 0.0
    audit_time_s: float = 0.0

    @property
    def wall_time_s(self) -> float:
        """Build, solve and audit."""
        return self.build_time_s + self.solve_time_s + self.audit_time_s


def plain(value: Any) -> Any:
    """A value for JSON: numpy's as Python's, None for what is not finite, "?" for unpaired surrogates."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value.encode(errors="replace").decode() if isinstance(value, str) else value


class Bounds(NamedTuple):
    """Bounds of a quantity of the exact solution, infinite where there is none, and the computed value.

    They are bounds, not estimates, if ``guaranteed``: if both of the energy are. At least 95 % of a normal
    force acts in ``within``.
    """

    lower: float
    value: float
    upper: float
    guaranteed: bool
    within: Spans | None = None

    def nearest(self, value: float) -> float:
        """A value, or the bound that it violates if that is guaranteed."""
        return min(max(value, self.lower), self.upper) if self.guaranteed else value


@dataclass(frozen=True)
class Certificate:
    """Two-sided bounds of the least energy, and of the error of a solution.

    Attributes
    ----------
    lower, upper : float
        ``lower <= min J <= upper``, J the energy without any discretisation; ``upper`` is that of an
        admissible displacement on the mesh of the solution, with the doubt of its quadrature. On curved
        bodies both are of the polygon, and ``upper`` is the energy of the solution.
    gaps : (float, float)
        ``upper - lower`` on the given mesh and on the relocated one; NaN where they contradict each other.
    error_bound_initial, error_bound : float
        Bounds of the error in the energy norm (twice the strain energy, its root) on the given
        mesh and on the relocated one: roots of twice the gaps, and the distance of the computed displacement
        from the admissible one.
    relative_initial, relative : float
        The same over the energy norm of the computed displacement.
    guaranteed_lower, guaranteed_upper : bool
        Whether the bounds are bounds; else they are estimates, and so is that of the error.
    guaranteed_initial : bool
        Whether the bound of the error on the given mesh is one.
    why : str
        What stands in the way of a guarantee; empty if nothing does.
    local, local_initial : (elements,) arrays
        What each element adds to ``upper - lower`` on either mesh.
    field : (2 or 3, elements) array
        The flux or the stress xx, yy, xy in equilibrium, mean of each element, on the relocated mesh.
    residual : float
        Largest violation of static admissibility, relative to the largest force.
    bounds : mapping of str to Bounds
        Of quantities of the exact solution, with the value of the computed one: "resultant(NAME)", the normal
        force on each contact boundary, and those that were asked for.
    """

    lower: float
    upper: float
    gaps: tuple[float, float]
    error_bound_initial: float
    error_bound: float
    relative_initial: float
    relative: float
    guaranteed_lower: bool
    guaranteed_upper: bool
    guaranteed_initial: bool
    why: str
    local: Array = field(repr=False)
    local_initial: Array = field(repr=False)
    field: Array = field(repr=False)
    residual: float
    bounds: Mapping[str, Bounds]

    @property
    def is_disproved(self) -> bool:
        """Whether the energy lies below a proven bound: then the displacement is not admissible."""
        return self.guaranteed_lower and self.upper < self.lower

    @property
    def is_guaranteed(self) -> bool:
        """Whether all bounds are."""
        return self.guaranteed_lower and self.guaranteed_upper and self.guaranteed_initial

    def of_reduction(self, estimated: ErrorReduction) -> ErrorReduction:
        """An error reduction with these bounds, where they are guaranteed."""
        return by_certificate(estimated, *self.gaps) if self.is_guaranteed else estimated

    @property
    def sentence(self) -> str:
        """What it says of the error in words."""
        if self.upper < self.lower:
            word, cause = (
                ("proven ", "the displacement is not admissible")
                if self.guaranteed_lower
                else ("", "one is wrong")
            )
            energy, bound = figure(self.upper), figure(self.lower)
            return f"no error bound: the energy {energy} lies below the {word}bound {bound}, so {cause}"
        word = "at most" if self.is_guaranteed else "estimated at"
        before, after = (f"{100 * part:.3g} %" for part in (self.relative_initial, self.relative))
        return f"error in the energy norm {word} {before} before, {after} after"

    @property
    def sentences(self) -> list[str]:
        """What it says of quantities in words."""
        return [
            f"{name} {bounds_in_words(of.lower, of.upper)}, "
            f"{'guaranteed' if of.guaranteed else 'estimated'} (computed: {figure(of.value)})"
            f"{within_in_words(of.within)}"
            for name, of in self.bounds.items()
        ]
