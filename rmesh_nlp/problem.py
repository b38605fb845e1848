"""What a user states: a frozen contact problem on a mesh whose nodes may move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from skfem import MeshTri

from rmesh_nlp.coefficients import Coefficient, PiecewiseLinear, PositionFunction, at, on_points
from rmesh_nlp.evaluation import Array
from rmesh_nlp.laws import Elastic, Laplace, Law, PlaneStrain, PlaneStress
from rmesh_nlp.moves import Motion, Relative
from rmesh_nlp.obstacle import NO_CONTACT, Obstacle, Place

__all__ = [
    "NO_CONTACT",
    "Coefficient",
    "ContactProblem",
    "Dirichlet",
    "Elastic",
    "ExactSolution",
    "Laplace",
    "Law",
    "Motion",
    "Obstacle",
    "PiecewiseLinear",
    "Place",
    "PlaneStrain",
    "PlaneStress",
    "PositionFunction",
    "Relative",
    "Traction",
    "at",
    "signed_areas",
]


BY_VALIDITY = Motion(delta=None)
"""Motion limited by element validity alone."""


@dataclass(frozen=True)
class Traction:
    """A load per unit length on a named boundary, one coefficient per component."""

    boundary: str
    value: tuple[Coefficient, ...]


@dataclass(frozen=True)
class Dirichlet:
    """Displacement given on a named boundary.

    ``value`` has one entry per component: a number, a function of position, or None where the
    component is free. Nodes held at a function of position do not move: sliding along curved
    data would let the optimiser lower the energy by representing the data worse.
    """

    boundary: str
    value: tuple[Coefficient | None, ...]


@dataclass(frozen=True)
class ExactSolution:
    """A known solution: ``value(x, y)`` of the displacement and its energy J(u)."""

    value: PositionFunction
    energy: float


@dataclass(frozen=True)
class ContactProblem:
    """A contact problem on a mesh with movable nodes.

    Attributes
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries.
    law : Laplace, PlaneStrain, PlaneStress, or a mapping from subdomain names to laws
        A mapping must cover every triangle exactly once.
    dirichlet : tuple of str or Dirichlet
        Where the displacement is given; a plain name holds all components at zero.
    obstacle : Obstacle
        ``NO_CONTACT`` by default.
    motion : Motion
    tractions : tuple of Traction
    quadrature : "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), or a degree.
    exact : ExactSolution, optional
    name, size : str
        For records and file names.

    Raises
    ------
    ValueError
        If a name is unknown, numbers of components disagree, held values contradict each
        other or are too few to hold the body, or a value is not finite.
    """

    mesh: MeshTri
    law: Law | Mapping[str, Law]
    dirichlet: tuple[str | Dirichlet, ...]
    obstacle: Obstacle = NO_CONTACT
    motion: Motion = BY_VALIDITY
    tractions: tuple[Traction, ...] = ()
    quadrature: str | int = "midpoint"
    exact: ExactSolution | None = None
    name: str = "problem"
    size: str = field(default="")

    def __post_init__(self) -> None:
        _check_names(self)
        _check_laws(self)
        _check_components(self)
        for node in self.motion.numbers:
            if not 0 <= node < self.mesh.p.shape[1]:
                raise ValueError(f"the motion names node {node}; nodes run to {self.mesh.p.shape[1] - 1}")
        held, value = self.held()
        _check_held(self, held)
        _check_friction(self, held, value)
        if self.obstacle.boundary is not Place.NOWHERE and self.contact_nodes.size == 0:
            raise ValueError("no node of the contact set is free to move: it is held as a whole")
        contact, where = self.contact_nodes, self.mesh.p[:, self.contact_nodes]
        on_points(self.obstacle.offset, where, "the obstacle")
        bound = on_points(self.obstacle.friction, where, "the friction bound")
        if contact.size and not np.min(bound) >= 0:
            node = contact[np.argmin(bound)]
            raise ValueError(f"the friction bound must not be negative, got {np.min(bound)} at node {node}")

    @property
    def laws(self) -> tuple[Law, ...]:
        """The law of each region."""
        return tuple(self.law.values()) if isinstance(self.law, Mapping) else (self.law,)

    @property
    def regions(self) -> tuple[tuple[Law, NDArray[np.int64]], ...]:
        """Each law with the numbers of its elements."""
        if not isinstance(self.law, Mapping):
            return ((self.law, np.arange(self.mesh.t.shape[1])),)
        return tuple((law, np.asarray(self.mesh.subdomains[name])) for name, law in self.law.items())

    @property
    def components(self) -> int:
        """Number of displacement components, 1 or 2."""
        return self.laws[0].components

    @property
    def frictional(self) -> bool:
        """Whether contact is with friction."""
        return self.obstacle.frictional

    @property
    def supports(self) -> tuple[Dirichlet, ...]:
        """``dirichlet`` with plain names written out as zeros."""
        zero = (0.0,) * self.components
        return tuple(Dirichlet(d, zero) if isinstance(d, str) else d for d in self.dirichlet)

    @property
    def triangles(self) -> NDArray[np.int64]:
        """(3, elements) vertex numbers, each triangle counter-clockwise."""
        p, t = self.mesh.p, np.array(self.mesh.t, dtype=np.int64)
        clockwise = signed_areas(p, t) < 0
        t[1:, clockwise] = t[:0:-1, clockwise]
        return t

    def boundary_nodes(self, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Sorted numbers of the nodes on the named boundaries."""
        facets = [self.mesh.boundaries[name] for name in names]
        if not facets:
            return np.zeros(0, np.int64)
        return np.unique(self.mesh.facets[:, np.concatenate(facets)]).astype(np.int64)

    def held(self) -> tuple[NDArray[np.bool_], Array]:
        """Where displacement components are given, and their values: two (components, nodes) arrays."""
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
                    raise ValueError(
                        f"{what} is {given[k]:.6g} at node {nodes[k]}, where another boundary gives "
                        f"{value[i, nodes[k]]:.6g}"
                    )
                held[i, nodes], value[i, nodes] = True, given
        return held, value

    @property
    def contact_nodes(self) -> NDArray[np.int64]:
        """Nodes of the contact set whose gap depends on a displacement that is not given."""
        place = self.obstacle.boundary
        if place is Place.NOWHERE:
            return np.zeros(0, np.int64)
        nodes = np.unique(self.mesh.t) if isinstance(place, Place) else self.boundary_nodes((place,))
        normal = np.array(self.obstacle.normal) != 0
        held, _ = self.held()
        return nodes[np.any(~held[:, nodes] & normal[:, None], axis=0)].astype(np.int64)


def signed_areas(nodes: NDArray, triangles: NDArray) -> NDArray:
    """Signed area of each triangle, positive if counter-clockwise.

    ``nodes`` is (2, nodes), ``triangles`` (3, elements).
    """
    a, b, c = (nodes[:, vertex] for vertex in triangles)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]))


def _check_names(problem: ContactProblem) -> None:
    mesh = problem.mesh
    if type(mesh).__name__ != "MeshTri1":
        raise ValueError(f"the mesh must be a skfem.MeshTri of first order, got {type(mesh).__name__}")
    if not np.all(np.abs(signed_areas(mesh.p, mesh.t)) > 0):
        bad = int(np.flatnonzero(~(np.abs(signed_areas(mesh.p, mesh.t)) > 0))[0])
        raise ValueError(f"element {bad} of the mesh has no area")
    if not problem.dirichlet:
        raise ValueError("at least one boundary must be held (dirichlet), or the energy has no minimum")
    known = sorted(mesh.boundaries or {})
    used = [d if isinstance(d, str) else d.boundary for d in problem.dirichlet]
    used += [*problem.motion.names, *(t.boundary for t in problem.tractions)]
    if isinstance(problem.obstacle.boundary, str):
        used.append(problem.obstacle.boundary)
    for name in used:
        if name not in known:
            raise ValueError(f"the mesh has no boundary named {name!r}; it has {', '.join(known) or 'none'}")
        if np.size(mesh.boundaries[name]) == 0:
            raise ValueError(f"the boundary {name!r} of the mesh is empty")


def _check_laws(problem: ContactProblem) -> None:
    if not isinstance(problem.law, Mapping):
        return
    known = sorted(problem.mesh.subdomains or {})
    count = np.zeros(problem.mesh.t.shape[1], dtype=int)
    for name in problem.law:
        if name not in known:
            raise ValueError(f"the mesh has no subdomain named {name!r}; it has {', '.join(known) or 'none'}")
        count[np.asarray(problem.mesh.subdomains[name])] += 1
    if np.any(count != 1):
        bad = int(np.flatnonzero(count != 1)[0])
        raise ValueError(f"element {bad} of the mesh has {count[bad]} laws: every element needs exactly one")
    if len({law.components for law in problem.laws}) != 1:
        raise ValueError("the laws of the subdomains mix scalar and elastic problems")


def _check_components(problem: ContactProblem) -> None:
    n, obstacle = problem.components, problem.obstacle
    if obstacle.boundary is not Place.NOWHERE and len(obstacle.normal) != n:
        raise ValueError(
            f"the contact normal {obstacle.normal} has {len(obstacle.normal)} components, "
            f"the displacement has {n}"
        )
    for traction in problem.tractions:
        if len(traction.value) != n:
            raise ValueError(f"traction {traction.value} on {traction.boundary!r} needs {n} values")
    for support in problem.supports:
        if len(support.value) != n:
            raise ValueError(
                f"the displacement {support.value} given on {support.boundary!r} needs {n} values"
            )


def _check_friction(problem: ContactProblem, held: NDArray[np.bool_], value: Array) -> None:
    """With friction a contact node may be held along the tangent at zero, and not otherwise."""
    if not problem.frictional:
        return
    nodes = problem.contact_nodes
    oblique = np.all(np.array(problem.obstacle.normal) != 0)
    bad = nodes[np.any(held[:, nodes] & (oblique | (value[:, nodes] != 0)), axis=0)]
    if bad.size:
        raise ValueError(
            f"contact node {bad[0]} has friction and one given displacement component: with friction it must "
            "be zero and along the tangent"
        )


def _check_held(problem: ContactProblem, held: NDArray[np.bool_]) -> None:
    """Every connected part of the mesh must be held against all rigid motions."""
    mesh = problem.mesh
    n_nodes = mesh.p.shape[1]
    edges = sp.coo_array((np.ones(mesh.facets.shape[1]), tuple(mesh.facets)), shape=(n_nodes, n_nodes))
    _, part = connected_components(edges, directed=False)
    for number in np.unique(part[mesh.t[0]]):
        nodes = np.flatnonzero(part == number)
        x, y = mesh.p[:, nodes] - mesh.p[:, nodes].mean(axis=1, keepdims=True)
        one, zero = np.ones(nodes.size), np.zeros(nodes.size)
        size = max(float(np.max(np.abs([x, y]))), 1e-300)
        modes = [[one]] if problem.components == 1 else [[one, zero], [zero, one], [-y / size, x / size]]
        rows = np.array([np.concatenate(mode)[held[:, nodes].ravel()] for mode in modes])
        if np.linalg.matrix_rank(rows, tol=1e-9) < len(modes):
            raise ValueError(
                f"the part of the mesh with node {nodes[0]} can still move as a rigid body: the given "
                "displacements must prevent it, contact alone does not"
            )
