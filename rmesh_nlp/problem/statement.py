"""What a contact problem consists of, before it is checked: mesh, laws, supports, loads, contact, motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.problem.coefficients import Coefficient, PositionFunction, on_points
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.motion import Motion
from rmesh_nlp.problem.obstacle import NO_CONTACT, Obstacle, Place
from rmesh_nlp.problem.quadrature import suitable_rule
from rmesh_nlp.problem.units import NO_UNITS, Units

NO_NORMAL = 1e-12
"""Components of a unit normal below this are none."""

BY_VALIDITY = Motion(delta=None)
"""Motion limited by element validity alone."""


@dataclass(frozen=True)
class Traction:
    """A load per unit length on a named boundary, one coefficient per component."""

    boundary: str
    value: tuple[Coefficient, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _tuple(self.value))


@dataclass(frozen=True)
class PointLoad:
    """A force per unit thickness at one node, one number per component.

    The node does not move: the load would go with it. In the plane the energy under a point load has
    no bound as the mesh is refined, so energies of different meshes do not compare.

    Attributes
    ----------
    node : int
    force : tuple of float
    """

    node: int
    force: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", _tuple(self.force))


@dataclass(frozen=True)
class ContactSet:
    """The contact nodes of one obstacle and the rows of their gaps among those of all obstacles."""

    number: int
    obstacle: Obstacle
    nodes: NDArray[np.int64]
    rows: NDArray[np.int64]


@dataclass(frozen=True)
class Dirichlet:
    """Displacement given on a named boundary.

    ``value`` has one entry per component: a number, a function of position, or None where the
    component is free. Nodes held at a function of position do not move: sliding along curved
    data would let the optimiser lower the energy by representing the data worse.
    """

    boundary: str
    value: tuple[Coefficient | None, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _tuple(self.value))


def _tuple(value: Any) -> tuple[Any, ...]:
    """One thing alone as a tuple of one."""
    several = isinstance(value, Iterable) and not isinstance(value, str) and not callable(value)
    return tuple(value) if several else (value,)


@dataclass(frozen=True)
class ExactSolution:
    """A known solution, or a reference in its place.

    Attributes
    ----------
    value : function of position
        The displacement.
    energy : float
        Its energy J(u).
    symbol : casadi.SX or casadi.MX
        Kind of CasADi symbol that ``value`` takes: SX, or MX for what SX cannot express.
    """

    value: PositionFunction
    energy: float
    symbol: Any = ca.SX


@dataclass(frozen=True)
class Statement:
    """A contact problem as it is stated, see :class:`rmesh_nlp.problem.ContactProblem`.

    Attributes
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries.
    law : Laplace, PlaneStrain, PlaneStress, or a mapping from subdomain names to laws
        A mapping must cover every triangle exactly once.
    dirichlet : tuple of str or Dirichlet, or one alone
        Where the displacement is given; a plain name holds all components at zero.
    obstacle : Obstacle or tuple of Obstacle
        ``NO_CONTACT`` by default; several for several contact boundaries or foundations.
    motion : Motion
    tractions : tuple of Traction, or one alone
    quadrature : "auto", "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), a degree, or one that is
        exact for the load if it is a polynomial and of high degree else, see ``rule``.
    exact : ExactSolution, optional
    name, size : str
        For records and file names.
    point_loads : tuple of PointLoad, or one alone
    units : Units
        Names of units, only for people: texts and pictures.
    reference : (2, 3, elements) array, optional
        Vertices of the triangles that distortions compare the elements with; by default those of the mesh.
    """

    mesh: MeshTri
    law: Law | Mapping[str, Law]
    dirichlet: tuple[str | Dirichlet, ...]
    obstacle: Obstacle | tuple[Obstacle, ...] = NO_CONTACT
    motion: Motion = BY_VALIDITY
    tractions: tuple[Traction, ...] = ()
    quadrature: str | int = "auto"
    exact: ExactSolution | None = None
    name: str = "problem"
    size: str = field(default="")
    point_loads: tuple[PointLoad, ...] = ()
    units: Units = NO_UNITS
    reference: Array | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        """One support, traction or point load may stand alone; what is something else is refused."""
        for name, kinds, what in (
            ("dirichlet", (str, Dirichlet), "names of boundaries or Dirichlet"),
            ("tractions", (Traction,), "Traction"),
            ("point_loads", (PointLoad,), "PointLoad"),
            ("obstacle", (Obstacle,), "Obstacle"),
            ("motion", (Motion,), "Motion"),
        ):
            given = getattr(self, name)
            every = () if given is None else _tuple(given)
            wrong = [one for one in every if not isinstance(one, kinds)]
            if wrong or isinstance(given, Mapping):
                part = "tractions" if name == "point_loads" else name
                raise ProblemError(part, f"{name} must be {what}, got {wrong[0] if wrong else given!r}")
            if name not in ("obstacle", "motion"):
                object.__setattr__(self, name, every)

    @property
    def laws(self) -> tuple[Law, ...]:
        """The law of each region."""
        return tuple(self.law.values()) if isinstance(self.law, Mapping) else (self.law,)

    @cached_property
    def regions(self) -> tuple[tuple[Law, NDArray[np.int64]], ...]:
        """Each law with the numbers of its elements."""
        if not isinstance(self.law, Mapping):
            return ((self.law, np.arange(self.mesh.t.shape[1])),)
        every = np.arange(self.mesh.t.shape[1])
        return tuple((law, every[np.asarray(self.mesh.subdomains[name])]) for name, law in self.law.items())

    @cached_property
    def rule(self) -> str | int:
        """The quadrature rule itself: "midpoint" or a degree."""
        if self.quadrature != "auto":
            return self.quadrature
        loads = [part for law in self.laws for part in law.load]
        return suitable_rule(loads, [part for traction in self.tractions for part in traction.value])

    @property
    def components(self) -> int:
        """Number of displacement components, 1 or 2."""
        return self.laws[0].components

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles; none for ``NO_CONTACT``."""
        given = self.obstacle if isinstance(self.obstacle, tuple) else (self.obstacle,)
        return tuple(obstacle for obstacle in given if obstacle.boundary is not Place.NOWHERE)

    @property
    def frictional(self) -> bool:
        """Whether contact is with friction anywhere."""
        return any(obstacle.frictional for obstacle in self.obstacles)

    @property
    def supports(self) -> tuple[Dirichlet, ...]:
        """``dirichlet`` with plain names written out as zeros."""
        zero = (0.0,) * self.components
        return tuple(Dirichlet(d, zero) if isinstance(d, str) else d for d in self.dirichlet)

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
        """(3, elements) vertex numbers, each triangle counter-clockwise."""
        return counter_clockwise(self.mesh.p, self.mesh.t)

    @cached_property
    def curve_of_facet(self) -> NDArray[np.int64]:
        """(facets,) number of the curve of the motion that each facet is on; -1 for straight ones."""
        found = np.full(self.mesh.facets.shape[1], -1)
        for number, name in enumerate(self.motion.curves):
            found[np.asarray(self.mesh.boundaries[name])] = number
        return found

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The curves of the motion by their numbers."""
        return tuple(self.motion.curves.values())

    def edges_by_curve(self, boundary: str) -> list[tuple[int, NDArray[np.int64]]]:
        """Edges (2, n) of a boundary, for each curve with its number; straight ones with -1."""
        facets = np.unique(np.asarray(self.mesh.boundaries[boundary]))
        curve = self.curve_of_facet[facets]
        numbers = np.unique(curve).tolist()
        return [(k, self.mesh.facets[:, facets[curve == k]].astype(np.int64)) for k in numbers]

    def boundary_nodes(self, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Sorted numbers of the nodes on the named boundaries."""
        facets = [self.mesh.boundaries[name] for name in names]
        if not facets:
            return np.zeros(0, np.int64)
        return np.unique(self.mesh.facets[:, np.concatenate(facets)]).astype(np.int64)

    def held(self) -> tuple[NDArray[np.bool_], Array]:
        """Where displacement components are given, and their values: two (components, nodes) arrays."""
        return self._held

    @cached_property
    def _held(self) -> tuple[NDArray[np.bool_], Array]:
        shape = (self.components, self.mesh.p.shape[1])
        held, value = np.zeros(shape, dtype=bool), np.zeros(shape)
        for support in self.supports:
            nodes = self.boundary_nodes((support.boundary,))
            what = f"the displacement given on {support.boundary!r}"
            for i, coefficient in enumerate(support.value):
                if coefficient is None:
                    continue
                given = on_points(coefficient, self.mesh.p[:, nodes], what)
                scale = max(1.0, float(np.max(np.abs(given), initial=0.0)))
                clash = held[i, nodes] & (np.abs(value[i, nodes] - given) > 1e-12 * scale)
                if np.any(clash):
                    k = int(np.flatnonzero(clash)[0])
                    raise ProblemError(
                        "dirichlet",
                        f"{what} is {given[k]:.6g} at node {nodes[k]}, where another boundary gives "
                        f"{value[i, nodes[k]]:.6g}",
                    )
                held[i, nodes], value[i, nodes] = True, given
        return held, value

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Per obstacle the nodes whose gap depends on a displacement that is not given."""
        held, _ = self.held()
        sets, first = [], 0
        for number, obstacle in enumerate(self.obstacles):
            place = obstacle.boundary
            nodes = np.unique(self.mesh.t) if isinstance(place, Place) else self.boundary_nodes((place,))
            seen = np.abs(obstacle.normals(self.mesh.p[:, nodes])) > NO_NORMAL
            nodes = nodes[np.any(~held[:, nodes] & seen, axis=0)].astype(np.int64)
            sets.append(ContactSet(number, obstacle, nodes, first + np.arange(nodes.size)))
            first += nodes.size
        return tuple(sets)

    @property
    def contact_nodes(self) -> NDArray[np.int64]:
        """The node of every gap, obstacle by obstacle; a node of two obstacles is there twice."""
        return np.concatenate([np.zeros(0, np.int64), *(part.nodes for part in self.contact_sets)])

    @property
    def friction_rows(self) -> NDArray[np.int64]:
        """Numbers of those gaps at which friction may act."""
        rows = [part.rows for part in self.contact_sets if part.obstacle.frictional]
        return np.concatenate([np.zeros(0, np.int64), *rows])
