"""Lifting: every member of a pair becomes a plain non-negative unknown.

With ``z = (x, s)``, one slack for each member that is not already an unknown, the rows of the oracle
become ``(g, G_i - s_i, H_i - s_i)`` and a pair is ``z[first_i] _|_ z[second_i]``. A relaxation is then a
function of two unknowns with trivial derivatives, and fixing a member at zero is a bound: the
sparsity of the NLP never changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Evaluator, Index, Mask, magnitude, numbered
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import Duals, MPCCResult
from rmesh_nlp.optimize.nlp import NLP, Derivatives, Symbolic

_DENSE = 0.1  # part of the entries of a Jacobian that are not zero, from which on it counts as dense


@dataclass(frozen=True, eq=False)
class Lifted:
    """An MPCC over plain unknowns.

    Attributes
    ----------
    source : MPCC
    nlp : NLP
        Unknowns ``z``; rows without any complementarity; ``z >= 0`` for members. The last parameter is the
        weight of the objective.
    pairs : int array (2, n_pairs)
        Pair i is ``z[pairs[0, i]] _|_ z[pairs[1, i]]``. An unknown may be in several, also twice in one. Bool
        arrays of this shape say which members are zero.
    rows : int array
        Row of ``vertcat(g, G, H)`` behind each constraint row; the first ``n_g`` are ``g``.
    base : Derivatives
        Of the source problem, its rows ``vertcat(g, G, H)``.
    value, jacobian : Evaluator
        ``(z, p) -> (f, gradient)`` and ``(z, p) -> (rows, nonzeros of their Jacobian)``.
    source_values : Evaluator
        ``(x, p) -> (f, vertcat(g, G, H))`` of the source problem.
    """

    source: MPCC
    nlp: NLP
    pairs: Index
    rows: Index
    base: Derivatives
    value: Evaluator
    jacobian: Evaluator
    source_values: Evaluator

    @cached_property
    def member(self) -> Mask:
        """Whether an unknown is a member of a pair."""
        return np.isin(np.arange(self.nlp.n_x), self.pairs)

    @cached_property
    def pattern(self) -> tuple[Index, Index]:
        """Row and column of each nonzero of the Jacobian, in the order of the Evaluator."""
        rows, columns = self.jacobian.function.sparsity_out(1).get_triplet()
        return np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)

    def smaller(self, z: Array) -> Mask:
        """The smaller member of each pair, of equal ones the first."""
        return on_side(z[self.pairs[0]] <= z[self.pairs[1]])

    @cached_property
    def kkt(self) -> tuple[Evaluator, sp.csc_array]:
        """``(z, p, lam_rows) -> (gradient, rows, nonzeros of the KKT matrix)``, and its numbered pattern.

        Where the source problem has a Hessian.
        """
        nlp, lam, own = self.nlp, ca.MX.sym("lam", self.nlp.n_g), self.nlp.derivatives
        assert own is not None
        assert own.hess_lag is not None
        (_, gradient), (rows, jacobian) = own.grad_f(nlp.x, nlp.p), own.jac_g(nlp.x, nlp.p)
        hessian = ca.triu2symm(own.hess_lag(nlp.x, nlp.p, 1, lam))
        matrix = ca.blockcat([[hessian, jacobian.T], [jacobian, ca.MX(nlp.n_g, nlp.n_g)]])
        function = ca.Function("kkt", [nlp.x, nlp.p, lam], [gradient, rows, matrix])
        return Evaluator(function), numbered(function.sparsity_out(2))

    @cached_property
    def cross(self) -> ca.Function:
        """``(z, p, lam_rows) ->`` derivatives by p of the Lagrangian's gradient, then of the rows."""
        nlp, lam, n = self.nlp, ca.MX.sym("lam", self.nlp.n_g), self.source.p.shape[0]
        slope = ca.gradient(nlp.f + ca.dot(lam, nlp.g), nlp.x)
        by_p = ca.jacobian(ca.vertcat(slope, nlp.g), nlp.p)[:, :n]
        return ca.Function("cross", [nlp.x, nlp.p, lam], [by_p])

    def weight(self, x0: Array, p: Array) -> float:
        """Weight that brings the gradient of a small objective up to 1; 1 for others, and for a constant.

        The gradient is that at the start, where it may vanish, and at two random points near it. Multipliers
        of an objective of size 1e-6 would be lost among tolerances.
        """
        random = np.random.default_rng(0)
        near = [x0 + random.uniform(-0.5, 0.5, x0.size) * (1 + np.abs(x0)) for _ in range(2)]
        points = [x0, *(np.clip(x, self.source.lbx, self.source.ubx) for x in near)]
        p, slack = np.append(p, 1.0), np.zeros(self.nlp.n_x - x0.size)
        slopes = [magnitude(self.value(np.append(x, slack), p)[1]) for x in points]
        largest = float(np.max(slopes, where=np.isfinite(slopes), initial=0.0))
        return 1.0 / largest if 0.0 < largest < 1.0 else 1.0

    def start(self, x0: Array, p: Array) -> Array:
        """Extend a start by slacks that satisfy their rows, as far as the signs allow; p without weight."""
        z = np.append(x0, np.zeros(self.nlp.n_x - x0.size))
        rows, _ = self.jacobian(z, np.append(p, 1.0))
        z[x0.size :] = np.maximum(np.nan_to_num(rows[self.source.n_g :], posinf=0.0, neginf=0.0), 0.0)
        return z

    def linearise(self, z: Array, p: Array) -> tuple[Array, Array, sp.csr_matrix]:
        """Gradient of the objective, the rows and their sparse Jacobian at ``z``."""
        _, gradient = self.value(z, p)
        rows, nonzeros = self.jacobian(z, p)
        return gradient, rows, sp.csr_matrix((nonzeros, self.pattern), (rows.size, z.size))


def on_side(first: Mask) -> Mask:
    """One member of each pair: the first where ``first``, else the second."""
    return np.array([first, ~first])


def lift(mpcc: MPCC) -> Lifted:
    """Lift the pairs of ``mpcc``; a member that is an unknown with room at zero keeps its place.

    In MX whatever the source is: its functions stay one call, their graph is not copied.
    """
    base = mpcc.derivatives or _derivatives_of(mpcc)
    n_x, n_g, lbx, ubx = mpcc.n_x, mpcc.n_g, mpcc.lbx, mpcc.ubx
    plain = _plain_unknowns(base, n_x, n_g)
    # a slack takes the sign of an unknown whose own bounds exclude zero: its row then shows the conflict
    room = np.append((ubx >= 0) & (lbx <= 0), False)
    usable = (plain >= 0) & room[plain]
    slack_rows = np.flatnonzero(~usable)
    place = np.where(usable, plain, 0)
    place[slack_rows] = n_x + np.arange(slack_rows.size)
    rows = np.concatenate([np.arange(n_g), n_g + slack_rows])
    x, p, slack, weight = (
        ca.MX.sym(name, size)
        for name, size in (("x", n_x), ("p", mpcc.p.shape[0]), ("slack", slack_rows.size), ("weight", 1))
    )
    zero, (f, *columns) = np.zeros(2 * mpcc.n_pairs), mpcc.oracle(x, p)
    column = ca.vertcat(*columns)
    nlp = NLP(x, p, f, column, lbx, ubx, np.append(mpcc.lbg, zero), np.append(mpcc.ubg, zero), base)
    nlp = nlp.extended(
        x=slack, p=weight, weight=weight, rows=rows.tolist(), shift=ca.vertcat(ca.MX(n_g, 1), -slack)
    )
    nlp.lbx[place] = np.maximum(nlp.lbx[place], 0.0)
    own = nlp.derivatives
    assert own is not None
    return Lifted(
        mpcc, nlp, place.reshape(2, mpcc.n_pairs), rows, base,
        value=Evaluator(own.grad_f), jacobian=Evaluator(own.jac_g),
        source_values=Evaluator(ca.Function("source", [x, p], [ca.densify(f), column])),
    )  # fmt: skip


def warm_start(lifted: Lifted, weight: float, duals: MPCCResult | Duals) -> tuple[Array, Array]:
    """Multipliers of the source problem as those of the unknowns and rows of the lifted one.

    A slack ``s = G_i(x)`` inherits the multiplier of its pair; of a member that is itself an unknown the
    multipliers of its bound and of its pair add up. NaN counts as zero.

    Raises
    ------
    BadInputError
        If they are of another kind or size.
    """
    source = lifted.source
    if not isinstance(duals, (MPCCResult, Duals)):
        raise BadInputError(f"start must be a former result or Duals, got {duals!r}; a point is x0")
    for part in ("x", "g", "G", "H"):
        needed, got = getattr(source, part).shape[0], np.size(getattr(duals, f"lam_{part}"))
        if got != needed:
            raise BadInputError(f"start has {got} multipliers lam_{part}, the problem needs {needed}")
    column = weight * np.nan_to_num(np.concatenate([duals.lam_g, duals.lam_G, duals.lam_H]))
    lam_z = np.zeros(lifted.nlp.n_x)
    lam_z[: source.n_x] = weight * np.nan_to_num(duals.lam_x)
    np.add.at(lam_z, lifted.pairs.ravel(), column[source.n_g :])
    return lam_z, column[lifted.rows]


def automatic_derivatives(x: Symbolic, p: Symbolic, f: Symbolic, g: Symbolic) -> Derivatives:
    """CasADi's own derivatives, made once and shared by every NLP built on the oracle.

    Those that are constant are numbers: symbolic ones of a dense quadratic program of 150 unknowns take
    CasADi ten seconds.
    """
    kind = type(x)
    lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", g.shape[0])
    gradient = ca.densify(ca.gradient(f, x))
    jacobian = _constant_jacobian(g, x, p)
    linear = jacobian is not None
    constant = _constant_jacobian(gradient, x, p) if linear else None
    lagrangian = lam_f * f + (0 if linear else ca.dot(lam_g, g))
    hessian = ca.hessian(lagrangian, x)[0] if constant is None else lam_f * kind(constant)
    return Derivatives(
        grad_f=ca.Function("nlp_grad_f", [x, p], [f, gradient]),
        jac_g=ca.Function("nlp_jac_g", [x, p], [g, jacobian if linear else ca.jacobian(g, x)]),
        hess_lag=ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [ca.triu(hessian)]),
    )


def _constant_jacobian(rows: Symbolic, x: Symbolic, p: Symbolic) -> ca.DM | None:
    """The Jacobian of dense rows that are linear in x and know no parameter; else nothing.

    The symbolic Jacobian of sparse rows takes few sweeps and less time than a sweep per unknown.
    """
    if rows.is_empty() or x.is_empty() or not p.is_empty() or any(ca.which_depends(rows, x, 2, True)):
        return None
    function, n = ca.Function("rows", [x], [rows]), x.shape[0]
    sparsity, origin = function.jac_sparsity(0, 0), ca.DM.zeros(n)
    if sparsity.density() < _DENSE:
        return None
    at = (ca.repmat(point, 1, n) for point in (origin, function(origin)))
    columns = function.forward(1).map(n)(*at, ca.DM.eye(n))
    return ca.project(columns, sparsity) if columns.is_regular() else None


def _derivatives_of(mpcc: MPCC) -> Derivatives:
    """Those of an MPCC, in one symbol for x and one for p, which CasADi can derive."""
    kind = type(mpcc.x)
    x, p = kind.sym("x", mpcc.n_x), kind.sym("p", mpcc.p.shape[0])
    f, *columns = mpcc.oracle.call([x, p], True, False)
    return automatic_derivatives(x, p, f, ca.vertcat(*columns))


def _plain_unknowns(derivatives: Derivatives, n_x: int, n_g: int) -> Index:
    """For each row of (G, H) the unknown it equals, or -1.

    A row equals ``x_j`` if its Jacobian has the single structural entry j, with value 1 at a random point and
    at its negative, and its value is x_j there: asked numerically, so that it works for any oracle.
    """
    sparsity = derivatives.jac_g.sparsity_out(1)
    row_of, column_of = (np.asarray(part, dtype=np.int64) for part in sparsity.get_triplet())
    is_plain = np.bincount(row_of, minlength=1)[row_of] == 1
    jacobian, random = Evaluator(derivatives.jac_g), np.random.default_rng(0)
    x, p = (random.uniform(0.3, 1.3, n) for n in (n_x, derivatives.jac_g.numel_in(1)))
    for point in (x, -x):
        value, nonzeros = jacobian(point, p)
        is_plain &= (nonzeros == 1.0) & (value[row_of] == point[column_of])
    plain = np.full(sparsity.size1(), -1, dtype=np.int64)
    plain[row_of[is_plain]] = column_of[is_plain]
    return plain[n_g:]
