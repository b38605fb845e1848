"""The outer problem as an NLP in the outer variables alone, whose objective is a contact solve.

Its second derivatives are a dense matrix (:func:`with_hessian`): one column is one product, a
back-substitution with the stiffness of the contact solve. Up to a few thousand outer variables all columns
together cost less than what solvers without them spend in more iterations. The NLP is smooth but for jumps of
the second derivative where contact changes.

For the energy L'' is a Schur complement of a sparse matrix in outer variables and displacements
(:meth:`rmesh_nlp.models.second_derivatives.Hessian.lifted`). So :func:`lifted` gives the NLP additional
unknowns w, one per displacement, of which its objective does not depend, and that matrix in place of the
Hessian:

    [ L_qq + ...  C^T ] [dq]     [ -L' ]
    [ C           K   ] [dw]  =  [  0  ]

has L'' dq = -L' as its Schur complement in dq, with the terms of barriers and constraints on both sides. K is
positive definite, so by Haynsworth's inertia additivity the whole has as many negative eigenvalues as the
Newton matrix of the reduced NLP. The directions of a solver are therefore those it would take with L''
itself, and dw has no effect. One factorisation takes the place of one back-substitution per outer variable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace, Index
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.models.reduced_model import Reduced, ReducedEnergy, ReducedObjective
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.models.second_derivatives import Curvature, Lifted
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import NLP, Derivatives

COLUMNS = 256
"""Columns of the Hessian that are computed at a time; it bounds the memory for changes of displacement."""

STIFF = 1e8
"""Size of the stiffness's diagonal in the units of w, relative to the block of the outer variables: multiples
of the identity that a solver adds to make the matrix positive definite then act on those only."""


@dataclass(frozen=True)
class ReducedNLP:
    """The outer problem: its NLP in the outer variables q and the function behind its objective.

    A solver should end with a first-order ``residual`` of at most ``tolerance``. The objective of the NLP is
    in units of ``scale``, its size on the given mesh. ``warm`` says that the start is likely to be close to a
    minimiser.
    """

    nlp: NLP
    function: Reduced
    is_valid: Callable[[Array], bool]
    residual: OuterResidual
    scale: float
    tolerance: float
    constraints: ReducedConstraints | None = None
    warm: bool = False


def reduced_nlp(
    rel: Relocation,
    function: Reduced,
    is_valid: Callable[[Array], bool],
    residual: OuterResidual,
    tolerance: float,
    constraints: ReducedConstraints | None = None,
) -> ReducedNLP:
    """The NLP ``min F(q)`` within limits, element areas and constraints; its objective is a contact solve."""
    q, p, areas, bound = rel.validity.q, ca.MX(0, 1), rel.validity.assembled, rel.validity.bound
    scale = abs(function(np.zeros(rel.n_q)).value) or 1.0
    oracle = _Oracle(function, rel, scale)
    value, gradient = oracle(q)
    nlp = NLP(
        x=q,
        p=p,
        f=value,
        g=areas.g,
        lbx=rel.mesh_map.lower,
        ubx=rel.mesh_map.upper,
        lbg=bound,
        ubg=np.full(bound.size, np.inf),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [q, p], [value, gradient]),
            jac_g=areas.derivatives.jac_g,
            hess_lag=None,
            kernels=(*areas.derivatives.kernels, oracle),
        ),
    )
    if constraints is not None:
        nlp = _constrained(nlp, _Rows(function, constraints, rel), constraints)
    return ReducedNLP(nlp, function, is_valid, residual, scale, tolerance, constraints)


def _constrained(nlp: NLP, rows: _Rows, constraints: ReducedConstraints) -> NLP:
    """The NLP with the rows of constraints after its own."""
    assert nlp.derivatives is not None
    value, jacobian = rows(nlp.x)
    of_areas, by_q = nlp.derivatives.jac_g(nlp.x, nlp.p)
    outputs = [ca.vertcat(of_areas, value), ca.vertcat(by_q, jacobian)]
    jac_g = ca.Function("nlp_jac_g", [nlp.x, nlp.p], outputs)
    kernels = (*nlp.derivatives.kernels, rows)
    return replace(
        nlp,
        g=ca.vertcat(nlp.g, value),
        lbg=np.append(nlp.lbg, constraints.rows.lower),
        ubg=np.append(nlp.ubg, constraints.rows.upper),
        derivatives=replace(nlp.derivatives, jac_g=jac_g, kernels=kernels),
        _of=(0, 0),
    )


class _Rows(PythonFunction):
    """The constraints (rows,) and their derivatives (rows, n_q)."""

    def __init__(self, function: Reduced, constraints: ReducedConstraints, relocation: Relocation) -> None:
        self._function, self._constraints, self._relocation = function, constraints, relocation
        n, rows = relocation.n_q, constraints.rows.size
        outputs = [ca.Sparsity.dense(rows), ca.Sparsity.dense(rows, n)]
        super().__init__("reduced_constraints", [ca.Sparsity.dense(n)], outputs)

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q, rel = arg[0].full().ravel(), self._relocation
        if not is_upright(rel.problem, rel.nodes(q)):
            return [
                np.full(self._constraints.rows.size, np.nan),
                np.zeros((self._constraints.rows.size, q.size)),
            ]
        evaluated = self._constraints.at(self._function(q))
        return [evaluated.value, evaluated.jacobian]


class _Oracle(PythonFunction):
    """F(q) and its gradient in units of ``|F(0)|``: a squared error may be small."""

    def __init__(self, function: Reduced, relocation: Relocation, scale: float) -> None:
        self._function, self._scale, self._relocation = function, scale, relocation
        scalar, n = ca.Sparsity.dense(1), ca.Sparsity.dense(relocation.n_q)
        super().__init__("reduced_objective", [n], [scalar, n])

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q, rel = arg[0].full().ravel(), self._relocation
        # the contact problem of a mesh with inverted elements has no meaning
        upright = not rel.n_valid or is_upright(rel.problem, rel.nodes(q))
        if not (upright and self._function.is_defined(q)):
            return [np.nan, np.full(q.size, np.nan)]  # Ipopt then takes a shorter step
        point = self._function(q)
        return [point.value / self._scale, point.gradient / self._scale]


Values = Callable[[Array, float, sp.csc_array | None, Array], Array]
"""``(q, factor, rows, multiples) ->`` nonzeros of ``factor F''``, the Hessian of the rows of elements, where
there are any, and those of constraints with their multipliers."""


class _SecondOracle(PythonFunction):
    """Upper triangle of the Hessian of ``lam_f f + lam_g^T g``, f in the units of the NLP."""

    def __init__(self, problem: ReducedNLP, upper: ca.Sparsity, values: Values) -> None:
        self._function, self._scale, self._upper, self._values = (
            problem.function,
            problem.scale,
            upper,
            values,
        )
        self._n_valid = problem.function.energy.relocation.n_valid
        inputs = [ca.Sparsity.dense(size) for size in (problem.nlp.n_x, 1, problem.nlp.n_g)]
        super().__init__("reduced_hessian", inputs, [upper])

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        q, lam_f, lam_g = arg[0].full().ravel(), float(arg[1]) / self._scale, arg[2].full().ravel()
        areas, own = np.split(lam_g, [self._n_valid])
        rows = self._function.energy.validity.hessian(q, areas) if areas.size else None
        return [ca.DM(self._upper, self._values(q, lam_f, rows, own).tolist())]


def with_hessian(problem: ReducedNLP) -> NLP:
    """The NLP of another objective than the energy, with its second derivatives as a dense matrix."""
    function = problem.function
    assert isinstance(function, ReducedObjective)
    n, conditions = problem.nlp.n_x, function.conditions
    upper = ca.Sparsity.upper(n)
    at = tuple(np.array(index, dtype=np.int64) for index in upper.get_triplet())

    def values(q: Array, factor: float, rows: sp.csc_array | None, multiples: Array) -> Array:
        hessian = dense(conditions.at(function(q)).hessian(factor * conditions.program.value, multiples), n)
        return np.asarray((hessian if rows is None else hessian + rows)[at])

    return _with(problem.nlp, _SecondOracle(problem, upper, values), n)


def lifted(problem: ReducedNLP) -> NLP:
    """The NLP of a reduced energy in ``(q, w)``, whose solution in q is that of the reduced one.

    The unknowns w start at zero.
    """
    function = problem.function
    if not isinstance(function, ReducedEnergy):
        raise TypeError("only the energy's second derivatives are lifted")
    curvature, pattern = Curvature(function), _pattern(function.relocation)
    columns = np.repeat(np.arange(pattern.shape[1], dtype=np.int64), np.diff(pattern.indptr))
    entries = columns * pattern.shape[0] + pattern.indices  # one number per entry, in ascending order

    def values(q: Array, factor: float, rows: sp.csc_array | None, _: Array) -> Array:
        (row, column), data = _upper(curvature.at(function(q)).lifted(), factor, rows)
        keys = column.astype(np.int64) * pattern.shape[0] + row
        place = np.minimum(np.searchsorted(entries, keys), entries.size - 1)
        inside = entries[place] == keys
        if np.any(data[~inside]):
            raise RuntimeError("the lifted Hessian has entries outside its pattern")
        return np.asarray(np.bincount(place[inside], data[inside], entries.size), dtype=float)

    n_w = function.relocation.n_u
    free = np.full(n_w, np.inf)
    larger = problem.nlp.extended(x=ca.MX.sym("w", n_w), lbx=-free, ubx=free)
    sparsity = ca.Sparsity(*pattern.shape, pattern.indptr.tolist(), pattern.indices.tolist())
    return _with(larger, _SecondOracle(problem, sparsity, values), problem.nlp.n_x)


def _upper(hessian: Lifted, factor: float, rows: sp.csc_array | None) -> tuple[Index, Array]:
    """Places (2, entries) and values in the upper triangle over all unknowns: a lifted Hessian and the rows.

    The first is times a factor. Places may come several times.
    """
    outer = factor * hessian.outer if rows is None else factor * hessian.outer + rows
    size = float(np.max(np.abs(outer.data), initial=0.0)) or 1.0
    # in these units of w the factor, which may be 0, need not be divided by
    unit, number = np.sqrt(STIFF * size / hessian.stiffness.diagonal()), outer.shape[0] + hessian.free
    # unknowns that contact determines
    held = outer.shape[0] + np.delete(np.arange(hessian.n_u), hessian.free)
    a, b, c = outer.tocoo(), hessian.mixed.tocoo(), hessian.stiffness.tocoo()
    first, second = (a.row, b.col, number[c.row], held), (a.col, number[b.row], number[c.col], held)
    mixed, stiffness = np.sqrt(factor) * unit[b.row] * b.data, unit[c.row] * unit[c.col] * c.data
    places = np.stack([np.concatenate(first), np.concatenate(second)])
    values = np.concatenate([a.data, mixed, stiffness, np.full(held.size, STIFF * size)])
    upper = places[0] <= places[1]
    return places[:, upper], values[upper]


def _with(nlp: NLP, oracle: _SecondOracle, n_q: int) -> NLP:
    """The NLP with the Hessian of a callback in its first ``n_q`` unknowns."""
    assert nlp.derivatives is not None
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    hessian = oracle(nlp.x[:n_q], lam_f, lam_g)
    hess_lag = ca.Function("nlp_hess_l", [nlp.x, nlp.p, lam_f, lam_g], [hessian])
    kernels = (*nlp.derivatives.kernels, oracle)
    return replace(nlp, derivatives=replace(nlp.derivatives, hess_lag=hess_lag, kernels=kernels))


def dense(model: Callable[[Array], Array], n: int) -> Array:
    """The matrix of a model, symmetric up to rounding and made so."""
    matrix, unit = np.empty((n, n)), np.eye(n)
    for first in range(0, n, COLUMNS):
        columns = np.arange(first, min(first + COLUMNS, n))
        matrix[:, columns] = model(unit[:, columns])
    return np.asarray(0.5 * (matrix + matrix.T))


def _pattern(relocation: Relocation) -> sp.csc_array:
    """Upper triangle of where the lifted Hessian may have entries, whatever is active.

    Unknowns meet if their nodes meet in an element. A touching node follows the outer variables that its gap
    and its slip depend on.
    """
    space, positions = relocation.discretisation.space, relocation.mesh_map.positions.index
    meet = _elements(space)
    at_nodes = np.full((len(positions), space.n_nodes), -1)
    at_nodes[:, space.number[: space.n_vertices]] = positions
    to_outer = _to_unknowns(at_nodes, relocation.n_q) + _followed(relocation)
    to_others = _to_unknowns(relocation.displacement.index - relocation.n_q, relocation.n_u)
    moved = meet @ to_outer
    outer = to_outer.T @ moved + sp.eye_array(relocation.n_q)
    mixed = to_others.T @ moved
    others = to_others.T @ meet @ to_others + sp.eye_array(relocation.n_u)
    pattern = sp.csc_array(sp.triu(sp.block_array([[outer, mixed.T], [mixed, others]])))
    pattern.sum_duplicates()
    pattern.sort_indices()
    return pattern


def _incidence(rows: Index, columns: Index, *shape: int) -> sp.csr_array:
    """A sparse matrix with ones at these places."""
    return sp.csr_array((np.ones(rows.size), (rows, columns)), shape=shape)


def _elements(space: DisplacementSpace) -> sp.csr_array:
    """(nodes, nodes) Whether two nodes are of one element, or the same."""
    elements, n = space.elements, space.n_nodes
    element = np.tile(np.arange(elements.shape[1]), len(elements))
    belongs = _incidence(elements.ravel(), element, n, elements.shape[1])
    return sp.csr_array(belongs @ belongs.T + sp.eye_array(n))


def _followed(relocation: Relocation) -> sp.csr_array:
    """(nodes, n_q) Which outer variables the gap and the slip of a node depend on."""
    space, n_contact = relocation.discretisation.space, relocation.n_contact
    node = np.zeros(n_contact, dtype=np.int64)
    for part in space.contact_sets:
        node[part.rows] = part.nodes
    nodes = np.concatenate([node, node[relocation.friction_rows]])
    first, n_q = relocation.lagrangian.first.pattern, relocation.n_q
    rows = sp.vstack([first[relocation.gap_rows, :n_q], first[relocation.slip_rows, :n_q]])
    return sp.csr_array(_incidence(nodes, np.arange(nodes.size), space.n_nodes, nodes.size) @ abs(rows))


def _to_unknowns(index: Index, n: int) -> sp.csr_array:
    """(nodes, n) Which unknowns a field has at each node; ``index`` is (components, nodes)."""
    component, node = np.nonzero(index >= 0)
    return _incidence(node, index[component, node], index.shape[1], n)
