"""The relocation problem as one nonlinear program in node moves, displacement and slip.

With the energy as outer objective the two levels collapse: min over X of min over u of J is
the minimum over both,

    min J(u, s; X)  s.t.  gap(X, u) >= 0,  s - u_t >= 0,  s + u_t >= 0,  area_e(X) >= bound,

in ``x = (q, u, s)``: node moves in units of their boxes, displacement unknowns, and one slip
magnitude per contact node if there is friction. This program is what ``joint`` solves; its
derivatives also give the energy gradient (5.7), (5.11) of ``nested`` and the audit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import Assembled, assemble
from rmesh_nlp.fem.energy import bulk_groups, displacement_field, friction_group, gap_group
from rmesh_nlp.fem.fields import ElementGroup, Field, constant_field
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
        (components, nodes) and (1, nodes), functions of the unknowns; slip is zero without friction.
    n_q, n_u, n_s : int
        Numbers of moves, displacement unknowns, slip magnitudes.
    n_contact, n_valid : int
        Numbers of gap rows and of validity rows.
    validity : ElementGroup
        The validity rows by themselves, numbered from zero, as functions of q.
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

    @property
    def gap_rows(self) -> slice:
        """Rows of the gaps."""
        return slice(0, self.n_contact)

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


def relocation(problem: ContactProblem) -> Relocation:
    """State the energy program of a problem, with assembled derivatives."""
    free = freedoms(problem)
    displacement, n_u = displacement_field(problem, first=free.n)
    n_contact = problem.contact_nodes.size
    frictional = problem.frictional
    n_s = n_contact if frictional else 0
    groups = [
        *bulk_groups(problem, free.positions, displacement),
        gap_group(problem, free.positions, displacement),
    ]
    n_rows = n_contact
    slip = constant_field(np.zeros((1, problem.mesh.p.shape[1])))
    if frictional:
        slip = slip_field(problem, first=free.n + n_u)
        groups.append(friction_group(problem, free.positions, slip))
        groups.append(slip_group(problem, displacement, slip, first_row=n_rows))
        n_rows += 2 * n_contact
    validity, area_bound = validity_group(problem, free)
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
    )


def slip_field(problem: ContactProblem, first: int) -> Field:
    """One unknown per contact node, numbered from ``first``; zero at all other nodes."""
    field = constant_field(np.zeros((1, problem.mesh.p.shape[1])))
    field.index[0, problem.contact_nodes] = first + np.arange(problem.contact_nodes.size)
    return field


def slip_group(problem: ContactProblem, displacement: Field, slip: Field, first_row: int) -> ElementGroup:
    """Rows ``s - u_t >= 0`` of all contact nodes, then ``s + u_t >= 0``."""
    nodes = problem.contact_nodes[None, :]
    rows = first_row + np.arange(2 * nodes.size).reshape(2, -1)
    return ElementGroup(slip_function(problem.obstacle), (displacement.at(nodes), slip.at(nodes)), rows)


def slip_function(obstacle: Obstacle) -> ca.Function:
    """``(u_i, s_i) -> (0, (s - u_t, s + u_t))`` of one contact node."""
    u, s = ca.SX.sym("u", 2), ca.SX.sym("s")
    slip = ca.dot(ca.DM(obstacle.tangent), u)
    return ca.Function("slip", [u, s], [0, ca.vertcat(s - slip, s + slip)])
