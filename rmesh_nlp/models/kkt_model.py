"""The KKT model: the bilevel problem as one MPCC, KKT conditions as constraints.

Unknowns ``x = (q, u, lambda)`` and with friction ``(q, u, lambda, s, mu-, mu+)``, the last three where it may
act: outer variables q in units of their limits, displacements in units of ``length``, contact forces in
units of ``force``, so that all are of order one. An objective that is a function of several sums S over the
mesh adds them as unknowns sigma. Then

    min  F(X, u, forces, sigma)
    s.t. equilibrium (and, with friction, mu- + mu+ = g omega + F lambda),   sigma = S,
         constraints of the problem,   element areas,
         0 <= gap   _|_ lambda >= 0,
         0 <= s - u_t _|_ mu- >= 0,   0 <= s + u_t _|_ mu+ >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.contact.sensitivity import weakly_active
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array, Index, Mask, magnitude
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.constraints import ConstraintRows, constraint_rows
from rmesh_nlp.fem.contact_terms import (
    bound_force_groups,
    contact_force_groups,
    friction,
    gaps,
    gradient_group,
    identity_group,
    slips,
)
from rmesh_nlp.fem.energy import loads, strain
from rmesh_nlp.fem.fields import Field, unknown_field
from rmesh_nlp.fem.functional import Functional, as_row, scaled_group
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.optimize.solver import LEAST_SHIFTS, PluginOptions
from rmesh_nlp.problem import ContactProblem

COMMON: PluginOptions = {
    "nlp_scaling_method": "none",
    "mu_strategy": "monotone",
    # METIS: the KKT matrix of equilibrium, outer variables and displacements fills in five times
    # less than with the ordering that MUMPS takes of itself
    "mumps_pivot_order": 5,
    **LEAST_SHIFTS,
}
"""Ipopt options for the KKT model."""

TIGHT = 1e-10
"""Ipopt's tolerance in an exact finish, the objective in units of its mean gradient by outer variables."""


@dataclass(frozen=True)
class ContactPoint:
    """A contact solution at outer variables ``q`` (n_q,)."""

    q: Array
    system: ContactSystem
    equilibrium: Equilibrium

    @property
    def weak(self) -> Mask:
        """Contact nodes without strict complementarity: gradients other than the energy's are one of many."""
        return weakly_active(self.system, self.equilibrium)


@dataclass(frozen=True)
class Bilevel:
    """The MPCC in ``x`` and where its parts are; ``length``, ``force`` and ``value`` are units of the model.

    ``summed`` has the sums that objective and constraints are functions of, ``sums`` (m,) their units. The
    first ``n_equations`` rows of ``mpcc.g`` determine displacement, forces and sums at fixed outer variables;
    ``constraints`` follow them, then element areas. Rows of ``assembled`` are those of g, of G and of H.
    """

    parts: Discretisation
    assembled: Assembled
    length: float
    force: float
    value: float
    summed: Functional
    sums: Array
    n_equations: int
    constraints: ConstraintRows
    x: ca.MX

    @property
    def n_pairs(self) -> int:
        """Number of complementarity pairs."""
        return self.parts.n_contact + 2 * self.parts.n_s

    @property
    def n_g(self) -> int:
        """Number of rows of g."""
        return self.n_equations + self.constraints.size + self.parts.validity.bound.size

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of the unknowns ``q, u, lambda, s, mu-, mu+, sigma``."""
        n_s = self.parts.n_s
        return self.parts.n_q, self.parts.n_u, self.parts.n_contact, n_s, n_s, n_s, self.sums.size

    @cached_property
    def lower(self) -> Array:
        """Lower bounds of the rows of g."""
        rest = self.constraints.lower, self.parts.validity.bound
        return np.concatenate([np.zeros(self.n_equations), *rest])

    @cached_property
    def upper(self) -> Array:
        """Upper bounds of the rows of g."""
        areas = np.full(self.parts.validity.bound.size, np.inf)
        return np.concatenate([np.zeros(self.n_equations), self.constraints.upper, areas])

    @cached_property
    def mpcc(self) -> MPCC:
        """The symbolic MPCC."""
        free, rows = self.parts.mesh_map, self.assembled.g
        free_above = np.full(sum(self.sizes) - free.n, np.inf)
        names = ("q", "u", "normal_force", "slip", "friction_minus", "friction_plus", "sums")
        ends = np.cumsum([0, *self.sizes]).tolist()
        parts = zip(names, self.sizes, ca.vertsplit(self.x, ends), strict=True)
        return MPCC(
            x=self.x,
            f=self.assembled.f,
            g=rows[: self.n_g],
            G=rows[self.n_g : self.n_g + self.n_pairs],
            H=rows[self.n_g + self.n_pairs :],
            lbx=np.concatenate([free.lower, -free_above]),
            ubx=np.concatenate([free.upper, free_above]),
            lbg=self.lower,
            ubg=self.upper,
            derivatives=self.assembled.derivatives,
            # those of friction and of sums only if there are any
            parts={name: part for name, size, part in parts if size or name in names[:3]},
        )

    def pair_rows(self, pairs: Index) -> Index:
        """The gaps of complementarity pairs: those of contact, then two of friction each where it may act."""
        every = np.concatenate(
            [np.arange(self.parts.n_contact), self.parts.friction_rows, self.parts.friction_rows]
        )
        return every[pairs]

    def split(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Outer variables, displacement unknowns, normal and tangential contact forces (in N/m) of ``x``."""
        q, u, normal, _, minus, plus, _ = np.split(x, np.cumsum(self.sizes[:-1]))
        tangential = np.zeros(self.parts.n_contact if self.parts.friction_rows.size else 0)
        tangential[self.parts.friction_rows] = (plus - minus) * self.force
        return q, u * self.length, normal * self.force, tangential

    def point(self, point: ContactPoint) -> Array:
        """The unknowns ``x`` of a contact solution."""
        x = kkt_unknowns(point, self.parts.friction_rows) / _units(self.length, self.force, self.sizes)
        return np.append(x, self.summed.sum_values(x) / self.sums)


def _units(length: float, force: float, sizes: tuple[int, ...]) -> Array:
    """Of the unknowns ``(q, u, lambda, s, mu-, mu+)``, ``sizes`` their numbers."""
    return np.repeat((1.0, length, force, length, force, force), sizes[:6])


def kkt_unknowns(point: ContactPoint, friction_rows: Index) -> Array:
    """The unknowns ``(q, u, lambda, s, mu-, mu+)`` of the KKT conditions at a contact solution."""
    parts = [point.q, point.equilibrium.u, point.equilibrium.normal_force]
    if friction_rows.size:
        parts += [part[friction_rows] for part in point.system.friction(point.equilibrium)]
    return np.concatenate(parts)


def in_units_of(parts: Discretisation, objective: Objective, start: ContactPoint) -> Bilevel:
    """The KKT model in units of a contact solution: of its displacement, its loads, its objective."""
    x = kkt_unknowns(start, parts.friction_rows)
    return bilevel(
        parts,
        objective,
        length=magnitude(start.equilibrium.u) or 1.0,
        force=start.system.force_scale,
        value=abs(objective.on(parts.fields()).evaluate()(x)) or 1.0,
        start=x,
    )


def bilevel(
    problem: ContactProblem | Discretisation,
    objective: Objective = ENERGY,
    *,
    length: float = 1.0,
    force: float = 1.0,
    value: float = 1.0,
    start: Array | None = None,
) -> Bilevel:
    """Build the bilevel problem as an MPCC with assembled derivatives.

    ``length``, ``force`` and ``value`` are units of displacement, of nodal force, and of the outer objective.
    If that is a function of sums, these are in units of their size at ``start``, see :func:`kkt_unknowns`.
    """
    parts = discretise(problem)
    free, n_u, n_c, n_s = parts.mesh_map, parts.n_u, parts.n_contact, parts.n_s
    first = free.n + n_u
    fields = parts.fields(length)
    assert fields.forces is not None
    physical = fields._replace(forces=fields.forces.in_units(force))
    outer = objective.on(physical)
    constraints = constraint_rows(parts.problem.constraints, physical)
    summed = Functional([], (*outer.sums, *constraints.sums))
    n_sums, first_sum = len(summed.sums), first + n_c + 3 * n_s
    units = _units(length, force, (free.n, n_u, n_c, n_s, n_s, n_s))
    sums = np.ones(n_sums) if start is None else summed.sizes(start / units)
    n_x = first_sum + n_sums
    of_sums = replace(unknown_field((n_sums, 1), first_sum), scale=sums[:, None])

    # rows of g: equilibrium, slip stationarity, sums, constraints, areas; then of G and H
    bulk = [*strain(fields), *loads(fields, parts.problem.rule)]
    groups = [gradient_group(group, -free.n, force) for group in bulk]
    groups += contact_force_groups(fields, parts.displacement.index)
    groups += [gradient_group(group, n_u - (first + n_c), force) for group in friction(fields)]
    groups += bound_force_groups(fields, n_u)
    for k, (terms, unit) in enumerate(zip(summed.sums, sums, strict=True)):
        groups += [as_row(scaled_group(group, -1 / unit), n_u + n_s + k) for group in terms]
    groups.append(identity_group(first_sum, n_u + n_s + np.arange(n_sums)))
    n_equations, area_bound = n_u + n_s + n_sums, parts.validity.bound
    groups += [group.shifted(n_equations) for group in constraints.groups]
    first_of = len(outer.sums)
    for row, functional in enumerate(constraints.values):
        if functional.sums:
            own = _part(of_sums, first_of, len(functional.sums))
            groups.append(as_row(functional.combined(own), n_equations + row))
            first_of += len(functional.sums)
    groups.append(parts.validity.upright_group.shifted(n_equations + constraints.size))
    n_g = n_equations + constraints.size + area_bound.size
    pairs = [*gaps(fields, n_g), *slips(fields, n_g + n_c)]
    groups += [group.in_units(length) for group in pairs]
    n_pairs = n_c + 2 * n_s
    first_h = n_g + n_pairs
    groups.append(identity_group(first, first_h + np.arange(n_c)))
    groups.append(identity_group(first + n_c + n_s, first_h + n_c + np.arange(2 * n_s)))
    of_outer = outer.groups
    if outer.sums:
        of_outer = [*of_outer, outer.combined(_part(of_sums, 0, len(outer.sums)))]
    groups += [scaled_group(group, 1 / value) for group in of_outer]

    x = ca.MX.sym("x", n_x)
    assembled = Assembled(groups, x, ca.MX(0, 1), n_g + 2 * n_pairs)
    return Bilevel(parts, assembled, length, force, value, summed, sums, n_equations, constraints, x)


def _part(field: Field, first: int, size: int) -> Field:
    """Some of the sums (m, 1)."""
    rows = slice(first, first + size)
    return Field(field.index[rows], field.scale[rows], field.offset[rows])
