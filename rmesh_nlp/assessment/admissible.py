"""The energy of the continuous problem on a mesh: that of a displacement which is admissible everywhere.

Among the displacements that are linear on the triangles of a mesh and keep off the foundations by as much as
gaps along whole edges (in whole triangles) need, the one of least energy is found by one contact solve. Its
energy, with loads and friction integrated until two rules agree and on the domain of the true curves, is
never below the least energy of the continuous problem. By Theorem 4.1 it falls if and only if the error does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.assessment.energy import friction_energy, hat_integrals, load_vector, stiffness
from rmesh_nlp.assessment.standoff import Cells, cells_of
from rmesh_nlp.assessment.tightening import tightened
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import Directions
from rmesh_nlp.contact.system import LARGE, ActiveSet, ContactSystem, Equilibrium, elimination_order
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import locally_refined

REPEATS = 12
"""Contact solves with larger stand-offs, where normals vary along an edge."""

SLACK = 1e-9
"""Penetration, in parts of the largest gap or displacement, that is rounding."""

REFINEMENTS = 4
"""Times that triangles all of whose nodes are held are cut, where the foundation rises through them."""


@dataclass(frozen=True)
class Admissible:
    """A displacement that is admissible for the continuous problem, and its energy.

    Attributes
    ----------
    parts : Discretisation
        On the mesh of the displacement: locally refined where given displacements left no room.
    body : Body
    system : ContactSystem
        With the stand-offs, and friction bounded from above.
    state : Equilibrium
    displacement : (components, nodes) array
        At the nodes of the displacement space.
    standoff : (gaps,) array
        How far contact nodes keep off, in units of the gap.
    energy : float
        J of the continuous problem.
    strain, work, friction : float
        Its parts: ``energy = strain - work + friction``.
    doubt : float
        What quadrature may have changed in it.
    penetration : float
        What is left of penetration; positive only if the repeats did not suffice.
    """

    parts: Discretisation
    body: Body
    system: ContactSystem
    state: Equilibrium
    displacement: Array
    standoff: Array
    energy: float
    strain: float
    work: float
    friction: float
    doubt: float
    penetration: float

    @property
    def problem(self) -> ContactProblem:
        """That of the discretisation."""
        return self.parts.problem

    @property
    def status(self) -> Status:
        """CONVERGED if it is admissible and in equilibrium."""
        if self.state.status is not Status.CONVERGED:
            return self.state.status
        return Status.INACCURATE if self.penetration > 0 else Status.CONVERGED


class Continuous:
    """The continuous problem, restricted to displacements that are linear on the triangles of one mesh.

    Parameters
    ----------
    problem : ContactProblem or Discretisation
    nodes : (2, vertices) array, optional
        Positions of the vertices; those of the mesh by default.
    """

    def __init__(self, problem: ContactProblem | Discretisation, nodes: Array | None = None) -> None:
        self.parts = parts = discretise(problem)
        self.problem = parts.problem
        self.body = Body(self.problem, self.problem.mesh.p if nodes is None else nodes)
        self.space, self.field = parts.space, parts.displacement
        self.stiffness = stiffness(self.body, self.space)
        self.load, self._load_doubt = load_vector(self.body, self.space)
        self.given = self.field.values(np.zeros(parts.n_u))  # (components, nodes)
        self.directions = Directions(self.space, self.field, parts.n_u)
        self.cells = [
            cell for part in self.space.contact_sets for cell in cells_of(self.body, self.space, part)
        ]

    def system(self, standoff: Array) -> ContactSystem:
        """The quadratic program with gaps shortened by a stand-off (gaps,)."""
        free, given = np.flatnonzero(self.field.index.T.ravel() >= 0), self.given.T.ravel()
        pull = self.stiffness @ given
        nodes, space = self.body.nodes, self.space
        points = space.points(nodes)
        normals, tangents = self.directions.rows(nodes)
        gaps = [part.obstacle.distances(points[:, part.nodes]) for part in space.contact_sets]
        along = np.sum(self.directions.normals(nodes) * self.given[:, space.contact_nodes], axis=0)
        offset = np.concatenate([np.zeros(0), *gaps]) + along
        frictional = np.zeros(offset.size, dtype=bool)
        frictional[self.problem.friction_rows] = True
        rigid = self.parts.rigid_motions(nodes)
        order = None
        if space.n_nodes > LARGE:
            order = elimination_order(points, space.nodes_of(self.problem.mesh.facets), self.field.index)
        return ContactSystem(
            stiffness=sp.csc_array(self.stiffness[free][:, free]),
            load=(self.load - pull)[free],
            constant=float(0.5 * given @ pull - self.load @ given),
            normals=normals,
            tangents=tangents,
            offset=offset - standoff,
            slip_bound=self._bounds(),
            frictional=frictional,
            rigid=rigid if rigid.size else None,
            order=order,
        )

    def solve(self, start: ActiveSet | None = None) -> Admissible:
        """The admissible displacement of least energy, friction bounded from above."""
        standoff = self._first_standoff()
        system = self.system(standoff)
        state = _solved(system, start)
        left = 0.0
        if np.any(standoff) or self._is_curved:
            state, standoff, left = self._safe(system, state, standoff)
            closer = tightened(system, state, self.cells, self.field) if left == 0 else None
            if closer is not None and closer.energy < state.energy:
                standoff = np.where(closer.active.touching, self._gaps(closer.u), 0.0)
                state = closer
            system = self.system(standoff)
        return self._with_energy(system, state, standoff, left)

    def _safe(
        self, system: ContactSystem, state: Equilibrium, standoff: Array
    ) -> tuple[Equilibrium, Array, float]:
        """Stand-offs raised until no violation is left where normals vary; what is left else."""
        for _ in range(REPEATS):
            more = self._missing(state)
            left = float(np.max(more, initial=0.0))
            size = np.max(np.abs(state.u), initial=0.0) + np.max(np.abs(system.offset), initial=0.0)
            if left <= SLACK * size:
                return state, standoff, 0.0
            standoff = standoff + 1.1 * more
            system = replace(system, offset=system.offset - 1.1 * more)
            state = _solved(system, state.active)
        return state, standoff, left

    def _with_energy(
        self, system: ContactSystem, state: Equilibrium, standoff: Array, left: float
    ) -> Admissible:
        displacement = self.field.values(state.u)
        u = displacement.T.ravel()
        strain, work = 0.5 * float(u @ (self.stiffness @ u)), float(self.load @ u)
        frictions = []
        for part in self.space.contact_sets:
            if part.obstacle.frictional:
                edges = self.body.edges(str(part.obstacle.boundary))
                ends = displacement[:, self.space.nodes_of(edges.ends)]
                frictions.append(friction_energy(edges, part.obstacle, ends))
        friction = float(sum(np.sum(values) for values, _ in frictions))
        doubt = float(self._load_doubt @ np.abs(u)) + float(sum(np.sum(wrong) for _, wrong in frictions))
        parts = strain - work + friction, strain, work, friction, doubt
        return Admissible(self.parts, self.body, system, state, displacement, standoff, *parts, left)

    @property
    def _is_curved(self) -> bool:
        """Whether a foundation has other normals at other places."""
        return any(part.obstacle.level is not None for part in self.problem.contact_sets)

    def _gaps(self, u: Array) -> Array:
        """(gaps,) gaps at the nodes, without stand-offs."""
        bare = self.system(np.zeros(self.space.contact_nodes.size))
        return np.asarray(bare.normals @ u + bare.offset)

    def _bounds(self) -> Array:
        """(gaps,) integrals of the friction bound times the hat functions; empty without friction."""
        if not self.problem.frictional:
            return np.zeros(0)
        bounds = []
        for part in self.space.contact_sets:
            here = np.zeros(self.space.n_nodes)
            if part.obstacle.frictional:
                edges = self.body.edges(str(part.obstacle.boundary))
                shares = hat_integrals(edges.at, edges.size, part.obstacle.friction)[0]
                np.add.at(here, self.space.nodes_of(edges.ends), shares)
            bounds.append(here[part.nodes])
        return np.concatenate(bounds)

    def given_along(self, cells: Cells) -> Array:
        """(nodes,) given displacement along the normal of the foundation of some cells."""
        normals = cells.contact.obstacle.normals(self.space.points(self.body.nodes))
        return np.asarray(np.sum(normals * self.given, axis=0))

    def _first_standoff(self) -> Array:
        found = []
        for cells in self.cells:
            off, size = cells.off(self.given_along(cells)), np.max(np.abs(cells.distance), initial=0.0)
            found.append(np.where(off > SLACK * 1e-3 * size, off, 0.0))
        return self._raised(found)

    def _missing(self, state: Equilibrium) -> Array:
        displacement = self.field.values(state.u)
        return self._raised([cells.missing(displacement) for cells in self.cells])

    def _raised(self, off: Sequence[Array]) -> Array:
        """(gaps,) the largest ``off`` (m,) of the cells at each free node."""
        standoff = np.zeros(self.space.contact_nodes.size)
        for cells, one in zip(self.cells, off, strict=True):
            for rows in cells.rows:
                np.maximum.at(standoff, rows[rows >= 0], one[rows >= 0])
        return standoff


def admissible(
    problem: ContactProblem | Discretisation, nodes: Array | None = None, start: ActiveSet | None = None
) -> Admissible:
    """The energy of the continuous problem on a mesh, by an admissible displacement.

    Parameters
    ----------
    problem : ContactProblem or Discretisation
    nodes : (2, vertices) array, optional
        Positions of the vertices; those of the mesh by default.
    start : ActiveSet, optional
        Contact to begin with.
    """
    for _ in range(REFINEMENTS):
        here = Continuous(problem, nodes)
        inside = [cells for cells in here.cells if cells.nodes.shape[0] == 3]
        cut = [cells.number[cells.unreachable(here.given_along(cells))] for cells in inside]
        elements = np.concatenate([np.zeros(0, dtype=np.int64), *cut])
        if elements.size == 0:
            break
        moved = here.problem
        if nodes is not None:
            moved = replace(moved, mesh=relocated_mesh(moved.mesh, nodes))
        problem, nodes, start = locally_refined(moved, elements), None, None
    return here.solve(start)


def _solved(system: ContactSystem, start: ActiveSet | None) -> Equilibrium:
    """From a set that touched on this mesh or on a similar one; from a guess if that fails."""
    found = solve(system, start)
    return found if found.status is Status.CONVERGED or start is None else solve(system)
