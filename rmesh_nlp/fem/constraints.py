"""Constraints on the outer problem: quantities within bounds, as rows of sums over elements.

The value of a :class:`rmesh_nlp.Constraint` is that of an objective, or ``max-pressure(NAME)``: then there is
a row ``F_v <= P omega_v`` for each contact vertex of the boundary, with a derivative where the largest
pressure has none. Where a displacement is given on a contact boundary, designs must leave it admissible. All
rows are in units of their bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, largest_side
from rmesh_nlp.fem.contact_terms import given_gaps
from rmesh_nlp.fem.fields import ElementGroup, Fields
from rmesh_nlp.fem.functional import Functional, Groups, as_row
from rmesh_nlp.fem.objective_text import called, parse_objective
from rmesh_nlp.fem.pressure import LARGEST, contact_on, vertex_groups
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.design import Constraint, at_design

MARGIN = 1e-6
"""Least gap where the displacement is given, unless it begins with less."""


@dataclass(frozen=True)
class ConstraintRows:
    """Rows ``lower <= c(x) <= upper``, in units of their bounds.

    Attributes
    ----------
    values : tuple of Functional
        The first rows, one each.
    nodal : tuple of ElementGroup
        All others, numbered after those.
    lower, upper : (rows,) arrays
    places : tuple of slice
        Rows of each constraint of the problem.
    """

    values: tuple[Functional, ...]
    nodal: tuple[ElementGroup, ...]
    lower: Array
    upper: Array
    places: tuple[slice, ...]

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.lower.size

    @property
    def sums(self) -> tuple[Groups, ...]:
        """The sums that values are functions of, one value after the other."""
        return tuple(groups for value in self.values for groups in value.sums)

    @property
    def groups(self) -> Groups:
        """What adds to the rows, without functions of ``sums``."""
        first = [as_row(group, k) for k, value in enumerate(self.values) for group in value.groups]
        return [*first, *self.nodal]


def constraint_rows(constraints: Sequence[Constraint], fields: Fields) -> ConstraintRows:
    """The rows of constraints on these fields; a ValueError where one does not suit the problem."""
    values: list[Functional] = []
    nodal: Groups = []
    limits, places = list[tuple[float, ...]](), dict[int, slice]()
    boundaries = dict(enumerate(map(boundary_of, constraints)))
    for number in sorted(boundaries, key=lambda number: boundaries[number] is not None):
        (lower, upper), begin, boundary = constraints[number].bounds, len(limits), boundaries[number]
        if boundary is None:
            unit = unit_of(constraints[number])
            values.append(parse_objective(constraints[number].value).on(fields).scaled(1 / unit))
            limits.append((lower / unit, upper / unit))
        else:
            groups = _pressure_rows(fields, boundary, upper, begin)
            nodal += groups
            limits += [(-np.inf, 0.0)] * sum(group.size for group in groups)
        places[number] = slice(begin, len(limits))
    groups, first, unit = _given_gaps(fields, len(limits))
    nodal += groups
    limits += [(min(MARGIN, gap / unit), np.inf) for gap in first]
    low, high = np.array(limits).reshape(-1, 2).T
    each = tuple(places[number] for number in boundaries)
    return ConstraintRows(tuple(values), tuple(nodal), low, high, each)


def checked(constraint: Constraint) -> Constraint:
    """The same; a ValueError if its value cannot be read."""
    if boundary_of(constraint) is None:
        parse_objective(constraint.value)
    return constraint


def is_constrained(problem: ContactProblem) -> bool:
    """Whether there is any row."""
    given = problem.design and any(
        problem.nodes_of(part.obstacle).size > part.nodes.size for part in problem.contact_sets
    )
    return bool(problem.constraints or given)


def _given_gaps(fields: Fields, first: int) -> tuple[Groups, Array, float]:
    """The gaps that a design changes and displacements do not, their first values, and their unit."""
    problem = fields.problem
    unit = largest_side(problem.mesh.p)
    if not problem.design:
        return [], np.zeros(0), unit
    gaps = [problem.given_gaps(part)[1] for part in problem.contact_sets]
    return [group.in_units(unit) for group in given_gaps(fields, first)], np.concatenate(gaps), unit


def boundary_of(constraint: Constraint) -> str | None:
    """The boundary of a constraint on the largest pressure; None for every other."""
    kind, arguments = called(str(constraint.value))
    if kind != LARGEST:
        return None
    if constraint.bounds[0] > -np.inf:
        raise BadInputError(f"{constraint.value}: the largest pressure may be bounded from above alone")
    return arguments[0]


def unit_of(constraint: Constraint) -> float:
    """The larger one of its finite bounds; 1 if that is zero."""
    finite = [abs(bound) for bound in constraint.bounds if np.isfinite(bound)]
    return max(finite) or 1.0


def _pressure_rows(fields: Fields, boundary: str, level: float | ca.SX, first: int) -> Groups:
    """Rows ``F_v - P omega_v`` numbered from ``first``."""
    space = fields.space
    size = at_design(level, space.problem.start)
    weights = space.weights(space.problem.mesh.p)[contact_on(space, boundary).rows]
    unit = np.mean(weights) * (abs(size) or 1.0)
    return vertex_groups(fields, boundary, lambda share, force: (force - level * share) / unit, first)
