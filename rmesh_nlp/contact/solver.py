"""The inner problem at any node positions: a contact problem becomes a quadratic program, and is solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.active_set import check_load, check_unique, solve
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import ROUNDING, Array, Symmetric, summed
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.contact_terms import friction, gaps
from rmesh_nlp.fem.energy import loads, strain
from rmesh_nlp.fem.fields import ElementGroup, Fields
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.problem.design import at_design

Design = Mapping[str, float]
"""Values of design variables by their names."""

NO_DESIGN: Design = {}
"""Of a problem without design variables."""


def contact_rows(
    parts: Discretisation, nodes: Array, at: Design = NO_DESIGN
) -> tuple[sp.csr_array, sp.csr_array, Array]:
    """Sparse rows (gaps, n_u) of normals and tangents, and normal displacements (gaps,) that are given.

    At vertex positions (2, vertices) and a design; in a scalar problem rows of tangents are empty.
    """
    index, given = parts.displacement.index, parts.displacement.values(np.zeros(parts.n_u))
    free, normals = np.argsort(index, axis=None)[index.size - parts.n_u :], _rows(parts, nodes, at)
    tangents = _rows(parts, nodes, at, along=True) if len(index) == 2 else sp.csr_array(normals.shape)
    return normals[:, free], tangents[:, free], normals @ given.ravel()


def _rows(parts: Discretisation, nodes: Array, at: Design, *, along: bool = False) -> sp.csr_array:
    """Rows for all displacement components, those of x first, as :func:`edge_gaps.directions`."""
    (components, n), entries, space = parts.displacement.shape, [np.zeros((3, 0))], parts.space
    for part in space.contact_sets:
        obstacle, factors = at_design(part.obstacle, at), part.factors
        for which, vertices, _ in space.kinds(part.nodes):
            carriers = space.carriers(part, which, vertices)
            vectors = space.normals(obstacle, nodes, carriers[: len(carriers) // factors.size])
            vectors = np.stack([vectors[1], -vectors[0]]) if along else vectors
            values = np.concatenate([factor * vectors for factor in factors], axis=1)
            row = np.broadcast_to(part.rows[which], values.shape)
            column = carriers + n * np.arange(components)[:, None, None]
            used = np.abs(values) > ROUNDING
            entries.append(np.stack([values[used], row[used], column[used]]))
    values, row, column = np.hstack(entries)
    return summed(values, row.astype(np.int32), column.astype(np.int32), (parts.n_contact, components * n))


def coefficients(space: DisplacementSpace, nodes: Array, at: Design = NO_DESIGN) -> Array | None:
    """(gaps,) Coulomb's coefficients at vertex positions (2, vertices) and a design; None where none is."""
    if space.problem.has_energy:
        return None
    points, values = space.points(nodes), np.zeros(space.contact_nodes.size)
    for part in space.contact_sets:
        if not part.obstacle.friction_law.has_energy:
            what = "Coulomb's coefficient"
            coulomb = at_design(part.obstacle.friction_law.slope, at)
            values[part.rows] = on_points(coulomb, points[:, part.nodes], what)
    return values


class ContactSolver:
    """Builds and solves the contact system of a problem for any positions of the vertices.

    It raises a ProblemError if only contact holds the body and the load does not press it on, or not in one
    place.

    Attributes
    ----------
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u (n_u,).
    contact_nodes : int array
        The node of every gap.
    normals, tangents : sparse arrays
        Those of the contact system on the initial mesh; where no foundation is curved, on every mesh.
    start : ActiveSet, optional
        With which the solve on the mesh as given begins.
    """

    def __init__(self, problem: ContactProblem | Discretisation, start: ActiveSet | None = None) -> None:
        self.discretisation = parts = discretise(problem)
        self.problem = problem = parts.problem
        if problem.motion.curves and not Body(problem, problem.mesh.p).is_upright():
            raise ProblemError("mesh", "the arc of a curve cuts through its triangle: take a finer mesh")
        self.start = start
        self.displacement, self.n_u = parts.displacement, parts.n_u
        self.contact_nodes = parts.space.contact_nodes
        on = Fields(parts.space, parts.vertices.positions, parts.displacement, parts.slip)
        self._elastic = _AtZero(parts, [*strain(on), *gaps(on)], self.n_u)
        self._loads = _AtZero(parts, loads(on, problem.rule), self.n_u)
        self._friction = _AtZero(parts, friction(on), parts.n_s)
        self._curved = any(part.level is not None for part in problem.obstacles)
        self.normals, self.tangents, _ = contact_rows(parts, problem.mesh.p, problem.start)
        if parts.floats:
            check_load(self.given_system, problem)
            check_unique(self.given_system, self.given, problem)

    def system(self, nodes: Array, design: Array | None = None) -> ContactSystem:
        """The quadratic program at vertex positions (2, vertices) and a design, by default the first one."""
        given, at = self.discretisation.vertices.values(nodes, design), self._named(design)
        (value, pull, offset), (work, push, _) = self._elastic(given), self._loads(given)
        bound, normals, tangents = np.zeros(self.contact_nodes.size), self.normals, self.tangents
        # the friction energy is linear in the slips: its gradient is their bounds
        bound[self.discretisation.friction_rows] = self._friction(given)[1]
        if self._curved:
            normals, tangents, _ = contact_rows(self.discretisation, nodes, at)
        return ContactSystem(
            stiffness=self._elastic.hessian(given),
            load=-pull - push,
            constant=value + work,
            normals=normals,
            tangents=tangents,
            offset=offset,
            slip_bound=bound,
            frictional=self.discretisation.space.frictional,
            rigid=self.discretisation.rigid_motions(nodes),
            coulomb=coefficients(self.discretisation.space, nodes, at),
        )

    def system_at(self, q: Array) -> ContactSystem:
        """The quadratic program at outer variables ``q`` (n_q,)."""
        free = self.discretisation.mesh_map
        return self.system(free.positions.values(q), free.design(q))

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solve at vertex positions (2, vertices), from the active set of the last one if given."""
        return solve(self.system(nodes), start)

    @cached_property
    def given_system(self) -> ContactSystem:
        """The quadratic program on the mesh as given, which shares its factors."""
        return self.system(self.problem.mesh.p)

    @cached_property
    def given(self) -> Equilibrium:
        """The contact solution on the mesh as given; whoever needs it shares it."""
        return solve(self.given_system, self.start)

    def work(self, nodes: Array, u: Array) -> float:
        """Work of the loads along a displacement at vertex positions."""
        value, push, _ = self._loads(self.discretisation.vertices.values(nodes))
        return -value - float(push @ u)

    def slips(self, nodes: Array, u: Array, design: Array | None = None) -> Array:
        """Displacements (gaps,) along the tangents at vertex positions (2, vertices) and a design."""
        if not self._curved:
            return self.tangents @ u
        return contact_rows(self.discretisation, nodes, self._named(design))[1] @ u

    def _named(self, design: Array | None) -> dict[str, float]:
        """Design variables by their names."""
        start = self.problem.start
        return start if design is None else dict(zip(start, design.tolist(), strict=True))


class _AtZero:
    """A sum over elements as a function of the vertex positions, its unknowns zero."""

    def __init__(self, parts: Discretisation, groups: Sequence[ElementGroup], n: int) -> None:
        self._sums = Assembled(groups, ca.MX.sym("x", n), parts.vertices.symbol, parts.n_contact)
        self._zero, self._no_forces = np.zeros(n), np.zeros(parts.n_contact)

    def __call__(self, given: Array) -> tuple[float, Array, Array]:
        """Value, gradient and rows."""
        value, gradient, rows, _ = self._sums.first(self._zero, given)
        return float(value[0]), gradient, rows

    @cached_property
    def _matrix(self) -> Symmetric:
        return Symmetric(self._sums.second.pattern)

    def hessian(self, given: Array) -> sp.csc_array:
        """The Hessian of the value."""
        (values,) = self._sums.second(self._zero, given, np.ones(1), self._no_forces)
        return self._matrix(values)
