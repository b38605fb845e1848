"""From element Functions to a global objective, constraints and their sparse derivatives.

A mesh problem is partially separable: its objective and constraints are sums over elements
of one small function of a few local values. The small function is differentiated once, as
SX, mapped over all elements, and its results are summed into the nonzeros of the global
derivatives by one constant sparse matrix. Building and evaluating are both linear in the
number of elements; the sparsity never changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bending import straightened
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.fields import ElementGroup
from rmesh_nlp.fem.kernels import Kernel, LocalKernels
from rmesh_nlp.fem.sums import InCasadi, in_numpy
from rmesh_nlp.fem.vectorised import WORTHWHILE, columnwise
from rmesh_nlp.optimize.nlp import Derivatives


@dataclass(frozen=True)
class Assembled:
    """Global objective and constraints as MX expressions, and their derivatives.

    ``kernels`` must live as long as any Function made of the derivatives: some are Python
    callbacks, which CasADi does not own.
    """

    f: ca.MX
    g: ca.MX
    grad_f: ca.Function
    jac_g: ca.Function
    hess_lag: ca.Function
    kernels: tuple[ca.Function, ...]

    @property
    def derivatives(self) -> Derivatives:
        """The derivative Functions in the form that nlpsol takes."""
        return Derivatives(self.grad_f, self.jac_g, self.hess_lag, self.kernels)


def assemble(groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int) -> Assembled:
    """Sum element groups into one objective and ``n_rows`` constraints of ``x`` and ``p``.

    Parameters
    ----------
    groups : sequence of ElementGroup
        Their fields index ``x`` or ``p``.
    x, p : MX symbols, columns
    n_rows : int
        Number of constraints; rows that no group touches are zero.
    """
    local = [LocalKernels(part) for group in groups if group.size > 0 for part in straightened(group)]
    large = any(group.size >= WORTHWHILE for group in groups)
    inputs = [x, p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)]
    n_x = int(x.shape[0])
    in_casadi = InCasadi(inputs)
    kept: list[ca.Function] = []

    def function(name: str, n_in: int, shapes: list[tuple[int, int]], kernels: list[Kernel]) -> ca.Function:
        if not large:
            return ca.Function(name, inputs[:n_in], in_casadi(shapes, kernels))
        kept.append(in_numpy(name, inputs[:n_in], shapes, kernels))
        return ca.Function(name, inputs[:n_in], kept[-1].call(inputs[:n_in]))

    f, g = in_casadi([(1, 1), (n_rows, 1)], [part.values() for part in local])
    return Assembled(
        f=f,
        g=g,
        grad_f=function("nlp_grad_f", 2, [(1, 1), (n_x, 1)], [part.gradient() for part in local]),
        jac_g=function("nlp_jac_g", 2, [(n_rows, 1), (n_rows, n_x)], [part.jacobian() for part in local]),
        hess_lag=function("nlp_hess_l", 4, [(n_x, n_x)], [part.hessian() for part in local]),
        kernels=tuple(kept),
    )


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        return [
            columns([field.values(x) for field in group.arguments])[0].ravel()
            for columns, group in zip(evaluate, groups, strict=True)
        ]

    return values
