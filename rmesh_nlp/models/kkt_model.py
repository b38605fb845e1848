"""The KKT model: the bilevel problem as one MPCC, KKT conditions as constraints.

Unknowns ``x = (q, u, lambda)`` and with friction ``(q, u, lambda, s, mu-, mu+)``, the last three where it may
act: outer variables q in units of their move limits, displacements in units of ``length``, contact forces in
units of ``force``, so that all are of order one. Then

    min  F(X, u)
    s.t. equilibrium (and, with friction, mu- + mu+ = g omega + F lambda),   element areas,
         0 <= gap   _|_ lambda >= 0,
         0 <= s - u_t _|_ mu- >= 0,   0 <= s + u_t _|_ mu+ >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import (
    bound_force_groups,
    contact_force_groups,
    gradient_group,
    identity_group,
)
from rmesh_nlp.fem.element import local_symbols
from rmesh_nlp.fem.fields import ElementGroup, Index
from rmesh_nlp.fem.objective import Objective, scaled_group
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class Bilevel:
    """The MPCC and where its parts are; ``length``, ``force`` and ``value`` are the units of the model."""

    mpcc: MPCC
    n_q: int
    n_u: int
    n_contact: int
    friction_rows: Index
    length: float
    force: float
    value: float

    def without_complementarity(self) -> NLP:
        """The NLP that keeps ``G, H >= 0`` and drops their products.

        Its minimum bounds that of the MPCC from below; with the energy as objective it is the
        same, because then the contact law is a condition of optimality.
        """
        mpcc = self.mpcc
        n = int(mpcc.G.shape[0])
        return NLP(
            x=mpcc.x,
            p=ca.MX(0, 1),
            f=mpcc.f,
            g=ca.vertcat(mpcc.g, mpcc.G, mpcc.H),
            lbx=np.asarray(mpcc.lbx),
            ubx=np.asarray(mpcc.ubx),
            lbg=np.append(mpcc.lbg, np.zeros(2 * n)),
            ubg=np.append(mpcc.ubg, np.full(2 * n, np.inf)),
            derivatives=mpcc.derivatives,
        )

    def split(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Outer variables, displacement unknowns, normal and tangential contact forces (in N/m) of ``x``."""
        parts = np.cumsum([self.n_q, self.n_u, self.n_contact, *(3 * [self.friction_rows.size])])
        q, u, normal, _, minus, plus, _ = np.split(x, parts)
        tangential = np.zeros(self.n_contact if self.friction_rows.size else 0)
        tangential[self.friction_rows] = (plus - minus) * self.force
        return q, u * self.length, normal * self.force, tangential

    def point(self, q: Array, equilibrium: Equilibrium, system: ContactSystem) -> Array:
        """The unknowns ``x`` of a contact solution at ``q``."""
        parts = [q, equilibrium.u / self.length, equilibrium.normal_force / self.force]
        if self.friction_rows.size:
            slip = np.abs(system.tangents @ equilibrium.u) / self.length
            bound = system.bound(equilibrium.normal_force)
            minus = (bound - equilibrium.tangential_force) / (2 * self.force)
            plus = (bound + equilibrium.tangential_force) / (2 * self.force)
            parts += [part[self.friction_rows] for part in (slip, minus, plus)]
        return np.concatenate(parts)


def bilevel(
    problem: ContactProblem | Discretisation,
    objective: Objective = ENERGY,
    *,
    length: float = 1.0,
    force: float = 1.0,
    value: float = 1.0,
) -> Bilevel:
    """Build the bilevel problem as an MPCC with assembled derivatives.

    ``length``, ``force`` and ``value`` are units of displacement, of nodal force, and of the outer objective.
    """
    parts = discretise(problem)
    free, n_u, n_c, n_s = parts.mesh_map, parts.n_u, parts.n_contact, parts.n_s
    first = free.n + n_u
    displacement = parts.displacement.in_units(length).numbered_from(free.n)
    normal_force = parts.contact_force.numbered_from(first)
    slip = parts.slip.in_units(length).numbered_from(first + n_c)
    friction = (
        parts.slip.numbered_from(first + n_c + n_s),
        parts.slip.numbered_from(first + n_c + 2 * n_s),
    )
    n_x = first + n_c + 3 * n_s

    # rows of g: equilibrium, slip stationarity, areas; then G: gaps, slips; then H: their forces
    groups = [
        gradient_group(group, len(group.arguments) - 1, -free.n, force)
        for group in parts.bulk(free.positions, displacement)
    ]
    groups += contact_force_groups(
        parts.space, parts.displacement.index, free.positions, normal_force, friction
    )
    for weights in parts.friction:
        groups.append(gradient_group(weights.on(free.positions, slip), 1, n_u - (first + n_c), force))
    groups += bound_force_groups(parts.space, n_u, free.positions, normal_force, friction)
    n_equations, area_bound = n_u + n_s, parts.validity.bound
    validity = parts.validity.upright_group
    groups.append(replace(validity, rows=validity.rows + n_equations))
    n_g = n_equations + area_bound.size
    pairs = [
        *(term.on(free.positions, displacement, first_row=n_g) for term in parts.gaps),
        *(term.on(free.positions, displacement, slip, first_row=n_g + n_c) for term in parts.slips),
    ]
    groups += [_in_units_of_rows(group, length) for group in pairs]
    n_pairs = n_c + 2 * n_s
    first_h = n_g + n_pairs
    groups.append(identity_group(first, first_h + np.arange(n_c)))
    groups.append(identity_group(first + n_c + n_s, first_h + n_c + np.arange(2 * n_s)))
    outer = parts.objective(objective, free.positions, displacement, slip)
    groups += [scaled_group(group, 1 / value) for group in outer]

    x = ca.MX.sym("x", n_x)
    assembled = parts.assemble(groups, x, ca.MX(0, 1), n_g + 2 * n_pairs)
    free_below = np.full(n_x - free.n, -np.inf)
    mpcc = MPCC(
        x=x,
        f=assembled.f,
        g=assembled.g[:n_g],
        G=assembled.g[n_g:first_h],
        H=assembled.g[first_h:],
        lbx=np.concatenate([-free.bound, free_below]),
        ubx=np.concatenate([free.bound, -free_below]),
        lbg=np.concatenate([np.zeros(n_equations), area_bound]),
        ubg=np.concatenate([np.zeros(n_equations), np.full(area_bound.size, np.inf)]),
        derivatives=assembled.derivatives,
        parts=_by_name(x, [free.n, n_u, n_c, *([n_s] * 3 if n_s else ())]),
    )
    return Bilevel(mpcc, free.n, n_u, n_c, parts.friction_rows, length, force, value)


def _by_name(x: ca.MX, sizes: list[int]) -> dict[str, ca.MX]:
    """The unknowns in the units of the model; the last three are those of friction."""
    names = ("q", "u", "normal_force", "slip", "friction_minus", "friction_plus")
    return dict(zip(names, ca.vertsplit(x, np.cumsum([0, *sizes]).tolist()), strict=False))


def _in_units_of_rows(group: ElementGroup, unit: float) -> ElementGroup:
    """The same rows divided by ``unit``."""
    symbols = local_symbols(group.function)
    f, g = group.function(*symbols)
    return replace(group, function=ca.Function(group.function.name(), symbols, [f, g / unit]))
