"""The inner problem at any node positions: a contact problem becomes a quadratic program, and is solved."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.active_set import check_load, check_unique, solve
from rmesh_nlp.contact.system import LARGE, ActiveSet, ContactSystem, Equilibrium, elimination_order
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, numbered
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.obstacle import NO_NORMAL


@dataclass(frozen=True)
class Directions:
    """Normals and tangents at the contact nodes of a space.

    Attributes
    ----------
    space : DisplacementSpace
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    """

    space: DisplacementSpace
    displacement: Field
    n_u: int

    def normals(self, nodes: Array) -> Array:
        """Unit normals (components, gaps) at vertex positions (2, vertices)."""
        points = self.space.points(nodes)
        parts = [part.obstacle.normals(points[:, part.nodes]) for part in self.space.contact_sets]
        return np.hstack([np.zeros((self.space.problem.components, 0)), *parts])

    def rows(self, nodes: Array) -> tuple[sp.csr_array, sp.csr_array]:
        """Sparse rows (gaps, n_u) of normals and tangents; a scalar problem has no tangents."""
        normals = self.normals(nodes)
        if self.space.problem.components == 1:
            return self._rows(normals), sp.csr_array((0, self.n_u))
        return self._rows(normals), self._rows(np.stack([normals[1], -normals[0]]))

    def _rows(self, vectors: Array) -> sp.csr_array:
        """Rows that take the component of the displacement along ``vectors`` (components, gaps)."""
        index = self.displacement.index[:, self.space.contact_nodes]
        if index.size == 0:
            return sp.csr_array((0, self.n_u))
        row = np.broadcast_to(np.arange(index.shape[1]), index.shape)
        used = (np.abs(vectors) > NO_NORMAL) & (index >= 0)
        return sp.csr_array((vectors[used], (row[used], index[used])), shape=(index.shape[1], self.n_u))


class ContactSolver:
    """Builds and solves the contact system of a problem for any positions of the vertices.

    Parameters
    ----------
    problem : ContactProblem or Discretisation

    Raises
    ------
    ProblemError
        If only contact holds the body and the load does not press it on, or not in one place.

    Attributes
    ----------
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    contact_nodes : int array
        The node of every gap.
    frictional : bool array
        Whether friction may act there.
    normals, tangents : sparse arrays
        Those of the contact system on the initial mesh; where no foundation is curved, on every mesh.
    """

    def __init__(self, problem: ContactProblem | Discretisation) -> None:
        self.discretisation = parts = discretise(problem)
        self.problem = problem = parts.problem
        self.displacement, self.n_u = parts.displacement, parts.n_u
        self.contact_nodes = parts.contact_nodes
        n_gaps = parts.n_contact
        positions, X = parts.vertices.positions, parts.vertices.symbol
        u = ca.MX.sym("u", self.n_u)
        groups = [term.on(positions, self.displacement) for term in (*parts.strain, *parts.gaps)]
        inner = parts.assemble(groups, u, X, n_gaps)
        self._kept = [inner]  # CasADi does not own the callbacks of its derivatives
        zero = ca.MX.zeros(self.n_u)
        value, gradient = inner.grad_f(zero, X)
        gap = ca.Function("gap", [u, X], [inner.g])(zero, X)
        hessian = inner.hess_lag(zero, X, 1.0, ca.MX.zeros(n_gaps))
        dense = [ca.densify(part) for part in (-gradient, value, gap)]  # a constant gap may be a sparse zero
        self._evaluate = Evaluator(ca.Function("contact_system", [X], [hessian, *dense]))
        self._loads = _Loads(parts)
        self._stiffness = Symmetric(numbered(hessian.sparsity()))
        self._curved = any(part.level is not None for part in problem.obstacles)
        self._directions = Directions(parts.space, self.displacement, self.n_u)
        self.normals, self.tangents = self._directions.rows(problem.mesh.p)
        self.frictional = np.zeros(n_gaps, dtype=bool)
        self.frictional[parts.friction_rows] = True
        if problem.frictional:  # the friction energy is linear in the slips: its gradient is their bounds
            s = ca.MX.sym("s", parts.n_s)
            friction = parts.assemble([term.on(positions, parts.slip) for term in parts.friction], s, X, 0)
            self._kept.append(friction)
            bounds = ca.densify(friction.grad_f(ca.MX.zeros(parts.n_s), X)[1])
            self._bounds = Evaluator(ca.Function("bounds", [X], [bounds]))
        self._check()

    def with_rule(self, rule: str | int) -> ContactSolver:
        """The same with loads by another quadrature rule; all that does not depend on it is shared."""
        other = copy(self)
        other.discretisation = self.discretisation.with_rule(rule)
        other.problem = other.discretisation.problem
        other._loads = _Loads(other.discretisation)
        other._check()
        return other

    def _check(self) -> None:
        """Whether the load presses a body on that contact alone holds."""
        if self.discretisation.floats:
            system = self.system(self.problem.mesh.p)
            check_load(system)
            check_unique(system, solve(system))

    def system(self, nodes: Array) -> ContactSystem:
        """The quadratic program at vertex positions (2, vertices)."""
        given = self.discretisation.vertices.values(nodes)
        hessian, held, constant, offset = self._evaluate(given)
        work, load = self._loads(given)
        normals, tangents = self.normals, self.tangents
        if self._curved:
            normals, tangents = self._directions.rows(nodes)
        return ContactSystem(
            stiffness=self._stiffness(hessian),
            load=held + load,
            constant=float(constant[0]) + work,
            normals=normals,
            tangents=tangents,
            offset=offset,
            slip_bound=self._slip_bound(given),
            frictional=self.frictional,
            rigid=self.discretisation.rigid_motions(nodes) if self.discretisation.floats else None,
            order=self._order,
        )

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solve at vertex positions (2, vertices), from the active set of the last one if given."""
        return solve(self.system(nodes), start)

    def strain_and_friction(self, nodes: Array, u: Array) -> tuple[float, float]:
        """Strain energy and friction energy of a displacement at vertex positions."""
        given = self.discretisation.vertices.values(nodes)
        hessian, pull, constant, _ = self._evaluate(given)
        strain = 0.5 * float(u @ (self._stiffness(hessian) @ u)) - float(pull @ u) + float(constant[0])
        bound = self._slip_bound(given)
        return strain, float(bound @ np.abs(self.slips(nodes, u))) if bound.size else 0.0

    def slips(self, nodes: Array, u: Array) -> Array:
        """Displacements (gaps,) along the tangents at vertex positions (2, vertices)."""
        turns = self._curved and self.problem.frictional
        return np.asarray((self._directions.rows(nodes)[1] if turns else self.tangents) @ u)

    def _slip_bound(self, given: Array) -> Array:
        """(gaps,) the largest friction forces; empty without friction."""
        bound = np.zeros(self.frictional.size if self.problem.frictional else 0)
        if bound.size:
            bound[self.frictional] = self._bounds(given)[0]
        return bound

    @cached_property
    def _order(self) -> Index | None:
        """The order of elimination on a large mesh."""
        mesh, space = self.problem.mesh, self.discretisation.space
        if space.n_nodes <= LARGE:
            return None
        return elimination_order(space.points(mesh.p), space.nodes_of(mesh.facets), self.displacement.index)


class _Loads:
    """Minus the work of the loads on the given displacements, and the nodal forces (n_u,), by one rule."""

    def __init__(self, parts: Discretisation) -> None:
        positions, X, u = parts.vertices.positions, parts.vertices.symbol, ca.MX.sym("u", parts.n_u)
        groups = [term.on(positions, parts.displacement) for term in parts.loads]
        self._kept = parts.assemble(groups, u, X, 0)
        value, gradient = self._kept.grad_f(ca.MX.zeros(parts.n_u), X)
        self._evaluate = Evaluator(ca.Function("loads", [X], [ca.densify(value), -ca.densify(gradient)]))

    def __call__(self, given: Array) -> tuple[float, Array]:
        value, force = self._evaluate(given)
        return float(value[0]), force
