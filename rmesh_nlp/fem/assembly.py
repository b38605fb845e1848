"""From element Functions to a global objective, constraints and their sparse derivatives.

Each is a sum over elements of one small function of a few local values, which is differentiated once, and
evaluated in numpy for all elements at a time (:mod:`rmesh_nlp.fem.numeric`). For solvers these sums are
CasADi Functions that call Python. Objective and constraints are CasADi expressions as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import local_symbols, plain
from rmesh_nlp.fem.fields import CONSTANT, ElementGroup, Field
from rmesh_nlp.fem.numeric import Numeric, first_order, merged, second_order
from rmesh_nlp.fem.space import Index
from rmesh_nlp.fem.straightened import straightened
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import Derivatives
from rmesh_nlp.vectorised import columnwise


class Assembled:
    """Global objective and constraints as MX expressions, and their derivatives, each built when asked for.

    The fields of the groups index the columns ``x`` or ``p``; of ``n_rows`` constraints those that no group
    touches are zero.
    """

    def __init__(self, groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int) -> None:
        present = [group for group in groups if group.size > 0]
        self._groups = merged([part for group in present for part in straightened(group)])
        self._x, self._p, self._n_rows = x, p, n_rows

    @cached_property
    def first(self) -> Numeric:
        """``(x, p) -> (f, gradient, g, nonzeros of the Jacobian)`` on arrays."""
        return first_order(self._groups, self._x.shape[0], self._n_rows)

    @cached_property
    def second(self) -> Numeric:
        """``(x, p, lam_f, lam_g) -> (nonzeros of the Hessian of the Lagrangian,)``, its upper triangle."""
        return second_order(self._groups, self._x.shape[0], self._n_rows)

    @property
    def f(self) -> ca.MX:
        """The objective."""
        return self._expressions[0]

    @property
    def g(self) -> ca.MX:
        """The constraints."""
        return self._expressions[1]

    @cached_property
    def derivatives(self) -> Derivatives:
        """Derivative Functions in the form that nlpsol takes."""
        x, p, lam_f, lam_g = self._x, self._p, ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self._n_rows)
        kernels = (
            _Summed("nlp_grad_f", [x, p], self.first, slice(0, 2)),
            _Summed("nlp_jac_g", [x, p], self.first, slice(2, 4)),
            _Summed("nlp_hess_l", [x, p, lam_f, lam_g], self.second, slice(0, 1)),
        )
        grad_f, jac_g, hess_lag = (kernel.function for kernel in kernels)
        return Derivatives(grad_f, jac_g, hess_lag, kernels)

    @cached_property
    def _expressions(self) -> tuple[ca.MX, ca.MX]:
        f, g = ca.MX(0), ca.MX.zeros(self._n_rows)
        for group in self._groups:
            function = plain(group.function, group.at_points)
            arguments = [self._gathered(field) for field in group.arguments]
            value, rows = function.map(group.size).call(arguments)
            if not function(*local_symbols(function))[0].is_zero():
                f += ca.sum2(value)
            used = group.rows != CONSTANT
            if np.any(used):
                place = _by_element(used)[used]
                g += _selection(group.rows[used], place, (self._n_rows, used.size)) @ ca.vec(rows)
        return f, g

    def _gathered(self, field: Field) -> ca.MX:
        """Local values (length, elements) of a field."""
        w, used = self._p if field.parameter else self._x, field.index != CONSTANT
        shape = used.size, w.numel()
        pick = _selection(_by_element(used)[used], field.index[used], shape, field.scale[used])
        return ca.reshape(pick @ w + ca.DM(field.offset.ravel(order="F")), *used.shape)


class _Summed(PythonFunction):
    """Some results of sums as a Function of dense columns."""

    def __init__(self, name: str, inputs: list[ca.MX], numeric: Numeric, chosen: slice) -> None:
        self._numeric, self._chosen = numeric, chosen
        outputs = [sums.pattern for sums in numeric.sums[chosen]]
        super().__init__(name, [symbol.sparsity() for symbol in inputs], outputs)
        self.function = ca.Function(name, inputs, self.call(inputs))

    def has_eval_buffer(self) -> bool:
        """Evaluation in place, without copies to CasADi's own matrices."""
        return True

    def eval_buffer(self, arg: list[memoryview | None], res: list[memoryview | None]) -> int:
        """Evaluate on flat buffers of all nonzeros; an argument None is zero, a result None is not wanted."""
        nonzeros = self._numeric(*(None if a is None else np.frombuffer(a) for a in arg))
        for result, values in zip(res, nonzeros[self._chosen], strict=True):
            if result is not None:
                np.frombuffer(result)[:] = values
        return 0


def _by_element(values: NDArray) -> Index:
    """Where CasADi stores the entries of a (length, elements) array: one element after the other."""
    return np.arange(values.size).reshape(values.shape, order="F")


def _selection(row: Index, column: Index, shape: tuple[int, int], value: Array | float = 1.0) -> ca.DM:
    """A sparse matrix by its entries; zeros among them are kept."""
    values = np.broadcast_to(value, row.shape)
    matrix = sp.csc_matrix((values, (row, column)), shape=shape)
    matrix.sort_indices()  # CasADi ends the process where they are not
    return ca.DM(matrix)


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    evaluate = [columnwise(plain(group.function, group.at_points), group.size) for group in groups]

    def values(x: Array) -> list[Array]:
        by_group = []
        for columns, group in zip(evaluate, groups, strict=True):
            by_group.append(columns([field.values(x) for field in group.arguments])[0].ravel())
        return by_group

    return values
