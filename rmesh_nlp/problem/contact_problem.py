"""A contact problem as its user describes it: frozen, and checked when it is made."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.display import Rows, describe, figure, html_table, plain_table, rich_table
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.reading import from_arrays
from rmesh_nlp.problem.checks import check
from rmesh_nlp.problem.coefficients import on_points, suitable_rule
from rmesh_nlp.problem.conditions import Dirichlet, ExactSolution, PointLoad, Traction, as_tuple
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.lines import onto_curves
from rmesh_nlp.problem.motion import Motion, Relative
from rmesh_nlp.problem.obstacle import NO_CONTACT, NO_NORMAL, Obstacle, Place
from rmesh_nlp.problem.units import NO_UNITS, Units, after

BY_VALIDITY = Motion(delta=None)
"""Motion limited by element validity alone."""

CLASH = 1e-12
"""Relative difference of two displacements given at one node that is rounding."""

KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "dirichlet": ((str, Dirichlet), "names of boundaries or Dirichlet"),
    "tractions": ((Traction,), "Traction"),
    "point_loads": ((PointLoad,), "PointLoad"),
    "obstacle": ((Obstacle,), "Obstacle"),
    "motion": ((Motion,), "Motion"),
}
"""What some fields of a problem consist of."""


@dataclass(frozen=True)
class ContactSet:
    """The contact nodes of one obstacle and the rows of their gaps among those of all obstacles."""

    number: int
    obstacle: Obstacle
    nodes: NDArray[np.int64]
    rows: NDArray[np.int64]


@dataclass(frozen=True)
class ContactProblem:
    """A contact problem on a mesh with movable nodes, checked when it is made.

    All numbers are in one consistent system of units; energies and forces are per unit thickness.

    Parameters
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries, and named subdomains for several laws.
    law : Laplace, PlaneStrain, PlaneStress, or a mapping from subdomain names to laws
        The material. A mapping must cover every triangle exactly once.
    dirichlet : tuple of str or Dirichlet, or one alone
        Where the displacement is given, in units of length; a plain name fixes all components at zero.
    obstacle : Obstacle or tuple of Obstacle
        The rigid foundations; by default ``NO_CONTACT``.
    motion : Motion
        How far each node may move; by default as far as the elements stay valid.
    tractions : tuple of Traction, or one alone
        Loads per area of named boundaries; none by default.
    quadrature : "auto", "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), or a degree. By default
        "auto", one that is exact for a polynomial load and of degree 8 for any other, see ``rule``.
    exact : ExactSolution, optional
        A known solution, for errors and the terms of Theorem 4.1.
    name, size : str
        Names of the problem and of its mesh in records and files; "problem" and "" by default.
    point_loads : tuple of PointLoad, or one alone
        Forces at single nodes; none by default.
    units : Units
        Names of the units, written in texts and figures only; none by default.
    reference : (2, 3, elements) array, optional
        Vertices of the triangles that distortions compare the elements with, in units of length; by default
        those of the mesh.

    Raises
    ------
    ProblemError
        If a name is unknown, numbers of components disagree, given displacements contradict each
        other or leave a rigid motion, or a value is not finite.
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
    size: str = ""
    point_loads: tuple[PointLoad, ...] = ()
    units: Units = NO_UNITS
    reference: Array | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name, (kinds, what) in KINDS.items():
            given = getattr(self, name)
            one_or_more = name in ("obstacle", "motion")
            every = () if given is None and not one_or_more else as_tuple(given)
            wrong = [one for one in every if not isinstance(one, kinds)]
            if wrong or isinstance(given, Mapping):
                part = "tractions" if name == "point_loads" else name
                raise ProblemError(part, f"{name} must be {what}, got {wrong[0] if wrong else given!r}")
            if not one_or_more:
                object.__setattr__(self, name, every)
        check(self)
        try:
            object.__setattr__(self, "mesh", onto_curves(self.mesh, self.motion.curves))
        except ValueError as error:
            raise ProblemError("curves", str(error)) from error

    def with_rule(self, rule: str | int) -> ContactProblem:
        """The same problem with another quadrature rule; no check depends on it, so none is repeated."""
        other = copy(self)
        object.__setattr__(other, "quadrature", rule)
        vars(other).pop("rule", None)
        return other

    @property
    def laws(self) -> tuple[Law, ...]:
        """The law of each region."""
        return tuple(self.law.values()) if isinstance(self.law, Mapping) else (self.law,)

    @cached_property
    def regions(self) -> tuple[tuple[Law, NDArray[np.int64]], ...]:
        """Each law with the numbers of its elements."""
        every = np.arange(self.mesh.t.shape[1])
        if not isinstance(self.law, Mapping):
            return ((self.law, every),)
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
        return tuple(o for o in as_tuple(self.obstacle) if o.boundary is not Place.NOWHERE)

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
        facets = [np.zeros(0, np.int64), *(np.asarray(self.mesh.boundaries[name]) for name in names)]
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
                clash = held[i, nodes] & (np.abs(value[i, nodes] - given) > CLASH * scale)
                if np.any(clash):
                    k = int(np.flatnonzero(clash)[0])
                    raise ProblemError(
                        "dirichlet",
                        f"{what} is {given[k]:.6g} at node {nodes[k]}, where another boundary gives "
                        f"{value[i, nodes[k]]:.6g}",
                    )
                held[i, nodes], value[i, nodes] = True, given
        return held, value

    def nodes_of(self, obstacle: Obstacle) -> NDArray[np.int64]:
        """Sorted numbers of the nodes at which an obstacle may be met."""
        place = obstacle.boundary
        return np.unique(self.mesh.t) if isinstance(place, Place) else self.boundary_nodes((place,))

    @cached_property
    def contact_sets(self) -> tuple[ContactSet, ...]:
        """Per obstacle the nodes whose gap depends on a displacement that is not given."""
        held, _ = self.held()
        sets, first = [], 0
        for number, obstacle in enumerate(self.obstacles):
            nodes = self.nodes_of(obstacle)
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

    def summary(self) -> Rows:
        """Mesh, laws, loads, contact and motion, as (label, value) rows for people."""
        mesh = self.mesh
        (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
        names = {n: np.size(f) for n, f in (mesh.boundaries or {}).items() if not n.startswith("gmsh:")}
        rows = [
            ("mesh", f"{mesh.p.shape[1]} nodes, {mesh.t.shape[1]} triangles"),
            ("extent", f"({figure(x0)}, {figure(x1)}) x ({figure(y0)}, {figure(y1)})"),
            ("boundaries (edges)", ", ".join(f"{name} ({count})" for name, count in names.items())),
        ]
        stress = after(self.units.stress)
        rows += [(f"law of {e.size} triangles", law.in_words(stress)) for law, e in self.regions]
        for label, conditions in (("given", self.supports), ("traction", self.tractions)):
            for one in conditions:
                rows.append((f"{label} on {one.boundary}", ", ".join(describe(v) for v in one.value)))
        for load in self.point_loads:
            rows.append((f"force at node {load.node}", ", ".join(figure(v) for v in load.force)))
        contact = [f"{part.nodes.size} nodes {part.obstacle.in_words()}" for part in self.contact_sets]
        return [*rows, ("contact", "; ".join(contact) or "none"), ("motion", self.motion.in_words())]

    def __rich__(self) -> Any:
        return rich_table(f"Contact problem {self.name!r}", self.summary())

    def __repr__(self) -> str:
        return plain_table(f"Contact problem {self.name!r}", self.summary())

    def _repr_html_(self) -> str:
        return html_table(f"Contact problem {self.name!r}", self.summary())


def refined(problem: ContactProblem, *, polygon: bool = False) -> ContactProblem:
    """The same problem with every triangle cut into four, names kept; move limits keep their widths.

    New nodes of a boundary with a curve are on the curve. With ``polygon`` they stay on the edges that
    they cut, and the motion has no curves: the domain is then that of the given mesh.
    """
    motion = problem.motion
    if isinstance(motion.delta, Relative):
        motion = replace(motion, delta=Relative(2 * motion.delta.fraction))
    if polygon:
        motion = replace(motion, curves={})
    return _on_mesh(problem, problem.mesh.refined(1), motion)


def locally_refined(problem: ContactProblem, elements: NDArray) -> ContactProblem:
    """The problem with some triangles refined, and what neighbours need; old nodes keep their numbers."""
    old = problem.mesh
    new = replace(old, _boundaries=None).refined(np.asarray(elements))
    kept = {tuple(edge) for edge in np.sort(new.facets, axis=0).T.tolist()}
    tree = cKDTree(new.p.T)

    def pieces(a: int, b: int) -> list[tuple[int, int]]:
        if (min(a, b), max(a, b)) in kept:
            return [(a, b)]
        middle = int(tree.query((old.p[:, a] + old.p[:, b]) / 2)[1])
        return [(a, middle), (middle, b)]

    boundaries = {
        name: np.array(
            [piece for edge in old.facets[:, np.asarray(facets)].T.tolist() for piece in pieces(*edge)]
        )
        for name, facets in (old.boundaries or {}).items()
    }
    subdomains = {name: np.asarray(e) for name, e in (new.subdomains or {}).items()}
    mesh = from_arrays(new.p.T, counter_clockwise(new.p, new.t).T, boundaries, subdomains)
    return _on_mesh(problem, mesh, problem.motion)


def _on_mesh(problem: ContactProblem, mesh: MeshTri, motion: Motion) -> ContactProblem:
    mesh = onto_curves(mesh, motion.curves, anywhere=True)
    return replace(problem, mesh=mesh, motion=motion, size=f"{mesh.t.shape[1]} triangles", reference=None)
