"""AMPL's ``.nl`` files, text or binary, with complementarity rows.

D. M. Gay, Writing .nl files, Sandia report 2005-7907P. A row with bound type 5, ``5 k i``, complements the
unknown i - 1: bit 1 of k says that its lower bound takes part, bit 2 its upper bound. The row is non-negative
where the unknown is at its lower bound, non-positive at its upper bound, zero between; CasADi's own importer
refuses such rows.

Names come from the files ``.col`` and ``.row`` beside it, where there are some.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.nl_records import Records, open_records

Operation = Callable[..., ca.SX]

_UNARY = {
    13: ca.floor, 14: ca.ceil, 15: ca.fabs, 16: operator.neg, 34: ca.logic_not, 37: ca.tanh, 38: ca.tan,
    39: ca.sqrt, 40: ca.sinh, 41: ca.sin, 42: ca.log10, 43: ca.log, 44: ca.exp, 45: ca.cosh, 46: ca.cos,
    47: ca.atanh, 49: ca.atan, 50: ca.asinh, 51: ca.asin, 52: ca.acosh, 53: ca.acos, 76: lambda a: a * a,
}  # fmt: skip
_BINARY = {
    0: operator.add, 1: operator.sub, 2: operator.mul, 3: operator.truediv, 4: ca.fmod,
    5: operator.pow, 6: lambda a, b: ca.fmax(a - b, 0), 20: ca.logic_or, 21: ca.logic_and,
    22: operator.lt, 23: operator.le, 24: operator.eq, 28: operator.ge, 29: operator.gt, 30: operator.ne,
    48: ca.atan2, 75: operator.pow, 77: operator.pow,
}  # fmt: skip
_OPERATIONS: dict[int, tuple[Operation, int]] = {
    **{code: (operation, 1) for code, operation in _UNARY.items()},
    **{code: (operation, 2) for code, operation in _BINARY.items()},
    35: (ca.if_else, 3),
}
"""Operations and numbers of their arguments, by their number."""
_FOLDED: dict[int, Operation] = {11: ca.fmin, 12: ca.fmax, 54: operator.add}  # of any number of terms
_UNSUPPORTED: dict[int | str, str] = {
    64: "a piecewise-linear term", "F": "imported functions", "f": "imported functions", "L": "logical rows"
}  # fmt: skip
"""Names of operations, by their number, of segments and of expressions."""
_MOST = 10_000_000  # unknowns or rows: more stand in damaged headers alone
_REDUCED = ("ipopt_zL_in", "ipopt_zU_in")  # suffixes with multipliers of bounds
_SETS = ("sosno", "ref")  # suffixes that make special ordered sets of unknowns


def _fold(operation: Operation, parts: Sequence[ca.SX]) -> ca.SX:
    """Combine halves, so that long sums do not make deep graphs."""
    half = len(parts) // 2
    return operation(_fold(operation, parts[:half]), _fold(operation, parts[half:])) if half else parts[0]


@dataclass
class Rows:
    """A ``.nl`` file as read: unknowns, rows with their linear parts, bounds, start, first objective.

    ``complements`` maps a row to the bits k and the unknown of its condition. Unknowns have the names of the
    ``.col`` file, ``row_names`` those of the ``.row`` file (or ``g[3]``). ``sign`` is -1 for a maximum.
    ``duals`` (rows) and ``reduced`` (unknowns) are those to start from, as in a ``.sol`` file. ``options``
    are the numbers of the first line, which a ``.sol`` file repeats.
    """

    x: ca.SX
    bodies: list[ca.SX]
    lower: Array
    upper: Array
    lbx: Array
    ubx: Array
    x0: Array
    f: ca.SX
    duals: Array
    reduced: Array
    sign: float = 1.0
    complements: dict[int, tuple[int, int]] = field(default_factory=dict)
    row_names: list[str] = field(default_factory=list)
    options: tuple[str, ...] = ()


def read_rows(path: Path) -> Rows:
    """Read a ``.nl`` file.

    Raises
    ------
    ValueError
        With the file and the line (or byte), if it is malformed, has integer unknowns, imported functions or
        logical rows.
    """
    reader = _Reader(path, open_records(path))
    try:
        return reader.read()
    except (IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
        said = str(error) if isinstance(error, ValueError) else f"malformed ({error})"
        raise ValueError(f"{path}, {reader.records.place}: {said}") from error


def _unsupported(what: str, key: int | str) -> ValueError:
    name = f" ({_UNSUPPORTED[key]})" if key in _UNSUPPORTED else ""
    return ValueError(f"{what}{key}{name} is not supported")


def _place(i: int, n: int) -> int:
    if not 0 <= i < n:
        raise ValueError(f"index {i} out of range 0 to {n - 1}")
    return i


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {value}")
    return value


def _names(path: Path, ending: str, n: int) -> list[str]:
    """The names of a file beside ``path`` if it is of this model; after the rows it may name objectives."""
    beside = path.with_suffix(ending)
    names = beside.read_text(encoding="utf-8", errors="replace").splitlines() if beside.is_file() else []
    return names[:n] if len(names) == n or (ending == ".row" and len(names) > n) else []


class _Reader:
    """The records of a file and what they have given so far."""

    def __init__(self, path: Path, records: Records) -> None:
        self.path, self.records = path, records
        self.nonzeros: Counter[str] = Counter()
        self.numbers: set[str] = set()

    def table(self, kinds: str, n: int) -> list[list[Any]]:
        """The next ``n`` records."""
        return [self.records.read(kinds) for _ in range(n)]

    def read(self) -> Rows:
        header = self.records.header
        n, m = int(header[1][0]), int(header[1][1])
        if any(map(int, header[6][:5])):
            raise ValueError("integer unknowns are not supported")
        if not 0 <= min(n, m) <= max(n, m) <= _MOST:
            raise ValueError(f"{n} unknowns and {m} rows")
        names, free = _names(self.path, ".col", n), np.full(n, np.inf)
        x = ca.vertcat(*map(ca.SX.sym, names)) if names else ca.SX.sym("x", n)
        self.values: list[ca.SX] = ca.vertsplit(x) if n else []  # of unknowns, then of defined variables
        self.rows = Rows(
            x, [ca.SX(0)] * m, np.full(m, -np.inf), np.full(m, np.inf), -free, free, np.zeros(n), ca.SX(0),
            duals=np.zeros(m), reduced=np.zeros(n),
            row_names=_names(self.path, ".row", m) or [f"g[{i}]" for i in range(m)],
            options=(header[0][0][1:], *header[0][1:]),
        )  # fmt: skip
        while segment := self.records.key():
            self._segment(segment)
        for key, count in zip("JG", map(int, header[7]), strict=False):
            if self.nonzeros[key] < count:
                have = f"its segments {key} have {self.nonzeros[key]} of {count} nonzeros"
                raise ValueError(f"{have}: the file is not whole")
        return self.rows

    def _once(self, segment: str) -> None:
        """Segments that stand twice would be added up."""
        if segment in self.numbers:
            raise ValueError(f"segment {segment} stands twice")
        self.numbers.add(segment)

    def _segment(self, key: str) -> None:
        rows, read, n, m = self.rows, self.records.read, self.rows.x.shape[0], len(self.rows.bodies)
        match key:
            case "C":
                number = _place(read("i")[0], m)
                self._once(f"C{number}")
                rows.bodies[number] += self._expression()
            case "O":
                number, sense = read("ii")
                self._once(f"O{number}")
                expression = self._expression()
                if number == 0:
                    rows.f += expression
                    rows.sign = -1.0 if sense == 1 else 1.0
            case "V":
                number, n_terms, _ = read("iii")
                terms = self.table("if", n_terms)
                value = sum((_finite(c) * self.values[i] for i, c in terms), ca.SX(0)) + self._expression()
                if number != len(self.values):
                    raise ValueError(f"defined variable v{number} out of order")
                self.values.append(value)
            case "x" | "d":
                values = rows.x0 if key == "x" else rows.duals
                for i, value in self.table("if", read("i")[0]):
                    values[_place(i, values.size)] = value
            case "r":
                self._once("r")
                for row in range(m):
                    rows.lower[row], rows.upper[row] = self._bound(row)
            case "b":
                self._once("b")
                for j in range(n):
                    rows.lbx[j], rows.ubx[j] = self._bound(None)
            case "J" | "G":
                number, n_terms = read("ii")
                self._once(f"{key}{number}")
                self.nonzeros[key] += n_terms
                used = [_finite(c) * self.values[_place(i, n)] for i, c in self.table("if", n_terms) if c]
                linear = _fold(operator.add, used) if used else 0
                if key == "J":
                    rows.bodies[_place(number, m)] += linear
                elif number == 0:
                    rows.f += linear
            case "k" | "K":
                self.table("i", read("i")[0])
            case "S":
                kind, n_values, name = read("iis")
                given, is_of_unknowns = self.table("if" if kind & 4 else "ii", n_values), kind & 3 == 0
                if is_of_unknowns and name in _SETS:
                    raise ValueError(f"special ordered sets (suffix {name}) are not supported")
                for i, dual in given if is_of_unknowns and name in _REDUCED else ():
                    rows.reduced[_place(i, n)] += dual
            case _:
                raise _unsupported("segment ", key)

    def _bound(self, row: int | None) -> tuple[float, float]:
        """One record of the r segment, or of the b segment (no row); complementarity is noted."""
        read, kind = self.records.read, self.records.key()
        match kind:
            case "0":
                lower, upper = read("ff")
                return lower, upper
            case "1":
                return -np.inf, read("f")[0]
            case "2":
                return read("f")[0], np.inf
            case "3":
                return -np.inf, np.inf
            case "4":
                value = read("f")[0]
                return value, value
            case "5" if row is not None:
                bits, unknown = read("ii")
                self.rows.complements[row] = bits, _place(unknown - 1, self.rows.x.shape[0])
                return -np.inf, np.inf
        raise ValueError(f"unknown bound type {kind}")

    def _expression(self) -> ca.SX:
        """One expression in prefix form, with a stack of its own: sums may be thousands of levels deep."""
        pending: list[tuple[Operation, int, list[ca.SX]]] = []
        read = self.records.read
        while True:
            match self.records.key():
                case "n":
                    value = ca.SX(_finite(read("f")[0]))
                case "s" | "l" as kind:
                    value = ca.SX(read("h" if kind == "s" else "i")[0])
                case "v":
                    value = self.values[_place(read("i")[0], len(self.values))]
                case "o":
                    pending.append((*self._operation(read("i")[0]), []))
                    continue
                case kind:
                    raise _unsupported("expression ", kind)
            while pending:
                operation, count, arguments = pending[-1]
                arguments.append(value)
                if len(arguments) < count:
                    break
                pending.pop()
                value = operation(*arguments)
            else:
                return value

    def _operation(self, code: int) -> tuple[Operation, int]:
        """An operation and the number of its arguments."""
        if code in _OPERATIONS:
            return _OPERATIONS[code]
        if code not in _FOLDED:
            raise _unsupported("operation o", code)
        count = self.records.read("i")[0]
        if count < 1:
            raise ValueError(f"an operation on {count} terms")
        return lambda *parts: _fold(_FOLDED[code], parts), count
