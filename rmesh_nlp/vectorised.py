"""Functions over many columns, one column per element.

CasADi's map runs all operations of a Function on one column, then on the next. With numpy each
operation runs over thousands of columns: a third of the time, for the same numbers up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Evaluator

NUMPY_FROM = 200
"""Number of columns from which on numpy takes the place of CasADi's map. Functions of 128 to 5000 operations
are as fast in both with 200, and with 1000 three times as fast in numpy."""

LEAN_FROM = 64
"""Number of columns from which on operations that stand twice are looked for: fewer are done again sooner."""

CHUNK = 4096
"""Columns at a time, so that what is being worked on stays in the cache."""


OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a, out: np.add(a, a, out),
    ca.OP_INV: np.reciprocal,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_TANH: np.tanh,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_NOT: lambda a, out: np.equal(a, 0, out),
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, a, out: np.copyto(out, np.where(condition != 0, a, 0.0)),
}

MOVES = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT)


@lru_cache(maxsize=256)
def is_vectorisable(function: ca.Function) -> bool:
    """Whether every operation of a Function is one that numpy has."""
    if not function.is_a("SXFunction"):
        return False
    supported = {*OPERATIONS, *MOVES}
    return all(function.instruction_id(k) in supported for k in range(function.n_instructions()))


Columns = Callable[[Sequence[Array | None]], list[Array]]
"""Takes the arguments of a Function and gives the nonzeros of its results, all as (length, columns) arrays.
As everywhere in CasADi an argument None is zero."""


def columnwise(function: ca.Function, n: int) -> Columns:
    """A Function with dense arguments over ``n`` columns, the faster way."""
    if n < LEAN_FROM or not is_vectorisable(function):
        return Mapped(function, n)
    return (Vectorised if n >= NUMPY_FROM else Mapped)(lean(function), n)


@lru_cache(maxsize=256)
def lean(function: ca.Function) -> ca.Function:
    """The same Function without operations that stand in it twice."""
    arguments = function.sx_in()
    return ca.Function(function.name(), arguments, ca.cse(function.call(arguments)))


class Mapped:
    """``function.map(n)`` on arrays."""

    def __init__(self, function: ca.Function, n: int) -> None:
        self._evaluate, self._n = Evaluator(function.map(n)), n

    def __call__(self, arguments: Sequence[Array | None]) -> list[Array]:
        """See :data:`Columns`."""
        results = self._evaluate(*(0.0 if a is None else a for a in arguments))
        return [result.reshape(self._n, -1).T for result in results]


class Vectorised:
    """The same in numpy, ``CHUNK`` columns at a time, of a Function that :func:`is_vectorisable`."""

    def __init__(self, function: ca.Function, n: int) -> None:
        self._function, self._n = function, n
        self._bound: dict[int, _Bound] = {}

    def __call__(self, arguments: Sequence[Array | None]) -> list[Array]:
        """See :data:`Columns`."""
        lengths = (self._function.nnz_out(i) for i in range(self._function.n_out()))
        results = [np.empty((length, self._n)) for length in lengths]
        with np.errstate(all="ignore"):  # as CasADi: what is not finite shows in the result
            for first in range(0, self._n, CHUNK):
                columns = slice(first, min(first + CHUNK, self._n))
                width = columns.stop - columns.start
                if width not in self._bound:
                    self._bound[width] = _Bound(self._function, width)
                self._bound[width].run(arguments, results, columns)
        return results


class _Bound:
    """The operations of a Function on arrays of its own of one width: looking them up takes as long."""

    def __init__(self, function: ca.Function, width: int) -> None:
        store, held = list(np.empty((function.sz_w(), width))), [np.zeros(0)] * function.sz_w()
        self._inputs: dict[tuple[int, int], Array] = {}
        self._outputs = [np.empty((function.nnz_out(i), width)) for i in range(function.n_out())]
        self._steps: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
        for operation, target, sources in _instructions(function):
            if operation == ca.OP_CONST:
                held[target] = sources
            elif operation == ca.OP_INPUT:
                held[target] = self._inputs.setdefault(sources, np.zeros(width))
            elif operation == ca.OP_OUTPUT:
                self._steps.append((np.copyto, (self._outputs[target[0]][target[1]], held[sources])))
            else:
                operands = [held[source] for source in sources]
                held[target] = store[target]
                self._steps.append((operation, (*operands, store[target])))

    def run(self, arguments: Sequence[Array | None], results: list[Array], columns: slice) -> None:
        for (number, row), values in self._inputs.items():
            given = arguments[number]
            values[:] = 0.0 if given is None else given[row, columns]
        for operation, operands in self._steps:
            operation(*operands)
        for result, output in zip(results, self._outputs, strict=True):
            result[:, columns] = output


@lru_cache(maxsize=256)
def _instructions(function: ca.Function) -> tuple[tuple[Any, Any, Any], ...]:
    """What to do, where to put the result, and what it is made of; meshes of one problem share them."""
    instructions: list[tuple[Any, Any, Any]] = []
    for k in range(function.n_instructions()):
        identity = function.instruction_id(k)
        sources, target = function.instruction_input(k), function.instruction_output(k)
        if identity == ca.OP_CONST:
            instructions.append((identity, target[0], function.instruction_constant(k)))
        elif identity == ca.OP_OUTPUT:
            instructions.append((identity, tuple(target), sources[0]))
        else:
            instructions.append((OPERATIONS.get(identity, identity), target[0], tuple(sources)))
    return tuple(instructions)
