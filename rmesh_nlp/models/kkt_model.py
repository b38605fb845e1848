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

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, Numbering, discretise
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
from rmesh_nlp.fem.fields import unknown_field
from rmesh_nlp.fem.functional import Functional, as_row, scaled_group
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class ContactPoint:
    """A contact solution at outer variables ``q`` (n_q,)."""

    q: Array
    system: ContactSystem
    equilibrium: Equilibrium

    @property
    def weak(self) -> Mask:
        """Contact nodes without strict complementarity: gradients other than the energy's are one of many."""
        return self.system.weak(self.equilibrium)


@dataclass(frozen=True)
class Bilevel:
    """The MPCC in ``x`` and where its parts are; ``length``, ``force`` and ``value`` are units of the model.

    ``summed`` has the sums that objective and constraints are functions of, ``sums`` (m,) their units.
    ``rows`` says where those of g, of G and of H are.
    """

    parts: Discretisation
    assembled: Assembled
    length: float
    force: float
    value: float
    summed: Functional
    sums: Array
    constraints: ConstraintRows
    x: ca.MX
    rows: Numbering

    @cached_property
    def unknowns(self) -> Numbering:
        """Where the unknowns are in ``x``."""
        return Numbering(**self.parts.unknowns.sizes, sums=self.sums.size)

    @property
    def n_equations(self) -> int:
        """Number of rows that determine displacement, forces and sums at fixed outer variables."""
        return self.rows["constraints"].start

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
        free_above, first = np.full(self.unknowns.size - free.n, np.inf), ("q", "u", "normal_force")
        parts = self.unknowns.places.items()
        return MPCC(
            x=self.x,
            f=self.assembled.f,
            g=rows[: self.rows["G"].start],
            G=rows[self.rows["G"]],
            H=rows[self.rows["H"]],
            lbx=np.concatenate([free.lower, -free_above]),
            ubx=np.concatenate([free.upper, free_above]),
            lbg=self.lower,
            ubg=self.upper,
            derivatives=self.assembled.derivatives,
            # those of friction and of sums only if there are any
            parts={name: self.x[at] for name, at in parts if self.unknowns.sizes[name] or name in first},
        )

    def pair_rows(self, pairs: Index) -> Index:
        """The gaps of complementarity pairs: those of contact, then two of friction each where it may act."""
        every = np.concatenate(
            [np.arange(self.parts.n_contact), self.parts.friction_rows, self.parts.friction_rows]
        )
        return every[pairs]

    def split(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Outer variables, displacement unknowns, normal and tangential contact forces (in N/m) of ``x``."""
        q, u, normal, _, minus, plus, _ = self.unknowns.split(x)
        tangential = np.zeros(self.parts.n_contact)
        tangential[self.parts.friction_rows] = (plus - minus) * self.force
        return q, u * self.length, normal * self.force, tangential

    def point(self, point: ContactPoint) -> Array:
        """The unknowns ``x`` of a contact solution."""
        units = _units(self.parts, self.length, self.force)
        x = kkt_unknowns(point, self.parts.friction_rows) / units
        return np.append(x, self.summed.sum_values(x) / self.sums)


def _units(parts: Discretisation, length: float, force: float) -> Array:
    """Units of the unknowns ``(q, u, lambda, s, mu-, mu+)``."""
    return np.repeat((1.0, length, force, length, force, force), list(parts.unknowns.sizes.values()))


def kkt_unknowns(point: ContactPoint, friction_rows: Index) -> Array:
    """The unknowns ``(q, u, lambda, s, mu-, mu+)`` of the KKT conditions at a contact solution."""
    friction = (part[friction_rows] for part in point.system.friction(point.equilibrium))
    return np.concatenate([point.q, point.equilibrium.u, point.equilibrium.normal_force, *friction])


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
    fields, unknowns = parts.fields(length), parts.unknowns
    assert fields.forces is not None
    physical = fields._replace(forces=fields.forces.in_units(force))
    outer = objective.on(physical)
    constraints = constraint_rows(parts.problem.constraints, physical)
    summed = Functional([], (*outer.sums, *constraints.sums))
    units, n_sums = _units(parts, length, force), len(summed.sums)
    sums = np.ones(n_sums) if start is None else summed.sizes(start / units)
    of_sums = replace(unknown_field((n_sums, 1), unknowns.size), scale=sums[:, None])
    rows = Numbering(
        equilibrium=parts.n_u,
        bounds=parts.n_s,
        sums=n_sums,
        constraints=constraints.size,
        areas=parts.validity.size,
        G=parts.pairs.size,
        H=parts.pairs.size,
    )
    equilibrium, bounds, first_sum = (rows[name].start for name in ("equilibrium", "bounds", "sums"))

    bulk = [*strain(fields), *loads(fields, parts.problem.rule)]
    groups = [gradient_group(group, equilibrium - unknowns["u"].start, force) for group in bulk]
    groups += contact_force_groups(fields, parts.displacement.index)
    rough = friction(fields)
    groups += [gradient_group(group, bounds - unknowns["slip"].start, force) for group in rough]
    groups += bound_force_groups(fields, bounds)
    for k, (terms, unit) in enumerate(zip(summed.sums, sums, strict=True)):
        groups += [as_row(scaled_group(group, -1 / unit), first_sum + k) for group in terms]
    groups.append(identity_group(unknowns.size, first_sum + np.arange(n_sums)))
    first = rows["constraints"].start
    groups += [group.shifted(first) for group in constraints.groups]
    first_of = len(outer.sums)
    for row, functional in enumerate(constraints.values):
        if functional.sums:
            own = of_sums.component(first_of, len(functional.sums))
            groups.append(as_row(functional.combined(own), first + row))
            first_of += len(functional.sums)
    groups.append(parts.validity.upright_group.shifted(rows["areas"].start))
    first, pairs = rows["G"].start, parts.pairs
    of_pairs = [*gaps(fields, first + pairs["gaps"].start), *slips(fields, first + pairs["minus"].start)]
    groups += [group.in_units(length) for group in of_pairs]
    for name, pair in zip(("normal_force", "friction_minus", "friction_plus"), pairs.places, strict=True):
        numbers = rows["H"].start + np.arange(pairs.size)[pairs[pair]]
        groups.append(identity_group(unknowns[name].start, numbers))
    of_outer = outer.groups
    if outer.sums:
        of_outer = [*of_outer, outer.combined(of_sums.component(0, len(outer.sums)))]
    groups += [scaled_group(group, 1 / value) for group in of_outer]

    x = ca.MX.sym("x", unknowns.size + n_sums)
    assembled = Assembled(groups, x, ca.MX(0, 1), rows.size)
    return Bilevel(parts, assembled, length, force, value, summed, sums, constraints, x, rows)
