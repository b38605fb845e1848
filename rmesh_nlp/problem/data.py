"""What a contact problem consists of, before it is checked, and what follows from it on its mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from skfem import MeshTri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import ROUNDING, Array, Index, Mask, magnitude, numbers_of
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import counter_clockwise, nodes_of
from rmesh_nlp.problem.coefficients import Coefficient, as_tuple, on_points
from rmesh_nlp.problem.conditions import Dirichlet, ExactSolution, LoadStep, PointLoad, Traction
from rmesh_nlp.problem.design import Constraint, DesignVariable, Shape, at_design
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.motion import Motion
from rmesh_nlp.problem.obstacle import NO_CONTACT, Obstacle, Place
from rmesh_nlp.problem.pairs import matched
from rmesh_nlp.problem.quadrature import exact_rule
from rmesh_nlp.problem.switches import HIGH, polynomial_degree
from rmesh_nlp.problem.units import NO_UNITS, Units

BY_VALIDITY = Motion()
"""Motion limited by element validity alone."""


@dataclass(frozen=True)
class ContactSet:
    """The contact nodes of one obstacle and the rows of their gaps among those of all obstacles.

    Of a problem they are vertices, of a displacement space its nodes. A gap depends on the displacement of a
    node less that of its ``partner`` (all nodes,), what it meets if that is no foundation at rest: of a pair
    the node of the second boundary at each one of the first, itself at the end of a crack, -1 elsewhere; a
    tool, which comes after the nodes.
    """

    number: int
    obstacle: Obstacle
    nodes: Index
    rows: Index
    partner: Index | None = None

    def relative(self, values: Array) -> Array:
        """Values (..., nodes), less those of the partner where a node has one."""
        if self.partner is None:
            return values
        own = values[..., : self.partner.size]
        return own - np.where(self.partner >= 0, values[..., self.partner], 0.0)

    def carriers(self, nodes: Index) -> Index:
        """(1 or 2, ...) nodes (...) and what they meet, if that moves."""
        return np.stack([nodes, *([] if self.partner is None else [self.partner[nodes]])])

    @property
    def factors(self) -> Array:
        """(1 or 2,) factors of their displacements."""
        return np.array([1.0] if self.partner is None else [1.0, -1.0])


@dataclass(frozen=True)
class ProblemData:
    """The fields of a :class:`rmesh_nlp.ContactProblem`, unchecked, with the sets of nodes that they name."""

    mesh: MeshTri
    law: Law | Mapping[str, Law]
    dirichlet: tuple[str | Dirichlet, ...]
    obstacle: Obstacle | tuple[Obstacle, ...] = NO_CONTACT
    motion: Motion = BY_VALIDITY
    tractions: tuple[Traction, ...] = ()
    quadrature: str | int = "auto"
    exact: ExactSolution | None = None
    name: str = "problem"
    size: str = ""
    point_loads: tuple[PointLoad, ...] = ()
    order: int = 1
    design: tuple[DesignVariable | Shape, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    units: Units = NO_UNITS
    steps: tuple[LoadStep, ...] = ()
    origin: Array | None = field(default=None, compare=False, repr=False)
    numbers: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)
    reference: Array | None = field(default=None, compare=False, repr=False)

    @property
    def start(self) -> dict[str, float]:
        """Each design variable's first value, by its name."""
        return {variable.name: variable.start for variable in self.design}

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Those of the design variables that move boundaries."""
        return tuple(variable for variable in self.design if isinstance(variable, Shape))

    @property
    def n_vertices(self) -> int:
        """Number of the nodes of the mesh."""
        return self.mesh.p.shape[1]

    @property
    def laws(self) -> tuple[Law, ...]:
        """The law of each region."""
        return tuple(self.laws_by_name.values())

    @property
    def laws_by_name(self) -> Mapping[str, Law]:
        """The law of each subdomain, or one alone by the name ""."""
        return self.law if isinstance(self.law, Mapping) else {"": self.law}

    @cached_property
    def regions(self) -> tuple[tuple[Law, Index], ...]:
        """Each law with the numbers of its elements."""
        every = np.arange(self.mesh.nelements)
        if not isinstance(self.law, Mapping):
            return ((self.law, every),)
        return tuple((law, every[self.mesh.subdomains[name]]) for name, law in self.law.items())

    @cached_property
    def rule(self) -> str | int:
        """The quadrature rule itself: "midpoint" or a degree."""
        return self.quadrature if self.quadrature != "auto" else self.exact_rule or HIGH

    @cached_property
    def exact_rule(self) -> str | int | None:
        """The cheapest rule that is exact for the loads on straight triangles and edges; None if none is."""
        loads = [part for law in self.laws for part in law.load]
        tractions = [part for traction in self.tractions for part in traction.value]
        return exact_rule(loads, tractions, self.order + (polynomial_degree(self.measure) or 0))

    @property
    def locking(self) -> tuple[float, ...]:
        """Poisson's ratios for which linear triangles are much too stiff; none at order 2."""
        return tuple(law.locking for law in self.laws if self.order == 1 and law.locking)

    @property
    def components(self) -> int:
        """Number of displacement components, 1 or 2."""
        return self.laws[0].components

    @property
    def measure(self) -> Coefficient:
        """Measure of the laws, one for all."""
        return self.laws[0].measure

    def measured(self, points: Array) -> Array | float:
        """The measure (...) at points (2, ...); one number where it does not vary."""
        return on_points(self.measure, points, "the measure") if callable(self.measure) else self.measure

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles."""
        return as_tuple(self.obstacle)

    @cached_property
    def first_obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles at the first design."""
        return tuple(at_design(obstacle, self.start) for obstacle in self.obstacles)

    @property
    def frictional(self) -> bool:
        """Whether contact is with friction anywhere."""
        return any(obstacle.friction_law for obstacle in self.obstacles)

    @property
    def supports(self) -> tuple[Dirichlet, ...]:
        """``dirichlet`` with plain names written out as zeros."""
        zero = (0.0,) * self.components
        return tuple(Dirichlet(d, zero) if isinstance(d, str) else d for d in self.dirichlet)

    @property
    def has_energy(self) -> bool:
        """Whether the displacement minimises an energy: friction depends on the pressure nowhere."""
        return all(obstacle.friction_law.has_energy for obstacle in self.obstacles)

    @cached_property
    def triangles(self) -> Index:
        """(3, elements) vertex numbers, each triangle counter-clockwise."""
        return counter_clockwise(self.mesh.p, self.mesh.t)

    @cached_property
    def curve_of_facet(self) -> Index:
        """(facets,) number of the curve of the motion that each facet is on; -1 for straight ones."""
        numbers = np.full(self.mesh.nfacets, -1)
        for number, name in enumerate(self.motion.curves):
            numbers[self.mesh.boundaries[name]] = number
        return numbers

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The curves of the motion by their numbers."""
        return tuple(self.motion.curves.values())

    def edges_by_curve(self, boundary: str) -> list[tuple[int, Index]]:
        """Edges (2, n) of a boundary, for each curve with its number; straight ones with -1."""
        facets = np.unique(self.mesh.boundaries[boundary])
        curve = self.curve_of_facet[facets]
        numbers = np.unique(curve).tolist()
        return [(k, self.mesh.facets[:, facets[curve == k]]) for k in numbers]

    def boundary_nodes(self, *names: str) -> Index:
        """Sorted numbers of the nodes on the named boundaries."""
        return np.unique(numbers_of(nodes_of(self.mesh, name) for name in names))

    @property
    def axisymmetric(self) -> bool:
        """Whether the body is one of revolution about x = 0."""
        return self.laws[0].axisymmetric

    @cached_property
    def on_axis(self) -> Mask:
        """(vertices,) whether a vertex is on the axis of a body of revolution."""
        return self.axisymmetric & (np.abs(self.mesh.p[0]) <= ROUNDING * magnitude(self.mesh.p))

    @cached_property
    def held(self) -> tuple[Mask, Array]:
        """Where displacement components are given, and their values: two (components, nodes) arrays."""
        shape = (self.components, self.n_vertices)
        held, value = np.zeros(shape, dtype=bool), np.zeros(shape)
        for support in self.supports:
            nodes = self.boundary_nodes(support.boundary)
            what = f"the displacement given on {support.boundary!r}"
            for i, coefficient in enumerate(support.value):
                if coefficient is None:
                    continue
                given = on_points(coefficient, self.mesh.p[:, nodes], what)
                scale = max(1.0, magnitude(given))
                clash = held[i, nodes] & (np.abs(value[i, nodes] - given) > ROUNDING * scale)
                for k in np.flatnonzero(clash):
                    raise ProblemError(
                        "dirichlet",
                        f"{what} is {given[k]:.6g} at node {nodes[k]}, where another boundary gives "
                        f"{value[i, nodes[k]]:.6g}",
                    )
                held[i, nodes], value[i, nodes] = True, given
        if self.components == 2:
            for k in np.flatnonzero(self.on_axis & (np.abs(value[0]) > 0)):
                raise ProblemError(
                    "dirichlet",
                    f"on the axis u_r is 0: node {k} cannot have the given displacement {value[0, k]:g}",
                )
            held[0, self.on_axis] = True
        return held, value

    def nodes_of(self, obstacle: Obstacle) -> Index:
        """Sorted numbers of the nodes at which an obstacle may be met."""
        place = obstacle.boundary
        return np.unique(self.mesh.t) if isinstance(place, Place) else self.boundary_nodes(place)

    @cached_property
    def tools(self) -> tuple[int, ...]:
        """Numbers of the obstacles that a force moves."""
        return tuple(number for number, each in enumerate(self.obstacles) if each.force is not None)

    @property
    def tools_held(self) -> Mask:
        """(components, tools) where they do not move."""
        moves = np.array([self.obstacles[number].moves for number in self.tools], dtype=bool)
        return ~moves.reshape(-1, self.components).T

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Per obstacle the vertices whose gap depends on a displacement that is not given."""
        nodes = [self.nodes_of(obstacle) for obstacle in self.obstacles]
        held = np.hstack([self.held[0], self.tools_held])
        return self.sets_among(nodes, self.partners, self.mesh.p, held)

    @cached_property
    def partners(self) -> tuple[Index | None, ...]:
        """What the vertices meet on each obstacle, see :class:`ContactSet`."""
        result: list[Index | None] = []
        for number, obstacle in enumerate(self.obstacles):
            partner = None
            if isinstance(obstacle.boundary, str) and obstacle.other:
                partner = np.full(self.n_vertices, -1)
                own, others = matched(self.mesh, obstacle.boundary, obstacle.other, ("contact", number))
                partner[own] = others
            elif number in self.tools:
                n = self.n_vertices
                partner = np.full(n, n + self.tools.index(number))
            result.append(partner)
        return tuple(result)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The names of the two boundaries of each pair."""
        return tuple((str(one.boundary), one.other) for one in self.obstacles if one.other)

    @property
    def tied(self) -> tuple[tuple[int, int], ...]:
        """(node, leader) of nodes that move alike: those of the motion, and the two nodes of each pair."""
        pairs = ((node, leader) for leader, node in self.matches.T.tolist() if node != leader)
        return (*self.motion.tied, *pairs)

    @property
    def matches(self) -> Index:
        """(2, k) the nodes of all pairs, a crack's ends included."""
        parts = zip(self.partners, self.obstacles, strict=True)
        pairs = [partner for partner, obstacle in parts if partner is not None and obstacle.other]
        return np.hstack([np.zeros((2, 0), np.int64), *([np.flatnonzero(p >= 0), p[p >= 0]] for p in pairs)])

    def sets_among(
        self, nodes: Sequence[Index], partners: Sequence[Index | None], points: Array, held: Mask
    ) -> tuple[ContactSet, ...]:
        """Per obstacle those of its ``nodes`` whose gap depends on a displacement that is not given.

        ``points`` (2, nodes) are all nodes, ``held`` (components, nodes and tools) says which components are
        given.
        """
        sets, first = [], 0
        for number, obstacle in enumerate(self.obstacles):
            own, partner = nodes[number], partners[number]
            free = ~held[:, own]
            if partner is not None:
                free = (free | ~held[:, partner[own]]) & (partner[own] != own)
            seen = np.abs(self.first_obstacles[number].normals(points[:, own])) > ROUNDING
            own = own[np.any(free & seen, axis=0)].astype(np.int64)
            sets.append(ContactSet(number, obstacle, own, first + np.arange(own.size), partner))
            first += own.size
        return tuple(sets)

    def given_gaps(self, contact: ContactSet) -> tuple[Index, Array, float]:
        """Vertices of an obstacle that have a given displacement, their first gaps, and the size of these."""
        obstacle = self.first_obstacles[contact.number]
        nodes = np.setdiff1d(self.nodes_of(obstacle), contact.nodes)
        where, (held, value) = self.mesh.p[:, nodes], self.held
        given = contact.relative(np.pad(np.where(held, value, 0.0), ((0, 0), (0, len(self.tools)))))
        if nodes.size == 0:
            return nodes, np.zeros(0), 1e-300
        distance = obstacle.distances(where)
        along = np.sum(obstacle.normals(where) * given[:, nodes], axis=0)
        size = max(1e-300, magnitude(distance), magnitude(along))
        return nodes, distance + along, size

    @property
    def contact_nodes(self) -> Index:
        """The node of every gap, obstacle by obstacle; a node of two obstacles is there twice."""
        return numbers_of(part.nodes for part in self.contact_sets)

    @property
    def kink_nodes(self) -> Index:
        """Contact nodes at kinks of foundations: they do not move, and coarser meshes keep them."""
        parts = [
            part.nodes[np.isclose(self.mesh.p[0, part.nodes, None], part.obstacle.kinks).any(axis=1)]
            for part in self.contact_sets
        ]
        return numbers_of(parts)
