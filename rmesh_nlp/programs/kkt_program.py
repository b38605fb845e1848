"""The bilevel problem as one MPCC: outer objective over the KKT conditions of the contact problem.

Unknowns ``x = (q, u, lambda)`` and with friction ``(q, u, lambda, s, mu-, mu+)``: node moves
in units of their boxes, displacements in units of ``length``, contact forces in units of
``force``, so that all are of order one. Then

    min  F(X, u)
    s.t. equilibrium (and, with friction, mu- + mu+ = g omega),   element areas,
         0 <= gap   _|_ lambda >= 0,
         0 <= s - u_t _|_ mu- >= 0,   0 <= s + u_t _|_ mu+ >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import assemble
from rmesh_nlp.fem.element import local_symbols
from rmesh_nlp.fem.energy import bulk_groups, displacement_field, friction_group, gap_group
from rmesh_nlp.fem.fields import ElementGroup, Field
from rmesh_nlp.fem.kkt import bound_force_group, contact_force_group, gradient_group, identity_group
from rmesh_nlp.fem.objectives import ENERGY, Objective, scaled_group
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.energy_program import slip_field, slip_group
from rmesh_nlp.programs.freedoms import freedoms, validity_group


@dataclass(frozen=True)
class Bilevel:
    """The MPCC and where its parts are.

    Attributes
    ----------
    mpcc : MPCC
    n_q, n_u, n_contact : int
        Numbers of moves, displacement unknowns and contact nodes.
    frictional : bool
    length, force : float
        Units of displacements and of nodal forces in ``x``.
    value : float
        Unit of the objective.
    """

    mpcc: MPCC
    n_q: int
    n_u: int
    n_contact: int
    frictional: bool
    length: float
    force: float
    value: float

    def without_complementarity(self) -> NLP:
        """The program that keeps ``G, H >= 0`` and drops their products.

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
        """Moves, displacement unknowns, normal and tangential contact forces (in N/m) of ``x``."""
        q, u, rest = np.split(x, [self.n_q, self.n_q + self.n_u])
        parts = rest.reshape(-1, self.n_contact) if self.n_contact else np.zeros((4, 0))
        tangential = (parts[3] - parts[2]) * self.force if self.frictional else np.zeros(0)
        return q, u * self.length, parts[0] * self.force, tangential

    def point(self, q: Array, equilibrium: Equilibrium, system: ContactSystem) -> Array:
        """The unknowns ``x`` of a contact solution at moves ``q``."""
        parts = [q, equilibrium.u / self.length, equilibrium.normal_force / self.force]
        if self.frictional:
            slip = np.abs(system.tangents @ equilibrium.u) / self.length
            minus = (system.slip_bound - equilibrium.tangential_force) / (2 * self.force)
            plus = (system.slip_bound + equilibrium.tangential_force) / (2 * self.force)
            parts += [slip, minus, plus]
        return np.concatenate(parts)


def bilevel(
    problem: ContactProblem,
    objective: Objective = ENERGY,
    *,
    length: float = 1.0,
    force: float = 1.0,
    value: float = 1.0,
) -> Bilevel:
    """State the bilevel problem as an MPCC with assembled derivatives.

    Parameters
    ----------
    problem : ContactProblem
    objective : Objective
        Outer objective; the energy by default.
    length, force, value : float
        Units of displacement, of nodal force, and of the objective.
    """
    free = freedoms(problem)
    nodes, n_c = problem.contact_nodes, problem.contact_nodes.size
    frictional = problem.frictional
    displacement, n_u = displacement_field(problem, first=free.n)
    displacement = _in_units(displacement, length)
    first = free.n + n_u
    normal_force = slip_field(problem, first)
    slip = _in_units(slip_field(problem, first + n_c), length)
    friction = (slip_field(problem, first + 2 * n_c), slip_field(problem, first + 3 * n_c))
    n_x = first + n_c * (4 if frictional else 1)

    # rows of g: equilibrium, slip stationarity, areas; then G: gaps, slips; then H: their forces
    equilibrium_rows = np.where(displacement.index < 0, -1, displacement.index - free.n)
    inner = bulk_groups(problem, free.positions, displacement)
    groups = [gradient_group(group, 1, -free.n, force) for group in inner]
    groups.append(
        contact_force_group(problem, equilibrium_rows, normal_force, friction if frictional else None)
    )
    n_g = n_u
    if frictional:
        slip_rows = np.arange(n_c) + n_g
        weights = friction_group(problem, free.positions, slip)
        groups.append(gradient_group(weights, 1, n_g - (first + n_c), force))
        groups.append(bound_force_group(problem, slip_rows, friction))
        n_g += n_c
    validity, area_bound = validity_group(problem, free, first_row=n_g)
    groups.append(validity)
    n_equations, n_g = n_g, n_g + area_bound.size
    groups.append(_in_units_of_rows(gap_group(problem, free.positions, displacement, first_row=n_g), length))
    n_pairs = n_c
    if frictional:
        rows = slip_group(problem, displacement, slip, first_row=n_g + n_c)
        groups.append(_in_units_of_rows(rows, length))
        n_pairs += 2 * n_c
    first_h = n_g + n_pairs
    for number, field in enumerate((normal_force, *friction) if frictional else (normal_force,)):
        groups.append(identity_group(field, nodes, first_h + number * n_c + np.arange(n_c)))
    groups += [
        scaled_group(group, 1 / value)
        for group in objective.groups(problem, free.positions, displacement, slip)
    ]

    x = ca.MX.sym("x", n_x)
    assembled = assemble(groups, x, ca.MX(0, 1), n_g + 2 * n_pairs)
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
    )
    return Bilevel(mpcc, free.n, n_u, n_c, frictional, length, force, value)


def _in_units(field: Field, unit: float) -> Field:
    return Field(field.index, field.scale * unit, field.offset)


def _in_units_of_rows(group: ElementGroup, unit: float) -> ElementGroup:
    """The same rows divided by ``unit``."""
    symbols = local_symbols(group.function)
    f, g = group.function(*symbols)
    return replace(group, function=ca.Function(group.function.name(), symbols, [f, g / unit]))
