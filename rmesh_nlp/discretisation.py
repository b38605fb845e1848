"""The discretisation of a problem: what its contact solver and all its models are made of.

Unknowns of each kind (outer variables q, displacements u, slips s, contact forces) are numbered from zero; a
model puts them one after the other (:class:`Numbering`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.contact_terms import gap_field, slip_field
from rmesh_nlp.fem.energy import displacement_field
from rmesh_nlp.fem.fields import Field, Fields, Forces
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.mapping.mesh_map import MeshMap, VertexParameters
from rmesh_nlp.mapping.validity import Validity, validity
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.rigid import rigid_motions

Scalar = TypeVar("Scalar", bound=np.generic)


class Numbering:
    """Parts of a vector one after the other: ``Numbering(q=3, u=5)["u"]`` is ``slice(3, 8)``."""

    def __init__(self, **sizes: int) -> None:
        self.sizes = sizes
        self._ends = np.cumsum([0, *sizes.values()]).tolist()
        self.places = dict(zip(sizes, (slice(*ends) for ends in pairwise(self._ends)), strict=True))

    @property
    def size(self) -> int:
        """Number of entries of all parts."""
        return self._ends[-1]

    def __getitem__(self, name: str) -> slice:
        return self.places[name]

    def split(self, values: NDArray[Scalar]) -> list[NDArray[Scalar]]:
        """The parts of a vector, or of the rows of a matrix."""
        return [values[place] for place in self.places.values()]


@dataclass(frozen=True)
class Discretisation:
    """Space and fields of one problem; validity rows and positions as parameters when first asked for.

    Attributes
    ----------
    space : DisplacementSpace
        Nodes, gaps, weights, values for output.
    mesh_map : MeshMap
        The vertex positions as a function of q, and the move limits.
    displacement : Field
        (components, nodes), a function of u.
    slip : Field
        (obstacles, nodes), slip magnitudes as a function of s; zero where there is no friction.
    contact_force : Field
        (obstacles, nodes), normal contact forces as a function of one unknown per gap.
    n_q, n_u, n_contact, n_s : int
        Numbers of outer variables, displacement unknowns, gaps, and slip magnitudes.
    friction_rows : (n_s,) array
        Numbers of the gaps at which friction may act.
    floats : bool
        Whether contact alone prevents some rigid motion.
    """

    problem: ContactProblem
    space: DisplacementSpace
    mesh_map: MeshMap
    displacement: Field
    slip: Field
    contact_force: Field
    n_q: int
    n_u: int
    n_contact: int
    n_s: int
    friction_rows: Index
    floats: bool

    @cached_property
    def unknowns(self) -> Numbering:
        """The unknowns ``(q, u, lambda, s, mu-, mu+)`` of the KKT conditions of contact."""
        friction = dict.fromkeys(("slip", "friction_minus", "friction_plus"), self.n_s)
        return Numbering(q=self.n_q, u=self.n_u, normal_force=self.n_contact, **friction)

    @cached_property
    def pairs(self) -> Numbering:
        """The complementarity pairs: gaps, ``s - u_t >= 0`` and ``s + u_t >= 0`` where friction may act."""
        return Numbering(gaps=self.n_contact, minus=self.n_s, plus=self.n_s)

    @cached_property
    def vertices(self) -> VertexParameters:
        """The vertex positions as parameters of what is solved at positions that are given."""
        return VertexParameters(self.problem)

    def rigid_motions(self, nodes: Array) -> Array | None:
        """(n_u, motions) the rigid motions at vertex positions (2, vertices) that only contact prevents."""
        if not self.floats:
            return None
        free, motions = self.displacement.index >= 0, self.space.rigid_motions(nodes)
        result = np.zeros((self.n_u, len(motions)))
        for k, motion in enumerate(motions):
            result[self.displacement.index[free], k] = motion[free]
        return result

    @cached_property
    def validity(self) -> Validity:
        """Rows of the elements that the move limits alone do not keep valid."""
        return validity(self.problem, self.mesh_map)

    def fields(self, length: float = 1.0) -> Fields:
        """All fields as functions of ``x = (q, u, lambda, s, mu-, mu+)``, the unknowns of the KKT conditions.

        Displacement and slip are in units of ``length``.
        """
        _, u, normal, slip, minus, plus = (place.start for place in self.unknowns.places.values())
        return Fields(
            self.space,
            self.mesh_map.positions,
            self.displacement.in_units(length).numbered_from(u),
            self.slip.in_units(length).numbered_from(slip),
            Forces(
                self.contact_force.numbered_from(normal),
                self.slip.numbered_from(minus),
                self.slip.numbered_from(plus),
            ),
        )


def discretise(problem: ContactProblem | Discretisation) -> Discretisation:
    """The discretisation of a problem; one that is given is handed on as it is."""
    if isinstance(problem, Discretisation):
        return problem
    space, mesh_map = DisplacementSpace(problem), MeshMap.of(problem)
    displacement, n_u = displacement_field(space)
    friction_rows = np.flatnonzero(space.frictional)
    return Discretisation(
        problem,
        space,
        mesh_map,
        displacement,
        slip_field(space),
        gap_field(space),
        mesh_map.n,
        n_u,
        space.contact_nodes.size,
        friction_rows.size,
        friction_rows,
        rigid_motions(problem).size > 0,
    )
