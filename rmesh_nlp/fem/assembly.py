"""From element Functions to a global objective, constraints and their sparse derivatives.

Each is a sum over elements of one small function of a few local values, which is differentiated once
(:mod:`rmesh_nlp.fem.element`), and evaluated in numpy for all elements at a time. For solvers these sums are
CasADi Functions that call Python. Objective and constraints are CasADi expressions as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Index, constant_of, sparsity_of
from rmesh_nlp.fem.element import PointSums, differentiated, local_symbols
from rmesh_nlp.fem.fields import ElementGroup, Field, constant_field, plain_field
from rmesh_nlp.fem.straightened import straightened
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.nlp import Derivatives
from rmesh_nlp.vectorised import columnwise


class Assembled:
    """Global objective and constraints and their derivatives, each built when asked for.

    The fields of the groups index the columns ``x`` or ``p``; of ``n_rows`` constraints those that no group
    touches are zero.
    """

    def __init__(self, groups: Sequence[ElementGroup], x: ca.MX, p: ca.MX, n_rows: int) -> None:
        present = [group for group in groups if group.size > 0]
        self._groups = merged([part for group in present for part in straightened(group)])
        self._x, self._p, self._n_rows = x, p, n_rows

    @cached_property
    def first(self) -> Sums:
        """``(x, p) -> (f, gradient, g, nonzeros of the Jacobian)`` on arrays."""
        n_x, n_rows, parts = self._x.shape[0], self._n_rows, []
        for group in self._groups:
            variable, (one, rows, x) = _variable(group), _axes(group)
            function = differentiated(group.function, group.at_points, variable).first
            pairs = (one, one), (x, one), (rows, one), (rows, x)
            entries = [_entries(*pair, function.sparsity_out(k)) for k, pair in enumerate(pairs)]
            parts.append(Part(group.arguments, group.at_points, function, entries))
        return Sums([(1, 1), (n_x, 1), (n_rows, 1), (n_rows, n_x)], parts)

    @cached_property
    def second(self) -> Sums:
        """``(x, p, lam_f, lam_g) -> (nonzeros of the Hessian of the Lagrangian,)``, its upper triangle."""
        n_x, parts = self._x.shape[0], []
        for group in self._groups:
            variable, (one, rows, x) = _variable(group), _axes(group)
            function = differentiated(group.function, group.at_points, variable).second
            multipliers = plain_field(one.index, 2), plain_field(rows.index, 3)
            entries = _upper(x, function.sparsity_out(0))
            parts.append(Part((*group.arguments, *multipliers), group.at_points, function, [entries]))
        return Sums([(n_x, n_x)], parts)

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
            function = group.plain
            value, rows = function.map(group.size).call([self._gathered(field) for field in group.arguments])
            if not function(*local_symbols(function))[0].is_zero():
                f += ca.sum2(value)
            g += _picking(group.rows, np.ones(group.rows.shape), self._n_rows).T @ ca.vec(rows)
        return f, g

    def _gathered(self, field: Field) -> ca.MX:
        """Local values (length, elements) of a field."""
        w = self._p if field.source else self._x
        values = _picking(field.index, field.scale, w.numel()) @ w + ca.DM(field.offset.ravel(order="F"))
        return ca.reshape(values, *field.index.shape)


def _picking(index: Index, scale: Array, n: int) -> ca.DM:
    """What takes n values to those of this index (length, elements), one element after the other."""
    numbers, factors = index.ravel(order="F"), scale.ravel(order="F")
    used = np.flatnonzero(numbers >= 0)
    return constant_of(sp.csc_array((factors[used], (used, numbers[used])), shape=(numbers.size, n)))


class Entries(NamedTuple):
    """Where local results (length, elements) go: ``matrix[row, column] += scale * result``; -1 drops one."""

    row: Index
    column: Index
    scale: Array


class Part(NamedTuple):
    """Elements that share a function, its arguments, and where each of its results goes."""

    arguments: tuple[Field, ...]
    at_points: PointSums | None
    function: ca.Function
    entries: list[Entries]

    def compiled(self) -> Callable[[Sequence[Array]], list[Array]]:
        """A function of x, p, lam_f and lam_g: the local results."""
        columns = columnwise(self.function, self.arguments[0].shape[1])
        from_points = self.function.n_in() - len(self.arguments)

        def local(inputs: Sequence[Array]) -> list[Array]:
            values = [field.values(inputs[field.source]) for field in self.arguments]
            if self.at_points is not None:
                values += self.at_points.evaluated(values[0], from_points)
            return columns(values)

        return local


class Sums:
    """Results of element functions summed into sparse matrices: a function of arrays.

    Columns are dense. The last results are remembered: a solver asks for them one by one.

    Attributes
    ----------
    patterns : list of sparse arrays
        Those of the results, with 1, 2, ... as values; ``pattern`` is that of the last one.
    """

    def __init__(self, shapes: Sequence[tuple[int, int]], parts: Sequence[Part]) -> None:
        used = [part for part in parts if any(entries.row.size for entries in part.entries)]
        self._parts = [part.compiled() for part in used]
        sums = [_summed(shape, [part.entries[k] for part in used]) for k, shape in enumerate(shapes)]
        self.patterns, self._sums = [pattern for pattern, _ in sums], [total for _, total in sums]
        self.pattern = self.patterns[-1]
        self._last: tuple[list[bytes], list[Array]] | None = None

    def __call__(self, *inputs: Array | None) -> list[Array]:
        """Nonzeros of each result, not to be written to, at as many of x, p, lam_f and lam_g as it takes."""
        given = [np.zeros(0) if values is None else values for values in inputs]
        key = [values.tobytes() for values in given]
        if self._last is None or key != self._last[0]:
            with np.errstate(all="ignore"):  # Ipopt tries any point; what is not finite shows in the result
                local = [part(given) for part in self._parts]
            flat = ([np.zeros(0), *(part[k].ravel() for part in local)] for k in range(len(self._sums)))
            results = [total @ np.concatenate(each) for total, each in zip(self._sums, flat, strict=True)]
            self._last = key, results
        return self._last[1]


def _summed(shape: tuple[int, int], parts: Sequence[Entries]) -> tuple[sp.csc_array, sp.csr_array]:
    """The pattern of a matrix, its nonzeros numbered, and what takes local results to its nonzeros."""
    row, column, scale = (
        np.concatenate([np.zeros(0, kind), *(part[k].ravel() for part in parts)])
        for k, kind in enumerate((np.int64, np.int64, np.float64))
    )
    place = np.flatnonzero((row >= 0) & (column >= 0))
    names, number = column[place] * shape[0] + row[place], row[place]
    if shape[1] == 1:
        names = np.arange(shape[0])
    else:
        names, number = np.unique(names, return_inverse=True)
    starts = np.searchsorted(names, np.arange(shape[1] + 1) * shape[0])
    pattern = sp.csc_array((1 + np.arange(names.size), names % max(shape[0], 1), starts), shape=shape)
    return pattern, sp.csr_array((scale[place], (number, place)), shape=(names.size, row.size))


def _variable(group: ElementGroup) -> tuple[int, ...]:
    """Numbers of the arguments that depend on unknowns."""
    return tuple(i for i, field in enumerate(group.arguments) if field.source == 0 and field.varies)


def _axes(group: ElementGroup) -> tuple[Field, Field, Field]:
    """Numbers and scales (length, elements): zeros for the objective, constraint rows, unknowns."""
    variable = [constant_field(np.zeros((0, group.size))), *(group.arguments[i] for i in _variable(group))]
    index, scale = (
        np.concatenate([getattr(field, name) for field in variable]) for name in ("index", "scale")
    )
    unknowns = Field(index, scale, np.zeros(index.shape))
    return plain_field(np.zeros((1, group.size), np.int64)), plain_field(group.rows), unknowns


def _entries(row: Field, column: Field, pattern: ca.Sparsity) -> Entries:
    """Where the local results with this pattern go."""
    a, b = (np.asarray(numbers, dtype=int) for numbers in pattern.get_triplet())
    return Entries(row.index[a], column.index[b], row.scale[a] * column.scale[b])


def _upper(row: Field, pattern: ca.Sparsity) -> Entries:
    """The same of an upper triangle, in that of the sum."""
    a, b = (np.asarray(numbers, dtype=int) for numbers in pattern.get_triplet())
    i, j, scale = _entries(row, row, pattern)
    # of two local values of one unknown the lower triangle folds onto the diagonal too
    twice = (i == j) & (a != b)[:, None]
    return Entries(np.minimum(i, j), np.maximum(i, j), np.where(twice, 2.0, 1.0) * scale)


def merged(groups: Sequence[ElementGroup]) -> list[ElementGroup]:
    """The groups, those of the same elements as one: what their functions have in common is done once."""
    distinct: list[ElementGroup] = []
    for group in groups:
        place = next((k for k, other in enumerate(distinct) if _alike(other, group)), None)
        if place is None:
            distinct.append(group)
        else:
            distinct[place] = _joined(distinct[place], group)
    return distinct


def _alike(first: ElementGroup, second: ElementGroup) -> bool:
    """Whether two groups have the same elements, as far as a shared argument says, and can be joined."""
    shared = first.size == second.size and any(
        _equal(a, b) for a in first.arguments for b in second.arguments
    )
    kinds = {group.function.class_name() for group in (first, second)}
    return shared and len(kinds) == 1 and (first.at_points is None or second.at_points is None)


def _joined(group: ElementGroup, other: ElementGroup) -> ElementGroup:
    """The group of the sum of two objectives, with the rows of both."""
    if other.at_points is not None:  # the first argument is X, the last one has the values
        group, other = other, group
    arguments, places = list(group.arguments), []
    for argument in other.arguments:
        place = next((k for k, own in enumerate(group.arguments) if _equal(own, argument)), len(arguments))
        arguments += [argument] if place == len(arguments) else []
        places.append(place)
    own, n = local_symbols(group.function), len(group.arguments)
    added = [type(own[0]).sym(f"b{i}", argument.shape[0]) for i, argument in enumerate(arguments[n:])]
    columns, values = [*own[:n], *added], own[n:]
    first, second = group.function(*own), other.function(*(columns[k] for k in places))
    results = [first[0] + second[0], ca.vertcat(first[1], second[1])]
    function = ca.Function(group.function.name(), [*columns, *values], results)
    return ElementGroup(function, tuple(arguments), np.concatenate([group.rows, other.rows]), group.at_points)


def _equal(first: Field, second: Field) -> bool:
    return first.source == second.source and all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in ("index", "scale", "offset")
    )


class _Summed(PythonFunction):
    """Some results of sums as a Function of dense columns."""

    def __init__(self, name: str, inputs: list[ca.MX], sums: Sums, chosen: slice) -> None:
        self._sums, self._chosen = sums, chosen
        outputs = [sparsity_of(pattern) for pattern in sums.patterns[chosen]]
        super().__init__(name, [symbol.sparsity() for symbol in inputs], outputs)
        self.function = ca.Function(name, inputs, self.call(inputs))

    def has_eval_buffer(self) -> bool:
        """Evaluation in place, without copies to CasADi's own matrices."""
        return True

    def eval_buffer(self, arg: list[memoryview | None], res: list[memoryview | None]) -> int:
        """Evaluate on flat buffers of all nonzeros; an argument None is zero, a result None is not wanted."""
        inputs = (np.zeros(self.nnz_in(k)) if a is None else np.frombuffer(a) for k, a in enumerate(arg))
        nonzeros = self._sums(*inputs)
        for result, values in zip(res, nonzeros[self._chosen], strict=True):
            if result is not None:
                np.frombuffer(result)[:] = values
        return 0


def element_values(groups: Sequence[ElementGroup]) -> Callable[[Array], list[Array]]:
    """A function of the unknowns ``x``: what each element of each group adds to the objective."""
    each = [(columnwise(group.plain, group.size), group.arguments) for group in groups]
    return lambda x: [columns([field.values(x) for field in given])[0].ravel() for columns, given in each]
