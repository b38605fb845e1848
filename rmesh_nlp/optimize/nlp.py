"""A nonlinear program (NLP) as CasADi expressions, and its extension by terms and constraints.

Form and signs, here and everywhere in the package::

    minimise f(x, p)   subject to   lbg <= g(x, p) <= ubg,   lbx <= x <= ubx,
    Lagrangian  f + lam_g^T g + lam_x^T x,

so an active lower bound has a non-positive multiplier, an active upper bound a
non-negative one (CasADi's convention).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array


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

    x: Any
    p: Any
    f: Any
    g: Any
    lbx: Array
    ubx: Array
    lbg: Array
    ubg: Array
    derivatives: Derivatives | None = None
    _of: tuple[int, int] = field(default=(0, 0), repr=False)
    parts: Mapping[str, Any] = field(default_factory=dict, repr=False)

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
        return int(self.x.shape[0])

    @cached_property
    def n_g(self) -> int:
        """Number of constraints."""
        return int(self.g.shape[0])

    def extended(
        self,
        *,
        x: Any = None,
        p: Any = None,
        f: Any = 0,
        g: Any = None,
        lbx: ArrayLike = (),
        ubx: ArrayLike = (),
        lbg: ArrayLike = (),
        ubg: ArrayLike = (),
    ) -> NLP:
        """Append unknowns, parameters and constraint rows and add a term to the objective.

        The assembled derivatives of what was there are kept; only the new ``f`` and ``g``
        are differentiated by CasADi. Their expressions may use old and new unknowns.

        Parameters
        ----------
        x, p : symbols to append to the unknowns and to the parameters
        f : term added to the objective
        g : rows appended to the constraints
        lbx, ubx, lbg, ubg : bounds of the appended unknowns and rows
        """
        kind = type(self.x)
        new_x, new_p, new_g = (kind(0, 1) if new is None else new for new in (x, p, g))
        all_x, all_p = ca.vertcat(self.x, new_x), ca.vertcat(self.p, new_p)
        derivatives = None
        if self.derivatives is not None:
            derivatives = _extend_derivatives(self, self.derivatives, new_x, all_x, all_p, kind(f), new_g)
        return replace(
            self,
            x=all_x,
            p=all_p,
            f=self.f + f,
            g=ca.vertcat(self.g, new_g),
            lbx=np.append(self.lbx, lbx),
            ubx=np.append(self.ubx, ubx),
            lbg=np.append(self.lbg, lbg),
            ubg=np.append(self.ubg, ubg),
            derivatives=derivatives,
            _of=(0, 0),
        )


def _identity(expression: Any) -> int:
    """A number for an expression; SX columns have no hash."""
    return hash(expression) if isinstance(expression, ca.MX) else id(expression)


def _extend_derivatives(
    nlp: NLP, base: Derivatives, new_x: Any, x: Any, p: Any, f: Any, g: Any
) -> Derivatives:
    """Sum the derivatives of ``nlp`` and the automatic ones of the appended ``f`` and ``g``."""
    kind, n_new = type(nlp.x), int(new_x.shape[0])
    f_old, gradient = base.grad_f(nlp.x, nlp.p)
    g_old, jacobian = base.jac_g(nlp.x, nlp.p)
    slope = ca.vertcat(gradient, kind(n_new, 1)) + ca.densify(ca.gradient(f, x))
    rows = ca.vertcat(ca.horzcat(jacobian, kind(nlp.n_g, n_new)), ca.jacobian(g, x))
    hess_lag = None
    if base.hess_lag is not None:
        lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", nlp.n_g + int(g.shape[0]))
        lam_old, lam_new = ca.vertsplit(lam_g, [0, nlp.n_g, lam_g.shape[0]])
        hessian = ca.diagcat(base.hess_lag(nlp.x, nlp.p, lam_f, lam_old), kind(n_new, n_new))
        # the appended part is small or sparse: CasADi colours it well
        hessian_new = ca.triu(ca.hessian(lam_f * f + ca.dot(lam_new, g), x)[0])
        hess_lag = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian + hessian_new])
    return Derivatives(
        grad_f=ca.Function("nlp_grad_f", [x, p], [f_old + f, slope]),
        jac_g=ca.Function("nlp_jac_g", [x, p], [ca.vertcat(g_old, g), rows]),
        hess_lag=hess_lag,
        kernels=base.kernels,
    )
