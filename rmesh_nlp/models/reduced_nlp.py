"""The outer problem as an NLP in the outer variables alone, whose objective is a contact solve.

Its second derivatives are a dense matrix: one column is one product, a
back-substitution with the stiffness of the contact solve. Up to a few thousand outer variables all columns
together cost less than what solvers without them spend in more iterations. The NLP is smooth but for jumps of
the second derivative where contact changes.

For the energy L'' is a Schur complement of a sparse matrix in outer variables and displacements
(:class:`rmesh_nlp.models.second_derivatives.Lifted`). So its NLP has additional
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
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Index, magnitude, sparsity_of
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.models.reduced_model import Reduced, ReducedEnergy, ReducedObjective
from rmesh_nlp.models.second_derivatives import Lifted
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import NLP, Derivatives
from rmesh_nlp.problem.body import Body

STIFF = 1 / np.sqrt(np.finfo(float).eps)
"""Size of the stiffness's diagonal in the units of w, relative to the block of the outer variables: multiples
of the identity that a solver adds to make the matrix positive definite then act on those only."""


def reduced_nlp(function: Reduced, constraints: ReducedConstraints | None = None) -> NLP:
    """The NLP in ``(q, w)``: limits, rows of element validity, then of constraints.

    Its objective is a contact solve. Only the energy has a w, which starts at 0.
    """
    rel = function.energy.relocation
    n_g = rel.n_valid + (0 if constraints is None else constraints.rows.size)
    second = _dense(function) if isinstance(function, ReducedObjective) else _lifted(function)
    areas, free, first = rel.validity.assembled, rel.parts.mesh_map, _First(function, constraints)
    hessian = _Second(function, n_g, *second)
    n_w = hessian.size1_out(0) - rel.parts.n_q
    q, w, unlimited = rel.validity.q, ca.MX.sym("w", n_w), np.full(n_w, np.inf)
    x, p, lam_f, lam_g = ca.vertcat(q, w), ca.MX(0, 1), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_g)
    value, gradient, rows, of_rows = first(q)
    g, jacobian = ca.vertcat(areas.g, rows), ca.vertcat(areas.derivatives.jac_g(q, p)[1], of_rows)
    lower, upper = rel.validity.bound, np.full(rel.n_valid, np.inf)
    if constraints is not None:
        lower, upper = np.append(lower, constraints.rows.lower), np.append(upper, constraints.rows.upper)
    slope, jacobian = ca.vertcat(gradient, ca.MX.zeros(n_w)), ca.horzcat(jacobian, ca.MX(n_g, n_w))
    return NLP(
        x=x,
        p=p,
        f=value,
        g=g,
        lbx=np.append(free.lower, -unlimited),
        ubx=np.append(free.upper, unlimited),
        lbg=lower,
        ubg=upper,
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [x, p], [value, slope]),
            jac_g=ca.Function("nlp_jac_g", [x, p], [g, jacobian]),
            hess_lag=ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian(q, lam_f, lam_g)]),
            kernels=(*areas.derivatives.kernels, first, hessian),
        ),
    )


class _First(PythonFunction):
    """F(q) and its gradient, the constraints (rows,) and their derivatives (rows, n_q)."""

    def __init__(self, function: Reduced, constraints: ReducedConstraints | None) -> None:
        self._function, self._constraints = function, constraints
        self._rows, n = (
            0 if constraints is None else constraints.rows.size,
            function.energy.relocation.parts.n_q,
        )
        shapes = (1,), (n,), (self._rows,), (self._rows, n)
        super().__init__("reduced", [ca.Sparsity.dense(n)], [ca.Sparsity.dense(*shape) for shape in shapes])

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q, function, constraints = arg[0].full().ravel(), self._function, self._constraints
        rel, of_rows = function.energy.relocation, np.zeros((self._rows, q.size))
        # the contact problem of a mesh with inverted elements has no meaning: Ipopt takes a shorter step
        if not Body(rel.parts.problem, rel.nodes(q)).is_upright():
            return [np.nan, np.full(q.size, np.nan), np.full(self._rows, np.nan), of_rows]
        point = function(q)
        rows = (np.zeros(0), of_rows) if constraints is None else constraints.at(point)
        return [point.value, point.gradient, *rows]


Values = Callable[[Array, float, sp.csc_array | None, Array], Array]
"""``(q, factor, rows, multiples) ->`` nonzeros of ``factor F''``, the Hessian of the rows of elements, where
there are any, and those of constraints with their multipliers."""


class _Second(PythonFunction):
    """Upper triangle of the Hessian of ``lam_f f + lam_g^T g`` in the unknowns of the NLP."""

    def __init__(self, function: Reduced, n_g: int, upper: ca.Sparsity, values: Values) -> None:
        self._energy, self._upper, self._values = function.energy, upper, values
        inputs = [ca.Sparsity.dense(size) for size in (self._energy.relocation.parts.n_q, 1, n_g)]
        super().__init__("reduced_hessian", inputs, [upper])

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        q, lam_f, lam_g = arg[0].full().ravel(), float(arg[1]), arg[2].full().ravel()
        areas, own = np.split(lam_g, [self._energy.relocation.n_valid])
        rows = self._energy.relocation.validity.hessian(q, areas) if areas.size else None
        return [ca.DM(self._upper, self._values(q, lam_f, rows, own).tolist())]


def _dense(function: ReducedObjective) -> tuple[ca.Sparsity, Values]:
    """Second derivatives of another objective than the energy, a dense matrix."""
    n = function.energy.relocation.parts.n_q
    upper = ca.Sparsity.upper(n)
    at = tuple(np.array(index, dtype=np.int64) for index in upper.get_triplet())

    def values(q: Array, factor: float, rows: sp.csc_array | None, multiples: Array) -> Array:
        hessian = function.hessian(function(q), factor, multiples)(np.eye(n))
        hessian = 0.5 * (hessian + hessian.T)  # symmetric up to rounding
        return (hessian if rows is None else hessian + rows)[at]

    return upper, values


def _lifted(function: ReducedEnergy) -> tuple[ca.Sparsity, Values]:
    """Second derivatives of the energy, a sparse matrix in ``(q, w)``."""
    pattern, n_u = _pattern(function.relocation), function.relocation.parts.n_u
    columns = np.repeat(np.arange(pattern.shape[1], dtype=np.int64), np.diff(pattern.indptr))
    entries = columns * pattern.shape[0] + pattern.indices  # one number per entry, in ascending order

    def values(q: Array, factor: float, rows: sp.csc_array | None, _: Array) -> Array:
        (row, column), data = _upper(function.hessian(function(q)), n_u, factor, rows)
        keys = column.astype(np.int64) * pattern.shape[0] + row
        place = np.minimum(np.searchsorted(entries, keys), entries.size - 1)
        inside = entries[place] == keys
        if np.any(data[~inside]):
            raise RuntimeError("the lifted Hessian has entries outside its pattern")
        return np.asarray(np.bincount(place[inside], data[inside], entries.size), dtype=float)

    return sparsity_of(pattern), values


def _upper(hessian: Lifted, n_u: int, factor: float, rows: sp.csc_array | None) -> tuple[Index, Array]:
    """Places (2, entries) and values in the upper triangle over all unknowns: a lifted Hessian and the rows.

    The first is times a factor. Places may come several times.
    """
    outer = factor * hessian.outer if rows is None else factor * hessian.outer + rows
    size = magnitude(outer.data) or 1.0
    # in these units of w the factor, which may be 0, need not be divided by
    unit, number = np.sqrt(STIFF * size / hessian.stiffness.diagonal()), outer.shape[0] + hessian.free.inside
    # unknowns that contact determines
    held = outer.shape[0] + np.delete(np.arange(n_u), hessian.free.inside)
    a, b, c = outer.tocoo(), hessian.mixed.tocoo(), hessian.stiffness.tocoo()
    first, second = (a.row, b.col, number[c.row], held), (a.col, number[b.row], number[c.col], held)
    mixed, corner = np.sqrt(factor) * unit[b.row] * b.data, unit[c.row] * unit[c.col] * c.data
    places = np.stack([np.concatenate(first), np.concatenate(second)])
    values = np.concatenate([a.data, mixed, corner, np.full(held.size, STIFF * size)])
    upper = places[0] <= places[1]
    return places[:, upper], values[upper]


def _pattern(relocation: Relocation) -> sp.csc_array:
    """Upper triangle of where the lifted Hessian may have entries, whatever is active.

    It is that of the energy NLP, in which slips, and displacements at touching nodes, follow w and the outer
    variables that gap and slip there depend on. In the coordinates of contact the displacements of a node,
    and those of one gap, are turned into each other.
    """
    rel, q, u = relocation, relocation.unknowns["q"], relocation.unknowns["u"]
    index = rel.displacement.index - u.start
    component, node = np.nonzero(index >= 0)
    places = index[component, node], node
    of_node = sp.csr_array((np.ones(node.size), places), shape=(rel.parts.n_u, index.shape[1]))
    first = sp.csr_array(rel.assembled.first.pattern, dtype=float)
    gaps, slips = first[rel.rows["gaps"]], first[rel.rows["plus"]]
    rows = sp.vstack([gaps, slips])[:, u]
    turned = of_node @ of_node.T @ (sp.eye_array(rows.shape[1]) + rows.T @ rows)
    follows = turned @ (gaps[:, u].T @ gaps[:, q] + slips[:, u].T @ slips[:, q])
    unknowns = sp.block_array(
        [[sp.eye_array(rel.parts.n_q), None], [follows, turned], [slips[:, q], slips[:, u] @ turned]]
    )
    upper = rel.assembled.second.pattern
    whole = unknowns.T @ (upper + upper.T) @ unknowns + sp.eye_array(rel.parts.n_q + rel.parts.n_u)
    pattern = sp.csc_array(sp.triu(whole))
    pattern.sort_indices()
    return pattern
