"""From element Functions to a global objective, constraints and their sparse derivatives.

A mesh problem is partially separable: its objective and constraints are sums over elements
of one small function of a few local values. The small function is differentiated once, as
SX, mapped over all elements, and its results are summed into the nonzeros of the global
derivatives by one constant sparse matrix. Building and evaluating are both linear in the
number of elements; the sparsity never changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.bending import straightened
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.fields import ElementGroup
from rmesh_nlp.fem.kernels import Kernel, LocalKernels
from rmesh_nlp.fem.sums import InCasadi, in_numpy
from rmesh_nlp.optimize.nlp import Derivatives
from rmesh_nlp.vectorised import USUAL, AssemblySettings, columnwise


class Assembled:
    """Global objective and constraints as MX expressions, and their derivatives.

    Each is stated when it is first asked for. This object must live as long as any Function made of the
    derivatives: some are Python callbacks, which CasADi does not own.

    Attributes
    ----------
    f, g : MX
        Objective and constraints.
    """

    def __init__(
        self,
        groups: Sequence[ElementGroup],
        x: ca.MX,
        p: ca.MX,
        n_rows: int,
        settings: AssemblySettings = USUAL,
    ) -> None:
        present = [group for group in groups if group.size > 0]
        self._local = [LocalKernels(part) for group in present for part in straightened(group)]
        self._large = any(group.size >= settings.numpy_from for group in groups)
        self._settings = settings
        self._inputs = [x, p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows)]
        self._n_x, self._n_rows = int(x.shape[0]), n_rows
        self._in_casadi = InCasadi(self._inputs)
        self._kept: list[ca.Function] = []

    @cached_property
    def _values(self) -> list[ca.MX]:
        return self._in_casadi([(1, 1), (self._n_rows, 1)], [part.values() for part in self._local])

    @property
    def f(self) -> ca.MX:
        """The objective."""
        return self._values[0]

    @property
    def g(self) -> ca.MX:
        """The constraints."""
        return self._values[1]

    @cached_property
    def grad_f(self) -> ca.Function:
        """``(x, p) -> (f, gradient)``."""
        shapes = [(1, 1), (self._n_x, 1)]
        return self._function("nlp_grad_f", 2, shapes, [part.gradient() for part in self._local])

    @cached_property
    def jac_g(self) -> ca.Function:
        """``(x, p) -> (g, Jacobian)``."""
        shapes = [(self._n_rows, 1), (self._n_rows, self._n_x)]
        return self._function("nlp_jac_g", 2, shapes, [part.jacobian() for part in self._local])

    @cached_property
    def hess_lag(self) -> ca.Function:
        """``(x, p, lam_f, lam_g) ->`` upper triangle of the Hessian of the Lagrangian."""
        shapes = [(self._n_x, self._n_x)]
        return self._function("nlp_hess_l", 4, shapes, [part.hessian() for part in self._local])

    @property
    def kernels(self) -> tuple[ca.Function, ...]:
        """The callbacks behind the derivatives that were asked for so far."""
        return tuple(self._kept)

    @property
    def derivatives(self) -> Derivatives:
        """The derivative Functions in the form that nlpsol takes."""
        return Derivatives(self.grad_f, self.jac_g, self.hess_lag, self.kernels)

    def _function(
        self, name: str, n_in: int, shapes: list[tuple[int, int]], kernels: list[Kernel]
    ) -> ca.Function:
        inputs = self._inputs[:n_in]
        if not self._large:
            return ca.Function(name, inputs, self._in_casadi(shapes, kernels))
        self._kept.append(in_numpy(name, inputs, shapes, kernels, self._settings))
        return ca.Function(name, inputs, self._kept[-1].call(inputs))


def assemble(
    groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int, settings: AssemblySettings = USUAL
) -> Assembled:
    """Sum element groups into one objective and ``n_rows`` constraints of ``x`` and ``p``.

    Parameters
    ----------
    groups : sequence of ElementGroup
        Their fields index ``x`` or ``p``.
    x, p : MX symbols, columns
    n_rows : int
        Number of constraints; rows that no group touches are zero.
    settings : AssemblySettings
    """
    return Assembled(groups, x, p, n_rows, settings)


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        return [
            columns([field.values(x) for field in group.arguments])[0].ravel()
            for columns, group in zip(evaluate, groups, strict=True)
        ]

    return values
