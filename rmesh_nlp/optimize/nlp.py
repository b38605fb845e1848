"""A nonlinear program (NLP) as CasADi expressions, and its extension by terms and constraints.

Form and signs, here and everywhere in the package::

    minimise f(x, p)   subject to   lbg <= g(x, p) <= ubg,   lbx <= x <= ubx,
    Lagrangian  f + lam_g^T g + lam_x^T x,

so an active lower bound has a non-positive multiplier, an active upper bound a
non-negative one (CasADi's convention).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array

Symbolic: TypeAlias = ca.SX | ca.MX
"""An expression of CasADi."""


@dataclass(frozen=True)
class Derivatives:
    """Derivative Functions that replace CasADi's automatic ones, in the form nlpsol takes.

    Attributes
    ----------
    grad_f : casadi.Function
        ``(x, p) -> (f, grad_f_x)``, the gradient a dense column.
    jac_g : casadi.Function
        ``(x, p) -> (g, jac_g_x)``.
    hess_lag : casadi.Function or None
        ``(x, p, lam_f, lam_g) -> triu_hess_gamma_x_x``, upper triangle of the Hessian of
        ``lam_f f + lam_g^T g``. None where only quasi-Newton methods are meant.
    kernels : tuple
        What must live as long as these Functions: Python callbacks, which CasADi does not own.
    """

    grad_f: ca.Function
    jac_g: ca.Function
    hess_lag: ca.Function | None
    kernels: tuple[ca.Function, ...] = ()


@dataclass(frozen=True)
class NLP:
    """A parametric NLP in CasADi expressions.

    Attributes
    ----------
    x, p : SX or MX, columns
        Unknowns and parameters (``p`` may be of length 0).
    f, g : SX or MX
        Scalar objective and column of constraints.
    lbx, ubx, lbg, ubg : arrays
        Bounds.
    derivatives : Derivatives or None
        Assembled derivatives of exactly this ``f`` and ``g``. None: CasADi derives them.
        To add a term or a constraint use :meth:`extended`, which keeps them; if you
        ``dataclasses.replace`` ``f`` or ``g``, set ``derivatives=None`` as well.
    parts : mapping of str to expression
        Parts of the unknowns by name.
    """

    x: Symbolic
    p: Symbolic
    f: Symbolic
    g: Symbolic
    lbx: Array
    ubx: Array
    lbg: Array
    ubg: Array
    derivatives: Derivatives | None = None
    _of: tuple[int, int] = field(default=(0, 0), repr=False)
    parts: Mapping[str, Symbolic] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        of = (_identity(self.f), _identity(self.g))
        if self.derivatives is not None and self._of not in ((0, 0), of):
            raise ValueError(
                "f or g was replaced but the derivatives were not: use extended(), or derivatives=None"
            )
        object.__setattr__(self, "_of", of)

    @cached_property
    def n_x(self) -> int:
        """Number of unknowns."""
        return self.x.shape[0]

    @cached_property
    def n_g(self) -> int:
        """Number of constraints."""
        return self.g.shape[0]

    def extended(
        self,
        *,
        x: Symbolic | None = None,
        p: Symbolic | None = None,
        f: Symbolic | float = 0,
        g: Symbolic | None = None,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
        weight: Symbolic | float = 1,
        rows: Sequence[int] | None = None,
        shift: Symbolic | None = None,
    ) -> NLP:
        """Append unknowns, parameters and constraint rows; change the objective and the rows by terms.

        The assembled derivatives of what was there are kept; only the new expressions are differentiated by
        CasADi. They may use old and new unknowns and parameters.

        Parameters
        ----------
        x, p : symbols to append to the unknowns and to the parameters
        f : term added to the objective
        g : rows appended to the constraints
        lbx, ubx, lbg, ubg : bounds of the appended unknowns and rows; a scalar holds for all of them
        weight : number or parameter by which the old objective is multiplied
        rows : numbers of the old rows that are kept, in their new order; None: all
        shift : column added to the kept rows
        """
        kind = type(self.x)
        new_x, new_p, new_g = (kind(0, 1) if new is None else new for new in (x, p, g))
        kept = list(range(self.n_g) if rows is None else rows)
        terms = ca.vertcat(kind(len(kept), 1) if shift is None else shift, new_g)
        larger = replace(
            self,
            x=ca.vertcat(self.x, new_x),
            p=ca.vertcat(self.p, new_p),
            f=weight * self.f + f,
            g=_rows(self.g, kept, terms),
            lbx=longer(self.lbx, lbx, new_x),
            ubx=longer(self.ubx, ubx, new_x),
            lbg=longer(self.lbg[kept], lbg, new_g),
            ubg=longer(self.ubg[kept], ubg, new_g),
            derivatives=None,
            _of=(0, 0),
        )
        if self.derivatives is None:
            return larger
        own = _extended_derivatives(self, larger, kept, weight, kind(f), terms)
        return replace(larger, derivatives=own)


def _rows(old: Symbolic, kept: list[int], terms: Symbolic) -> Symbolic:
    """The kept rows, then none, plus terms."""
    return ca.densify(ca.vertcat(old[kept], type(old)(terms.shape[0] - len(kept), 1)) + terms)


def longer(old: ArrayLike, new: ArrayLike, column: Symbolic) -> Array:
    """Bounds, and those of an appended column."""
    return np.append(old, np.broadcast_to(np.asarray(new, dtype=float), (column.shape[0],)))


def _identity(expression: Symbolic) -> int:
    """A number for an expression; SX columns have no hash."""
    return hash(expression) if isinstance(expression, ca.MX) else id(expression)


def _extended_derivatives(
    nlp: NLP, larger: NLP, kept: list[int], weight: Symbolic | float, f: Symbolic, terms: Symbolic
) -> Derivatives:
    """Those of the old objective and of the kept rows, plus automatic ones of the new terms."""
    kind, base = type(nlp.x), nlp.derivatives
    assert base is not None
    x, p, n_new = larger.x, larger.p, larger.n_x - nlp.n_x
    f_old, gradient = base.grad_f(nlp.x, nlp.p)
    g_old, jacobian = base.jac_g(nlp.x, nlp.p)
    n_appended = larger.n_g - len(kept)
    slope = ca.vertcat(weight * gradient, kind(n_new, 1)) + ca.densify(ca.gradient(f, x))
    rows = ca.diagcat(jacobian[kept, :], kind(n_appended, n_new)) + ca.jacobian(terms, x)
    hess_lag = None
    if base.hess_lag is not None:
        lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", larger.n_g)
        at = ca.Sparsity.triplet(nlp.n_g, larger.n_g, kept, list(range(len(kept))))
        lam_old = ca.densify(ca.mtimes(kind(ca.DM(at, 1.0)), lam_g))
        hessian = ca.diagcat(base.hess_lag(nlp.x, nlp.p, weight * lam_f, lam_old), kind(n_new, n_new))
        # the new terms are small or sparse: CasADi colours them well
        hessian_new = ca.triu(ca.hessian(lam_f * f + ca.dot(lam_g, terms), x)[0])
        hess_lag = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian + hessian_new])
    return Derivatives(
        grad_f=ca.Function("nlp_grad_f", [x, p], [weight * f_old + f, slope]),
        jac_g=ca.Function("nlp_jac_g", [x, p], [_rows(g_old, kept, terms), rows]),
        hess_lag=hess_lag,
        kernels=base.kernels,
    )
