"""The text form of AMPL's ``.nl`` files, with complementarity rows.

D. M. Gay, Writing .nl files, Sandia report 2005-7907P. A row with bound type 5, ``5 k i``, complements the
unknown i - 1: bit 1 of k says that its lower bound takes part, bit 2 its upper bound. The row is non-negative
where the unknown is at its lower bound, non-positive at its upper bound, zero between; CasADi's own
importer refuses such rows.
"""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

Operation = Callable[..., Any]

_UNARY: dict[int, Operation] = {
    13: ca.floor, 14: ca.ceil, 15: ca.fabs, 16: operator.neg, 34: ca.logic_not, 37: ca.tanh, 38: ca.tan,
    39: ca.sqrt, 40: ca.sinh, 41: ca.sin, 42: ca.log10, 43: ca.log, 44: ca.exp, 45: ca.cosh, 46: ca.cos,
    47: ca.atanh, 49: ca.atan, 50: ca.asinh, 51: ca.asin, 52: ca.acosh, 53: ca.acos, 76: lambda a: a * a,
}  # fmt: skip
_BINARY: dict[int, Operation] = {
    0: operator.add, 1: operator.sub, 2: operator.mul, 3: operator.truediv, 4: ca.remainder,
    5: operator.pow, 6: lambda a, b: ca.fmax(a - b, 0), 20: ca.logic_or, 21: ca.logic_and,
    22: operator.lt, 23: operator.le, 24: operator.eq, 28: operator.ge, 29: operator.gt, 30: operator.ne,
    48: ca.atan2, 75: operator.pow, 77: operator.pow,
}  # fmt: skip
_TERNARY: dict[int, Operation] = {35: ca.if_else}
_FOLDED: dict[int, Operation] = {11: ca.fmin, 12: ca.fmax, 54: operator.add}  # of any number of terms


def _fold(operation: Operation, parts: Sequence[Any]) -> Any:
    """Combine pairwise, so that long sums do not make deep graphs."""
    while len(parts) > 1:
        paired = [operation(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)]
        parts = paired + ([parts[-1]] if len(parts) % 2 else [])
    return parts[0]


@dataclass
class Rows:
    """A ``.nl`` file as read: unknowns, rows with their linear parts, bounds, start, first objective.

    ``complements`` maps a row to the bits k and the unknown of its condition.
    """

    x: Any
    bodies: list[Any]
    lower: Any
    upper: Any
    lbx: Any
    ubx: Any
    x0: Any
    f: Any
    maximise: bool = False
    complements: dict[int, tuple[int, int]] = field(default_factory=dict)


def read_rows(path: Path) -> Rows:
    """Read the text form of a ``.nl`` file.

    Raises
    ------
    ValueError
        With the file and line, if it is malformed, has integer unknowns, imported functions or logical rows.
    """
    reader = _Reader(path)
    try:
        return reader.read()
    except (IndexError, KeyError, RuntimeError, TypeError) as error:
        raise reader.fault(f"malformed ({type(error).__name__}: {error})") from error
    except ValueError as error:
        raise (error if str(path) in str(error) else reader.fault(str(error))) from error


def _place(word: str, n: int) -> int:
    i = int(word)
    if not 0 <= i < n:
        raise ValueError(f"index {i} out of range 0 to {n - 1}")
    return i


class _Reader:
    """The lines of a file without comments, and what they have given so far; errors name the line."""

    def __init__(self, path: Path) -> None:
        self.path, self.number = path, 0
        data = path.read_bytes()
        if data[:1] == b"b":
            raise ValueError(f"{path}: binary .nl files are not read; write the text form (option 'g')")
        if data[:1] != b"g":
            raise ValueError(f"{path}: not an .nl file, it must begin with 'g'")
        lines = enumerate(data.decode("utf-8", errors="replace").splitlines(), 1)
        bare = ((number, line.split("#", 1)[0].strip()) for number, line in lines)
        self.lines = deque((number, line) for number, line in bare if line)

    def next(self) -> str:
        if not self.lines:
            raise ValueError(f"{self.path}: the file ends too early")
        self.number, line = self.lines.popleft()
        return line

    def table(self, n: str) -> list[list[str]]:
        """The words of the next ``n`` lines."""
        return [self.next().split() for _ in range(int(n))]

    def fault(self, what: str) -> ValueError:
        return ValueError(f"{self.path}, line {self.number}: {what}")

    def read(self) -> Rows:
        header = self.table("10")
        n, m = int(header[1][0]), int(header[1][1])
        if any(int(count) for count in header[6][:5]):
            raise self.fault("integer unknowns are not supported")
        if min(n, m) < 0 or max(n, m) > 10_000_000:
            raise self.fault(f"{n} unknowns and {m} rows")
        x, free = ca.SX.sym("x", n), np.full(n, np.inf)
        self.values: list[Any] = ca.vertsplit(x) if n else []  # of unknowns, then of defined variables
        self.rows = Rows(
            x, [ca.SX(0)] * m, np.full(m, -np.inf), np.full(m, np.inf), -free, free, np.zeros(n), ca.SX(0)
        )
        while self.lines:
            head = self.next()
            self._segment(head[0], head[1:].split())
        return self.rows

    def _segment(self, key: str, words: list[str]) -> None:
        rows, n, m = self.rows, int(self.rows.x.shape[0]), len(self.rows.bodies)
        match key:
            case "C":
                rows.bodies[_place(words[0], m)] += self._expression()
            case "O":
                expression = self._expression()
                if int(words[0]) == 0:
                    rows.f += expression
                    rows.maximise = int(words[1]) == 1
            case "V":
                terms = [(int(i), float(c)) for i, c in self.table(words[1])]
                value = sum((c * self.values[i] for i, c in terms), ca.SX(0)) + self._expression()
                if int(words[0]) != len(self.values):
                    raise self.fault(f"defined variable v{words[0]} out of order")
                self.values.append(value)
            case "x":
                for i, start in self.table(words[0]):
                    rows.x0[_place(i, n)] = float(start)
            case "r":
                for row in range(m):
                    rows.lower[row], rows.upper[row] = self._bound(row)
            case "b":
                for j in range(n):
                    rows.lbx[j], rows.ubx[j] = self._bound(None)
            case "J" | "G":
                terms = [(_place(i, n), float(c)) for i, c in self.table(words[1])]
                used = [c * self.values[i] for i, c in terms if c]
                linear = _fold(operator.add, used) if used else 0
                if key == "J":
                    rows.bodies[_place(words[0], m)] += linear
                elif int(words[0]) == 0:
                    rows.f += linear
            case "k" | "d" | "S":
                self.table(words[1 if key == "S" else 0])
            case "F":
                raise self.fault("imported functions are not supported")
            case "L":
                raise self.fault("logical rows are not supported")
            case _:
                raise self.fault(f"unknown segment {key!r}")

    def _bound(self, row: int | None) -> tuple[float, float]:
        """One line of the r segment, or of the b segment (no row); complementarity is noted."""
        kind, *words = self.next().split()
        match int(kind):
            case 0:
                return float(words[0]), float(words[1])
            case 1:
                return -np.inf, float(words[0])
            case 2:
                return float(words[0]), np.inf
            case 3:
                return -np.inf, np.inf
            case 4:
                return float(words[0]), float(words[0])
            case 5 if row is not None:
                unknown = _place(str(int(words[1]) - 1), int(self.rows.x.shape[0]))
                self.rows.complements[row] = int(words[0]), unknown
                return -np.inf, np.inf
        raise self.fault(f"unknown bound type {kind}")

    def _expression(self) -> Any:
        """One expression in prefix form, with a stack of its own: sums may be thousands of levels deep."""
        pending: list[tuple[Operation, int, list[Any]]] = []
        while True:
            line = self.next()
            match line[0]:
                case "n" | "s" | "l":
                    value: Any = ca.SX(float(line[1:]))
                case "v":
                    value = self.values[_place(line[1:], len(self.values))]
                case "o":
                    pending.append((*self._operation(int(line[1:])), []))
                    continue
                case _:
                    raise self.fault(f"unknown expression {line!r}")
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
        for count, operations in ((1, _UNARY), (2, _BINARY), (3, _TERNARY)):
            if code in operations:
                return operations[code], count
        if code not in _FOLDED:
            raise self.fault(f"operation o{code} is not supported")
        count = int(self.next())
        if count < 1:
            raise self.fault(f"an operation on {count} terms")
        return lambda *parts: _fold(_FOLDED[code], parts), count
