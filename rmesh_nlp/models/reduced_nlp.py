"""The outer problem as a nonlinear program in the moves alone, whose objective is a contact solve.

The reduced objective's Hessian as a dense matrix, for solvers that factorise.

One column of the Hessian is one product with it, a back-substitution with the stiffness of the contact solve:
up to a few thousand moves all columns together cost less than what solvers without them spend in
more iterations. The program is smooth but for jumps of the second derivative where contact changes.

The reduced energy's Newton steps by sparse matrices, for solvers that factorise.

L'' is dense, but a Schur complement of a sparse matrix in moves and displacements
(:meth:`rmesh_nlp.models.second_derivatives.Hessian.lifted`). So the program is given
additional unknowns w, one per
displacement, of which its objective does not depend, and that matrix in place of the Hessian:

    [ L_qq + ...  C^T ] [dq]     [ -L' ]
    [ C           K   ] [dw]  =  [  0  ]

has L'' dq = -L' as its Schur complement in dq, with the terms of barriers and constraints on both sides. K is
positive definite, so by Haynsworth's inertia additivity the whole has as many negative eigenvalues as the
Newton matrix of the reduced program. The directions of a solver are therefore those it would take with L''
itself, and dw has no effect. One factorisation takes the place of one back-substitution per move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.edge_gaps import edges_of, holds_along_edges
from rmesh_nlp.fem.fields import Index
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_model import Reduced, ReducedCertificate, ReducedEnergy
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.models.second_derivatives import Curvature, ObjectiveCurvature, SecantCurvature
from rmesh_nlp.optimize.nlp import NLP, Derivatives


@dataclass(frozen=True)
class ReducedProgram:
    """The outer problem: its NLP in the moves q and the function behind its objective.

    A solver should end with a first-order ``residual`` of at most ``tolerance``. The objective of the NLP is
    in units of ``scale``. ``oracle`` must live as long as the NLP: CasADi does not own Python callbacks.
    ``warm`` says that the start is likely to be close to a minimiser.
    """

    nlp: NLP
    function: Reduced
    areas: ca.Function
    oracle: ca.Callback
    is_valid: Callable[[Array], bool]
    residual: OuterResidual
    scale: float
    tolerance: float
    out_of_time: Callable[[], bool] = lambda: False
    warm: bool = False

    @property
    def unit(self) -> float:
        """What the gradient is measured in."""
        return self.residual.unit


def reduced_nlp(
    rel: Relocation,
    function: Reduced,
    is_valid: Callable[[Array], bool],
    residual: OuterResidual,
    tolerance: float,
) -> ReducedProgram:
    """The NLP ``min F(q)`` over boxes and element areas; its objective is a contact solve."""
    q, p = rel.validity.q, ca.MX(0, 1)
    areas, bound = rel.validity.assembled, rel.validity.bound
    scale = scale_of(function, rel.n_q)
    oracle = _Oracle(function, rel, scale)
    value, gradient = oracle(q)
    nlp = NLP(
        x=q,
        p=p,
        f=value,
        g=areas.g,
        lbx=-rel.mesh_map.bound,
        ubx=rel.mesh_map.bound,
        lbg=bound,
        ubg=np.full(bound.size, np.inf),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [q, p], [value, gradient]),
            jac_g=areas.jac_g,
            hess_lag=None,
            kernels=areas.kernels,
        ),
    )
    return ReducedProgram(nlp, function, areas.jac_g, oracle, is_valid, residual, scale, tolerance)


class _Oracle(ca.Callback):
    """F(q) and its gradient as a CasADi Function, in units of ``|F(0)|``: a squared error may be small."""

    def __init__(self, function: Reduced, relocation: Relocation, scale: float) -> None:
        super().__init__()
        self._function, self._scale, self._n = function, scale, relocation.n_q
        self._relocation = relocation
        self.construct("reduced_energy", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n if i else 1)

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q = arg[0].full().ravel()
        if not self._is_defined(q):
            return [np.nan, np.full(self._n, np.nan)]  # Ipopt then takes a shorter step
        point = self._function(q)
        return [point.value / self._scale, point.gradient / self._scale]

    def _is_defined(self, q: Array) -> bool:
        """Whether the objective is: the contact problem of a mesh with inverted elements has no meaning."""
        rel = self._relocation
        if rel.n_valid and not is_upright(rel.problem, rel.nodes(q)):
            return False
        return self._function.is_defined(q)


def scale_of(function: Reduced, n: int) -> float:
    """Size of the objective on the initial mesh, the unit in which it is minimised."""
    return abs(function(np.zeros(n)).value) or 1.0


COLUMNS = 256
"""Columns of the Hessian that are computed at a time; it bounds the memory for changes of displacement."""


def curvature_of(program: ReducedProgram) -> Curvature | ObjectiveCurvature | SecantCurvature:
    """Second derivatives of the outer objective of a program."""
    function = program.function
    if isinstance(function, ReducedEnergy):
        return Curvature(function)
    if isinstance(function, ReducedCertificate):
        return SecantCurvature(function)
    return ObjectiveCurvature(function.energy, function.objective)


def with_hessian(program: ReducedProgram) -> ReducedProgram:
    """The same program, with the second derivatives of its Lagrangian."""
    nlp = program.nlp
    assert nlp.derivatives is not None
    second = _SecondOracle(program)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    hess_lag = ca.Function("nlp_hess_l", [nlp.x, nlp.p, lam_f, lam_g], [second(nlp.x, lam_f, lam_g)])
    derivatives = replace(nlp.derivatives, hess_lag=hess_lag, kernels=(*nlp.derivatives.kernels, second))
    return replace(program, nlp=replace(nlp, derivatives=derivatives))


class _SecondOracle(ca.Callback):
    """Upper triangle of the Hessian of ``lam_f f + lam_g^T g``, f in the units of the program."""

    def __init__(self, program: ReducedProgram) -> None:
        super().__init__()
        self._n, self._rows = program.nlp.n_x, program.nlp.n_g
        self._function, self._scale = program.function, program.scale
        self._curvature = curvature_of(program)
        function = program.function
        energy = function if isinstance(function, ReducedEnergy) else function.energy
        self._validity = energy.validity if self._rows else None
        self._upper = ca.Sparsity.upper(self._n)
        rows, columns = (np.array(index, dtype=np.int64) for index in self._upper.get_triplet())
        self._rows_of, self._columns_of = rows, columns
        self.construct("reduced_hessian", {})

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense((self._n, 1, self._rows)[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._upper

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        q, lam_f, lam_g = arg[0].full().ravel(), float(arg[1]), arg[2].full().ravel()
        hessian = dense(self._curvature.at(self._function(q)), self._n) * (lam_f / self._scale)
        if self._validity is not None:
            hessian += self._validity.hessian(q, lam_g)
        return [ca.DM(self._upper, hessian[self._rows_of, self._columns_of].tolist())]


def dense(model: Callable[[Array], Array], n: int) -> Array:
    """The matrix of a model, symmetric up to rounding and made so."""
    matrix = np.empty((n, n))
    for first in range(0, n, COLUMNS):
        unit = np.zeros((n, min(COLUMNS, n - first)))
        unit[first + np.arange(unit.shape[1]), np.arange(unit.shape[1])] = 1.0
        matrix[:, first : first + unit.shape[1]] = model(unit)
    return np.asarray(0.5 * (matrix + matrix.T))


STIFF = 1e8
"""Size of the stiffness's diagonal in the units of w, relative to the block of the moves: multiples of the
identity that a solver adds to make the matrix positive definite then act on the moves only."""


@dataclass(frozen=True)
class LiftedProgram:
    """A program in ``(q, w)`` whose solution in q is that of the reduced one.

    Attributes
    ----------
    nlp : NLP
    n_q : int
        Number of moves.
    n_w : int
        Number of the unknowns w, which start at zero.
    """

    nlp: NLP
    n_q: int
    n_w: int

    def start(self, q: Array) -> Array:
        """Unknowns to start from at moves ``q``."""
        return np.concatenate([q, np.zeros(self.n_w)])


def lifted(program: ReducedProgram) -> LiftedProgram:
    """The lifted program of a reduced energy."""
    function = program.function
    if not isinstance(function, ReducedEnergy):
        raise TypeError("only the energy's second derivatives are lifted")
    n_w = function.relocation.n_u
    free = np.full(n_w, np.inf)
    nlp = program.nlp.extended(x=ca.MX.sym("w", n_w), lbx=-free, ubx=free)
    assert nlp.derivatives is not None
    oracle = _LiftedOracle(program, function)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    hess_lag = ca.Function(
        "nlp_hess_l", [nlp.x, nlp.p, lam_f, lam_g], [oracle(nlp.x[: program.nlp.n_x], lam_f, lam_g)]
    )
    derivatives = replace(nlp.derivatives, hess_lag=hess_lag, kernels=(*nlp.derivatives.kernels, oracle))
    return LiftedProgram(replace(nlp, derivatives=derivatives), program.nlp.n_x, n_w)


class _LiftedOracle(ca.Callback):
    """Upper triangle of the lifted Hessian of ``lam_f f + lam_g^T g``, f in the units of the program."""

    def __init__(self, program: ReducedProgram, energy: ReducedEnergy) -> None:
        super().__init__()
        self._energy, self._scale = energy, program.scale
        self._n_q, self._rows = program.nlp.n_x, program.nlp.n_g
        self._curvature = Curvature(energy)
        self._validity = energy.validity if self._rows else None
        pattern = _pattern(energy.relocation)
        self._size = pattern.shape[0]
        self._keys = _keys(pattern)
        self._upper = ca.Sparsity(*pattern.shape, pattern.indptr.tolist(), pattern.indices.tolist())
        self.construct("lifted_hessian", {})

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense((self._n_q, 1, self._rows)[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._upper

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        q, lam_f, lam_g = arg[0].full().ravel(), float(arg[1]), arg[2].full().ravel()
        values = np.zeros(self._keys.size)
        matrix = self._matrix(q, lam_f, lam_g)
        keys = _keys(matrix)
        place = np.minimum(np.searchsorted(self._keys, keys), self._keys.size - 1)
        known = self._keys[place] == keys
        if np.any(matrix.data[~known]):
            raise RuntimeError("the lifted Hessian has entries outside its pattern")
        values[place[known]] = matrix.data[known]
        return [ca.DM(self._upper, values.tolist())]

    def _matrix(self, q: Array, lam_f: float, lam_g: Array) -> sp.csc_array:
        """The upper triangle over all unknowns."""
        found, factor = self._curvature.at(self._energy(q)).lifted(), lam_f / self._scale
        moves = factor * found.moves
        if self._validity is not None:
            moves = moves + self._validity.hessian(q, lam_g)
        size = float(np.max(np.abs(moves.data), initial=0.0)) or 1.0
        # in these units of w the factor, which may be 0, need not be divided by
        unit = sp.diags_array(np.sqrt(STIFF * size / found.stiffness.diagonal()))
        stiffness, mixed = unit @ found.stiffness @ unit, np.sqrt(factor) * (unit @ found.mixed)
        diagonal = np.full(found.n_u, STIFF * size)  # of unknowns that contact holds
        diagonal[found.free] = 0.0
        put = sp.csc_array(
            (np.ones(found.free.size), (found.free, np.arange(found.free.size))),
            shape=(found.n_u, found.free.size),
        )
        corner = put @ stiffness @ put.T + sp.diags_array(diagonal)
        mixed = put @ mixed
        matrix = sp.csc_array(sp.triu(sp.block_array([[moves, mixed.T], [mixed, corner]])))
        matrix.sum_duplicates()
        return matrix


def _pattern(relocation: Relocation) -> sp.csc_array:
    """Where the lifted Hessian may have entries, of its upper triangle.

    Nodes meet in an element. A touching node follows the moves that its gap depends on: its own, and those of
    its neighbours on the contact boundary where gaps hold along edges. So moves meet where nodes do that
    follow them.
    """
    meet = _elements(relocation)
    follows = sp.csr_array(sp.eye_array(meet.shape[0]) + _beside(relocation))
    moved = meet @ follows
    to_moves = _to_unknowns(relocation.mesh_map.positions.index, relocation.n_q)
    to_others = _to_unknowns(relocation.displacement.index - relocation.n_q, relocation.n_u)
    moves = to_moves.T @ (follows.T @ moved) @ to_moves + sp.eye_array(relocation.n_q)
    mixed = to_others.T @ moved @ to_moves
    others = to_others.T @ meet @ to_others + sp.eye_array(relocation.n_u)
    pattern = sp.csc_array(sp.triu(sp.block_array([[moves, mixed.T], [mixed, others]])))
    pattern.sum_duplicates()
    pattern.sort_indices()
    return pattern


def _elements(relocation: Relocation) -> sp.csr_array:
    """(nodes, nodes) Whether two nodes are of one element, or the same."""
    triangles = relocation.problem.triangles
    n = relocation.problem.mesh.p.shape[1]
    element = np.broadcast_to(np.arange(triangles.shape[1]), triangles.shape)
    ones = np.ones(triangles.size)
    belongs = sp.csr_array((ones, (triangles.ravel(), element.ravel())), shape=(n, triangles.shape[1]))
    return sp.csr_array(belongs @ belongs.T + sp.eye_array(n))


def _beside(relocation: Relocation) -> sp.csr_array:
    """(nodes, nodes) Which other nodes the gap of a node depends on."""
    problem = relocation.problem
    n = problem.mesh.p.shape[1]
    found = sp.csr_array((n, n))
    for part in problem.contact_sets:
        if holds_along_edges(problem, part.obstacle):
            one, two = edges_of(problem, part.obstacle)
            pairs = np.append(one, two), np.append(two, one)
            found = found + sp.csr_array((np.ones(pairs[0].size), pairs), shape=(n, n))
    return found


def _to_unknowns(index: Index, n: int) -> sp.csr_array:
    """(nodes, n) Which unknowns a field has at each node; ``index`` is (components, nodes)."""
    node = np.broadcast_to(np.arange(index.shape[1]), index.shape)
    inside = index >= 0
    return sp.csr_array(
        (np.ones(int(inside.sum())), (node[inside], index[inside])), shape=(index.shape[1], n)
    )


def _keys(matrix: sp.csc_array) -> np.ndarray:
    """One number per entry, in ascending order."""
    columns = np.repeat(np.arange(matrix.shape[1], dtype=np.int64), np.diff(matrix.indptr))
    return np.asarray(columns * matrix.shape[0] + matrix.indices)
