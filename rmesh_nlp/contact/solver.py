"""The inner problem at any node positions: a contact problem becomes a quadratic program, and is solved."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.contact.active_set import check_load, check_unique, solve
from rmesh_nlp.contact.system import LARGE, ActiveSet, ContactSystem, Equilibrium, elimination_order
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, numbered
from rmesh_nlp.fem.fields import Field, unknown_field
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.obstacle import NO_NORMAL
from rmesh_nlp.problem.rigid import rigid_motions


@dataclass(frozen=True)
class Directions:
    """Normals and tangents at the contact nodes of a problem.

    Attributes
    ----------
    problem : ContactProblem
    displacement : Field
        (components, nodes), the displacement as a function of the unknowns u.
    n_u : int
    """

    problem: ContactProblem
    displacement: Field
    n_u: int

    def normals(self, nodes: Array) -> Array:
        """Unit normals (components, gaps) at node positions (2, nodes)."""
        parts = [part.obstacle.normals(nodes[:, part.nodes]) for part in self.problem.contact_sets]
        return np.hstack([np.zeros((self.problem.components, 0)), *parts])

    def rows(self, nodes: Array) -> tuple[sp.csr_array, sp.csr_array]:
        """Sparse rows (gaps, n_u) of normals and tangents; a scalar problem has no tangents."""
        normals = self.normals(nodes)
        return self._rows(normals), self._tangents(normals)

    def _tangents(self, normals: Array) -> sp.csr_array:
        if self.problem.components == 1:
            return sp.csr_array((0, self.n_u))
        return self._rows(np.stack([normals[1], -normals[0]]))

    def _rows(self, vectors: Array) -> sp.csr_array:
        """Rows that take the component of the displacement along ``vectors`` (components, gaps)."""
        nodes = self.problem.contact_nodes
        if nodes.size == 0:
            return sp.csr_array((0, self.n_u))
        index = self.displacement.index[:, nodes]
        row = np.broadcast_to(np.arange(index.shape[1]), index.shape)
        used = (np.abs(vectors) > NO_NORMAL) & (index >= 0)
        return sp.csr_array((vectors[used], (row[used], index[used])), shape=(index.shape[1], self.n_u))


class ContactSolver:
    """Builds the contact system of a problem for any node positions.

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
        n_nodes = problem.mesh.p.shape[1]
        self._given = given = _Given(problem)
        positions, X = given.positions, given.symbol
        u = ca.MX.sym("u", self.n_u)
        terms = (*parts.strain, *parts.gaps)
        inner = parts.assemble(
            [term.on(positions, self.displacement) for term in terms], u, X, self.contact_nodes.size
        )
        zero = ca.MX.zeros(self.n_u)
        value, gradient = inner.grad_f(zero, X)
        gap = ca.densify(
            ca.Function("gap", [u, X], [inner.g])(zero, X)
        )  # a constant gap may be a sparse zero
        no_rows = ca.MX.zeros(self.contact_nodes.size)
        hessian = inner.hess_lag(zero, X, 1.0, no_rows)
        self._kept = [inner]
        self._evaluate = Evaluator(
            ca.Function("contact_system", [X], [hessian, ca.densify(-gradient), ca.densify(value), gap])
        )
        self._loads = _Loads(parts)
        self._stiffness = Symmetric(numbered(hessian.sparsity()))
        self._curved = any(part.level is not None for part in problem.obstacles)
        self._directions = Directions(problem, self.displacement, self.n_u)
        self.normals, self.tangents = self._directions.rows(problem.mesh.p)
        self.frictional = np.zeros(self.contact_nodes.size, dtype=bool)
        self.frictional[parts.friction_rows] = True
        self._friction = problem.frictional
        if self._friction:
            shape = (len(problem.obstacles), n_nodes)
            slip = ca.MX.sym("s", shape[0] * n_nodes)
            groups = [term.on(positions, unknown_field(shape)) for term in parts.friction]
            friction = parts.assemble(groups, slip, X, 0)
            weights = friction.grad_f(ca.MX.zeros(slip.shape[0]), X)[1]
            self._kept.append(friction)
            self._weights = Evaluator(ca.Function("weights", [X], [weights]))
            numbers = [np.full(part.nodes.size, part.number) for part in problem.contact_sets]
            self._weight_of = self.contact_nodes * shape[0] + np.concatenate(numbers)
        self._floats = rigid_motions(problem).size > 0
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
        if self._floats:
            system = self.system(self.problem.mesh.p)
            check_load(system)
            check_unique(system, solve(system))

    def system(self, nodes: Array) -> ContactSystem:
        """The quadratic program at node positions (2, nodes)."""
        hessian, held, constant, offset = self._evaluate(self._given(nodes))
        work, load = self._loads(nodes)
        stiffness = self._stiffness(hessian)
        bound = self._weights(self._given(nodes))[0][self._weight_of] if self._friction else np.zeros(0)
        normals, tangents = self.normals, self.tangents
        if self._curved:
            normals, tangents = self._directions.rows(nodes)
        return ContactSystem(
            stiffness,
            held + load,
            float(constant[0]) + work,
            normals,
            tangents,
            offset,
            bound,
            self.frictional,
            self._rigid(nodes) if self._floats else None,
            self._order,
        )

    def strain_and_friction(self, nodes: Array, u: Array) -> tuple[float, float]:
        """Strain energy and friction energy of a displacement at node positions."""
        given = self._given(nodes)
        hessian, pull, constant, _ = self._evaluate(given)
        strain = 0.5 * float(u @ (self._stiffness(hessian) @ u)) - float(pull @ u) + float(constant[0])
        friction = 0.0
        if self._friction:
            bound = self._weights(given)[0][self._weight_of]
            friction = float(bound @ np.abs(self.slips(nodes, u)))
        return strain, friction

    @cached_property
    def _order(self) -> NDArray[np.int64] | None:
        """The order of elimination on a large mesh."""
        mesh = self.problem.mesh
        if mesh.p.shape[1] <= LARGE:
            return None
        return elimination_order(mesh.p, mesh.facets, self.displacement.index)

    def slips(self, nodes: Array, u: Array) -> Array:
        """Displacements (gaps,) along the tangents at node positions (2, nodes)."""
        straight = not (self._curved and self._friction)
        tangents = self.tangents if straight else self._directions.rows(nodes)[1]
        return np.asarray(tangents @ u)

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solve at node positions (2, nodes)."""
        return solve(self.system(nodes), start)

    def _rigid(self, nodes: Array) -> Array:
        """The rigid motions that only contact prevents, (n_u, motions)."""
        free = self.displacement.index >= 0
        result = np.zeros((self.n_u, 0))
        for motion in rigid_motions(self.problem, nodes):
            column = np.zeros((self.n_u, 1))
            column[self.displacement.index[free], 0] = motion[free]
            result = np.hstack([result, column])
        return result


class _Given:
    """Node positions as parameters of a function, and the parameters of nodes on curves that go with them."""

    def __init__(self, problem: ContactProblem) -> None:
        n, self._problem = problem.mesh.p.shape[1], problem
        self._curves = [
            (curve, problem.boundary_nodes((name,))) for name, curve in problem.motion.curves.items()
        ]
        positions = unknown_field((2, n), parameter=True)
        along = unknown_field((len(self._curves), n), 2 * n, parameter=True) if self._curves else None
        self.positions = replace(positions, along=along)
        self.symbol = ca.MX.sym("X", (2 + len(self._curves)) * n)

    def __call__(self, nodes: Array) -> Array:
        """The values of ``symbol`` at node positions (2, nodes)."""
        along = np.zeros((len(self._curves), nodes.shape[1]))
        for row, (curve, here) in zip(along, self._curves, strict=True):
            row[here] = curve.nearest(nodes[:, here])
        return np.concatenate([nodes.ravel(order="F"), along.ravel(order="F")])


class _Loads:
    """The loads of a discretisation at node positions, by its quadrature rule."""

    def __init__(self, parts: Discretisation) -> None:
        self._given = given = _Given(parts.problem)
        positions, X = given.positions, given.symbol
        u = ca.MX.sym("u", parts.n_u)
        self._kept = parts.assemble([term.on(positions, parts.displacement) for term in parts.loads], u, X, 0)
        value, gradient = self._kept.grad_f(ca.MX.zeros(parts.n_u), X)
        self._evaluate = Evaluator(ca.Function("loads", [X], [ca.densify(value), -ca.densify(gradient)]))

    def __call__(self, nodes: Array) -> tuple[float, Array]:
        """Minus the work of the loads on the given displacements, and the nodal forces (n_u,)."""
        value, force = self._evaluate(self._given(nodes))
        return float(value[0]), force
