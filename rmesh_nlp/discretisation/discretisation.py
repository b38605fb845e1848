"""The discretisation of a problem: what its contact model and all its programs are made of.

Unknowns of each kind (moves q, displacements u, slips s, contact forces) are numbered from zero here. A
program puts them one after the other, each field :meth:`~rmesh_nlp.fem.fields.Field.numbered_from` where
its kind begins, and sums the same element terms on these fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.fem.assembly import Assembled, assemble
from rmesh_nlp.fem.contact_terms import friction_terms, gap_field, gap_terms, slip_field, slip_terms
from rmesh_nlp.fem.energy import displacement_field, load_terms, strain_terms
from rmesh_nlp.fem.fields import ElementGroup, ElementTerm, Field
from rmesh_nlp.fem.objective import Objective, scaled_group
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import Validity, validity
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.vectorised import USUAL, AssemblySettings


@dataclass(frozen=True)
class Discretisation:
    """Fields, element terms and validity rows of one problem, each made when first asked for, and kept.

    Attributes
    ----------
    problem : ContactProblem
    assembly : AssemblySettings
        How its sums over elements are evaluated.
    """

    problem: ContactProblem
    assembly: AssemblySettings = USUAL

    @cached_property
    def mesh_map(self) -> MeshMap:
        """The moves of the nodes: the field of positions as a function of q, and the boxes."""
        return MeshMap.of(self.problem)

    @cached_property
    def displacement(self) -> Field:
        """(components, nodes), a function of u."""
        return self._displacement[0]

    @cached_property
    def slip(self) -> Field:
        """(obstacles, nodes), slip magnitudes as a function of s; zero where there is no friction."""
        return slip_field(self.problem)

    @cached_property
    def contact_force(self) -> Field:
        """(obstacles, nodes), normal contact forces as a function of one unknown per gap."""
        return gap_field(self.problem)

    @property
    def n_q(self) -> int:
        """Number of moves."""
        return self.mesh_map.n

    @property
    def n_u(self) -> int:
        """Number of displacement unknowns."""
        return self._displacement[1]

    @cached_property
    def contact_nodes(self) -> NDArray[np.int64]:
        """(n_contact,) the node of every gap."""
        return self.problem.contact_nodes

    @cached_property
    def friction_rows(self) -> NDArray[np.int64]:
        """(n_s,) numbers of the gaps at which friction may act."""
        return self.problem.friction_rows

    @property
    def n_contact(self) -> int:
        """Number of gaps."""
        return int(self.contact_nodes.size)

    @property
    def n_s(self) -> int:
        """Number of slip magnitudes."""
        return int(self.friction_rows.size)

    @cached_property
    def strain(self) -> tuple[ElementTerm, ...]:
        """Strain energy, of positions and displacement."""
        return tuple(strain_terms(self.problem))

    @cached_property
    def loads(self) -> tuple[ElementTerm, ...]:
        """Minus the work of all loads by the problem's rule, of positions and displacement."""
        return tuple(load_terms(self.problem, self.problem.rule))

    @cached_property
    def friction(self) -> tuple[ElementTerm, ...]:
        """Friction energy, of positions and slip."""
        return tuple(friction_terms(self.problem))

    @cached_property
    def gaps(self) -> tuple[ElementTerm, ...]:
        """A row per gap, of positions and displacement."""
        return tuple(gap_terms(self.problem))

    @cached_property
    def slips(self) -> tuple[ElementTerm, ...]:
        """Two rows per gap with friction, of positions, displacement and slip."""
        return tuple(slip_terms(self.problem))

    @cached_property
    def validity(self) -> Validity:
        """Rows of the elements that the boxes alone do not keep valid."""
        return validity(self.problem, self.mesh_map, self.assembly)

    def assemble(self, groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int) -> Assembled:
        """Sum element groups, see :func:`rmesh_nlp.fem.assembly.assemble`."""
        return assemble(groups, x, p, n_rows, self.assembly)

    def bulk(self, positions: Field, displacement: Field) -> list[ElementGroup]:
        """The energy without friction on these fields."""
        return [term.on(positions, displacement) for term in (*self.strain, *self.loads)]

    def energy(self, positions: Field, displacement: Field, slip: Field) -> list[ElementGroup]:
        """The total potential energy (3.3), (3.15) on these fields."""
        return [*self.bulk(positions, displacement), *(term.on(positions, slip) for term in self.friction)]

    def objective(
        self, objective: Objective, positions: Field, displacement: Field, slip: Field
    ) -> list[ElementGroup]:
        """An outer objective on these fields; its energy is made of the same terms."""
        groups = []
        for weight, term in objective.terms:
            if term.name == "energy":
                found = self.energy(positions, displacement, slip)
            else:
                found = term.groups(self.problem, positions, displacement, slip)
            groups += [scaled_group(group, weight) for group in found]
        return groups

    def with_rule(self, rule: str | int) -> Discretisation:
        """The same with loads by another rule; what was made and does not depend on it is shared."""
        other = Discretisation(self.problem.with_rule(rule), self.assembly)
        kept = {name: made for name, made in vars(self).items() if name not in ("problem", "loads")}
        vars(other).update(kept)
        return other

    @cached_property
    def _displacement(self) -> tuple[Field, int]:
        return displacement_field(self.problem)


def discretise(
    problem: ContactProblem | Discretisation, assembly: AssemblySettings | None = None
) -> Discretisation:
    """The discretisation of a problem; one that is given is handed on as it is."""
    return problem if isinstance(problem, Discretisation) else Discretisation(problem, assembly or USUAL)
