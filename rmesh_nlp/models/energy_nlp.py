"""The energy NLP: node relocation as one nonlinear program in outer variables, displacement and slip.

With the energy as outer objective the two levels collapse: min over X of min over u of J is
the minimum over both,

    min J(u, s; X)  s.t.  gap(X, u) >= 0,  s - u_t >= 0,  s + u_t >= 0,  area_e(X) >= bound,

in ``x = (q, u, s)``: outer variables q in units of their move limits, displacement unknowns, and one slip
magnitude per contact node with friction. ``joint`` solves it; its derivatives also give the energy gradient
(5.7), (5.11) of ``nested`` and of the assessment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.discretisation import Discretisation, Numbering, discretise
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.contact_terms import gaps, slips
from rmesh_nlp.fem.fields import ElementGroup, Field, Fields
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY, energy
from rmesh_nlp.mapping.validity import Validity
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class Relocation:
    """The energy NLP and where its parts are.

    Attributes
    ----------
    groups : tuple of ElementGroup
        Of the objective, of the gaps and of the two slip rows of each contact node.
    displacement, slip : Field
        (components, nodes) and (obstacles, nodes), functions of ``x``; slip is zero where there is no
        friction.
    validity : Validity
        The validity rows by themselves; none where a barrier stands in their place.
    length : float
        Unit of displacements, slips and gaps in ``x`` and the rows.
    """

    parts: Discretisation
    x: ca.MX
    groups: tuple[ElementGroup, ...]
    displacement: Field
    slip: Field
    validity: Validity
    objective: Objective = ENERGY
    length: float = 1.0

    @cached_property
    def assembled(self) -> Assembled:
        """Objective, all rows and derivatives by ``x``, each built when it is first asked for."""
        valid = self.validity.upright_group.shifted(self.rows["valid"].start)
        return Assembled((*self.groups, valid), self.x, ca.MX(0, 1), self.rows.size)

    @cached_property
    def nlp(self) -> NLP:
        """The NLP with its derivatives; rows: gaps, the two slip rows of each contact node, validity."""
        free, rest = self.parts.mesh_map, np.full(self.unknowns.size - self.parts.n_q, np.inf)
        return NLP(
            x=self.x,
            p=ca.MX(0, 1),
            f=self.assembled.f,
            g=self.assembled.g,
            lbx=np.concatenate([free.lower, -rest]),
            ubx=np.concatenate([free.upper, rest]),
            lbg=np.append(np.zeros(self.parts.pairs.size), self.validity.bound),
            ubg=np.full(self.rows.size, np.inf),
            derivatives=self.assembled.derivatives,
            parts={name: self.x[place] for name, place in self.unknowns.places.items()},
        )

    @cached_property
    def unknowns(self) -> Numbering:
        """Where q, u and s are in ``x``."""
        return Numbering(q=self.parts.n_q, u=self.parts.n_u, slip=self.parts.n_s)

    @cached_property
    def rows(self) -> Numbering:
        """Where the rows are: ``gaps``, ``minus``, ``plus`` and ``valid``."""
        return Numbering(**self.parts.pairs.sizes, valid=self.n_valid)

    @property
    def n_valid(self) -> int:
        """Number of validity rows."""
        return self.validity.size

    def split(self, x: Array) -> tuple[Array, Array, Array]:
        """Outer variables, displacements and slips of ``x``, the last two in the unit of the problem."""
        q, u, s = self.unknowns.split(x)
        return q, u * self.length, s * self.length

    def joined(self, q: Array, u: Array, s: Array) -> Array:
        """The unknowns ``x`` of outer variables, displacements and slips in the unit of the problem."""
        return np.concatenate([q, u / self.length, s / self.length])

    def forces(self, lam_g: Array) -> tuple[Array, Array]:
        """Contact forces, normal and (n_s,) tangential, that multipliers of the NLP are."""
        # CasADi's multiplier of an active lower bound is negative
        normal, minus, plus, _ = self.rows.split(-lam_g / self.length)
        return normal, plus - minus

    def multipliers(self, normal_force: Array, friction: Array) -> Array:
        """Of all rows, by contact forces, normal and (n_s,) tangential: those of both slips as one."""
        forces = np.zeros(self.rows.size)
        forces[self.rows["gaps"]], forces[self.rows["plus"]] = normal_force, friction
        return forces

    def nodes(self, q: Array) -> Array:
        """Node positions (2, nodes)."""
        return self.parts.mesh_map.positions.values(q)


def relocation(
    problem: ContactProblem | Discretisation, objective: Objective = ENERGY, length: float = 1.0
) -> Relocation:
    """Build the energy NLP of a problem, with assembled derivatives.

    The objective is the energy, to which terms in the positions alone may be added: the levels collapse with
    them too. With any other term, a ValueError, the inner problem must stay a constraint. A distortion is
    infinite where an element degenerates and undefined beyond; it then stands in the place of the element
    areas, which are constraints only if a least angle is asked for as well. Displacements, slips and gaps are
    measured in units of ``length``.
    """
    if not objective.collapses:
        raise BadInputError(f"{objective.text!r} is not the energy with terms in the positions alone")
    parts = discretise(problem)
    free, n_u, n_s, n_contact = parts.mesh_map, parts.n_u, parts.n_s, parts.n_contact
    replaced = objective.has_barrier and parts.problem.motion.min_angle == 0
    validity = parts.validity.without_rows() if replaced else parts.validity
    displacement = parts.displacement.in_units(length).numbered_from(free.n)
    slip = parts.slip.in_units(length).numbered_from(free.n + n_u)
    fields = Fields(parts.space, free.positions, displacement, slip)
    rows = [*gaps(fields), *slips(fields, n_contact)]
    if length != 1:
        rows = [group.in_units(length) for group in rows]
    groups = (*energy(fields), *objective.in_positions.on(fields).groups, *rows)
    return Relocation(
        parts,
        ca.MX.sym("x", free.n + n_u + n_s),
        groups,
        displacement,
        slip,
        validity,
        objective,
        length,
    )
