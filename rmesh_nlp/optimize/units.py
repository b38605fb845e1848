"""An NLP in other units of its unknowns and rows, solved and reported in its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.nlp import NLP, Derivatives
from rmesh_nlp.optimize.solver import NLPResult


@dataclass(frozen=True)
class Units:
    """Positive units of unknowns (n_x,) and rows (n_g,), for a solver with absolute tolerances."""

    x: Array
    g: Array

    def program(self, nlp: NLP) -> NLP:
        """The NLP in ``x / self.x`` with rows ``g / self.g``; its derivatives must be assembled."""
        if nlp.derivatives is None:
            raise ValueError("an NLP without assembled derivatives cannot be put in other units")
        base, p, x = nlp.derivatives, nlp.p, ca.MX.sym("x", nlp.n_x)
        own, lam_f, lam_g = self.x * x, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
        f, g = ca.Function("values", [nlp.x, p], [nlp.f, nlp.g])(own, p)
        value, gradient = base.grad_f(own, p)
        rows, jacobian = base.jac_g(own, p)
        hess_lag = None
        if base.hess_lag is not None:
            hessian = base.hess_lag(own, p, lam_f, lam_g / self.g)
            hess_lag = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [_scaled(hessian, self.x, self.x)])
        return NLP(
            x=x,
            p=p,
            f=f,
            g=g / self.g,
            lbx=nlp.lbx / self.x,
            ubx=nlp.ubx / self.x,
            lbg=nlp.lbg / self.g,
            ubg=nlp.ubg / self.g,
            derivatives=Derivatives(
                ca.Function("nlp_grad_f", [x, p], [value, self.x * gradient]),
                ca.Function("nlp_jac_g", [x, p], [rows / self.g, _scaled(jacobian, 1 / self.g, self.x)]),
                hess_lag,
                (*base.kernels, base.grad_f, base.jac_g),
            ),
        )

    def result(self, result: NLPResult) -> NLPResult:
        """A result of that NLP in the units of the original one."""
        return replace(
            result,
            x=result.x * self.x,
            g=result.g * self.g,
            lam_x=result.lam_x / self.x,
            lam_g=result.lam_g / self.g,
        )


@dataclass(frozen=True)
class Seen:
    """A monitor of the original NLP, shown the iterates of that in other units.

    ``step`` says at ``(iteration, x, f)`` whether to stop; ``multipliers`` takes those of the rows before.
    """

    units: Units
    step: Callable[[int, Array, float], bool]
    multipliers: Callable[[Array], None]

    def see_multipliers(self, lam_g: Array) -> None:
        """Hand the multipliers on."""
        self.multipliers(lam_g / self.units.g)

    def __call__(self, iteration: int, x: Array, f: float) -> bool:
        """Hand the iterate on."""
        return self.step(iteration, x * self.units.x, f)


def _scaled(matrix: ca.MX, rows: ArrayLike, columns: ArrayLike) -> ca.MX:
    """``diag(rows) @ matrix @ diag(columns)``, of the same sparsity."""
    pattern = matrix.sparsity()
    factors = np.asarray(rows)[pattern.row()] * np.asarray(columns)[pattern.get_col()]
    return matrix * ca.DM(pattern, factors)
