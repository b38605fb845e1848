"""The relocation problem as one nonlinear program in node moves, displacement and slip.

With the energy as outer objective the two levels collapse: min over X of min over u of J is
the minimum over both,

    min J(u, s; X)  s.t.  gap(X, u) >= 0,  s - u_t >= 0,  s + u_t >= 0,  area_e(X) >= bound,

in ``x = (q, u, s)``: node moves in units of their boxes, displacement unknowns, and one slip
magnitude per contact node with friction. This program is what ``joint`` solves; its
derivatives also give the energy gradient (5.7), (5.11) of ``nested`` and the audit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import Assembled, assemble
from rmesh_nlp.fem.energy import bulk_groups, displacement_field, friction_groups, gap_groups
from rmesh_nlp.fem.fields import ElementGroup, Field, Index, constant_field, without_elements
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.problem import ContactProblem, Obstacle
from rmesh_nlp.programs.freedoms import Freedoms, freedoms, validity_group


@dataclass(frozen=True)
class Relocation:
    """The energy program and where its parts are.

    Attributes
    ----------
    problem : ContactProblem
    freedoms : Freedoms
    nlp : NLP
        Unknowns ``(q, u, s)``; rows: gaps, the two slip rows of each contact node, validity.
    derivatives : Assembled
        Those of ``nlp``, second ones included.
    displacement, slip : Field
        (components, nodes) and (obstacles, nodes), functions of the unknowns; slip is zero where there
        is no friction.
    n_q, n_u, n_s : int
        Numbers of moves, displacement unknowns, slip magnitudes.
    n_contact, n_valid : int
        Numbers of gap rows and of validity rows.
    validity : ElementGroup
        The validity rows by themselves, numbered from zero, as functions of q.
    objective : Objective
        The energy, and terms in the positions alone if there are any.
    """

    problem: ContactProblem
    freedoms: Freedoms
    nlp: NLP
    derivatives: Assembled
    displacement: Field
    slip: Field
    n_q: int
    n_u: int
    n_s: int
    n_contact: int
    n_valid: int
    validity: ElementGroup
    objective: Objective = ENERGY

    @cached_property
    def friction_rows(self) -> Index:
        """(n_s,) numbers of the gaps at which friction may act."""
        return self.problem.friction_rows

    @property
    def gap_rows(self) -> slice:
        """Rows of the gaps."""
        return slice(0, self.n_contact)

    @property
    def slip_rows(self) -> slice:
        """Rows ``s + u_t >= 0``; those of ``s - u_t >= 0`` are before them."""
        return slice(self.n_contact + self.n_s, self.n_contact + 2 * self.n_s)

    @property
    def validity_rows(self) -> slice:
        """Rows of the element areas."""
        return slice(self.nlp.n_g - self.n_valid, self.nlp.n_g)

    def split(self, x: Array) -> tuple[Array, Array, Array]:
        """The parts q, u, s of ``x``."""
        q, u, s = np.split(x, [self.n_q, self.n_q + self.n_u])
        return q, u, s

    def nodes(self, q: Array) -> Array:
        """Node positions (2, nodes)."""
        return self.freedoms.positions.values(q)


def relocation(problem: ContactProblem, objective: Objective = ENERGY) -> Relocation:
    """State the energy program of a problem, with assembled derivatives.

    Parameters
    ----------
    problem : ContactProblem
    objective : Objective
        The energy, to which terms in the positions alone may be added: the levels collapse with them
        too. A distortion is infinite where an element degenerates and undefined beyond; it then stands in
        the place of the element areas, which are constraints only if a least angle is asked for as well.

    Raises
    ------
    ValueError
        If the objective has another term: the inner problem must then stay a constraint.
    """
    if not objective.collapses:
        raise ValueError(f"{objective.text!r} is not the energy with terms in the positions alone")
    free = freedoms(problem)
    displacement, n_u = displacement_field(problem, first=free.n)
    n_contact = problem.contact_nodes.size
    n_s = problem.friction_rows.size
    slip = slip_field(problem, first=free.n + n_u)
    groups = [
        *bulk_groups(problem, free.positions, displacement),
        *gap_groups(problem, free.positions, displacement),
        *friction_groups(problem, free.positions, slip),
        *slip_groups(problem, free.positions, displacement, slip, first_row=n_contact),
    ]
    n_rows = n_contact + 2 * n_s
    groups += objective.position_groups(problem, free.positions, displacement, slip)
    validity, area_bound = validity_group(problem, free)
    if objective.has_barrier and problem.motion.min_angle == 0:
        validity, area_bound = without_elements(validity), np.zeros(0)
    groups.append(replace(validity, rows=validity.rows + n_rows))
    n_valid = area_bound.size
    x, p = ca.MX.sym("x", free.n + n_u + n_s), ca.MX(0, 1)
    assembled = assemble(groups, x, p, n_rows + n_valid)
    nlp = NLP(
        x=x,
        p=p,
        f=assembled.f,
        g=assembled.g,
        lbx=np.concatenate([-free.bound, np.full(n_u + n_s, -np.inf)]),
        ubx=np.concatenate([free.bound, np.full(n_u + n_s, np.inf)]),
        lbg=np.concatenate([np.zeros(n_rows), area_bound]),
        ubg=np.full(n_rows + n_valid, np.inf),
        derivatives=assembled.derivatives,
        parts=dict(
            zip(
                ("q", "u", "slip"),
                ca.vertsplit(x, [0, free.n, free.n + n_u, free.n + n_u + n_s]),
                strict=True,
            )
        ),
    )
    return Relocation(
        problem=problem,
        freedoms=free,
        nlp=nlp,
        derivatives=assembled,
        displacement=displacement,
        slip=slip,
        n_q=free.n,
        n_u=n_u,
        n_s=n_s,
        n_contact=n_contact,
        n_valid=n_valid,
        validity=validity,
        objective=objective,
    )


def contact_field(problem: ContactProblem, first: int) -> Field:
    """One unknown per gap, numbered from ``first``, as a field (obstacles, nodes); zero elsewhere."""
    field = _no_contact_field(problem)
    for part in problem.contact_sets:
        field.index[part.number, part.nodes] = first + part.rows
    return field


def slip_field(problem: ContactProblem, first: int) -> Field:
    """One unknown per gap with friction, numbered from ``first``, as a field (obstacles, nodes)."""
    field = _no_contact_field(problem)
    for part in problem.contact_sets:
        if part.obstacle.frictional:
            field.index[part.number, part.nodes] = first + np.arange(part.nodes.size)
            first += part.nodes.size
    return field


def _no_contact_field(problem: ContactProblem) -> Field:
    return constant_field(np.zeros((max(len(problem.obstacles), 1), problem.mesh.p.shape[1])))


def slip_groups(
    problem: ContactProblem, positions: Field, displacement: Field, slip: Field, first_row: int
) -> list[ElementGroup]:
    """Rows ``s - u_t >= 0`` of all contact nodes with friction, then ``s + u_t >= 0``."""
    groups, n_s = [], problem.friction_rows.size
    for part in problem.contact_sets:
        if part.obstacle.frictional:
            nodes = part.nodes[None, :]
            rows = first_row + np.arange(nodes.size) + np.array([[0], [n_s]])
            local = (positions.at(nodes), displacement.at(nodes), slip.component(part.number).at(nodes))
            groups.append(ElementGroup(slip_function(part.obstacle), local, rows))
            first_row += nodes.size
    return groups


def slip_function(obstacle: Obstacle) -> ca.Function:
    """``(X_i, u_i, s_i) -> (0, (s - u_t, s + u_t))`` of one contact node."""
    X, u, s = ca.SX.sym("X", 2), ca.SX.sym("u", 2), ca.SX.sym("s")
    slip = ca.dot(obstacle.tangential(X[0], X[1]), u)
    return ca.Function("slip", [X, u, s], [0, ca.vertcat(s - slip, s + slip)])
